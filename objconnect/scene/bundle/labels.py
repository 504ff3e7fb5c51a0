"""The semantic labels of a scene's pixels."""

from __future__ import annotations

CLASSES: dict[str, int] = {
    "sky": 0,
    "grass": 1,
    "field": 2,
    "road": 3,
    "pavement": 4,
    "parking": 5,
    "driveway": 6,
    "path": 7,
    "water": 8,
    "building": 16,
    "tree": 17,
    "hedge": 18,
    "fence": 19,
    "car": 20,
    "truck": 21,
    "container": 22,
    "bench": 23,
    "lamp": 24,
    "van": 25,
    "bin": 26,
    "hydrant": 27,
    "sign": 28,
    "bollard": 29,
    "table": 30,
    "bale": 31,
    "tractor": 32,
    "pole": 33,
    "wire": 34,
    "tank": 35,
    "pallet": 36,
    "boat": 37,
    "panel": 38,
    "cabinet": 39,
    "grave": 40,
    "crane": 41,
}
"""The semantic label of every class."""

FIRST_OBJECT_LABEL = 16
"""Labels below this one are sky and ground cover; the others are objects."""
