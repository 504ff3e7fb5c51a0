"""List the objects and the splits of a scene for its JSON files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objconnect.scene.bundle.frames import read_frames
from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.bundle.manifest import (
    Objects,
    SceneObject,
    Splits,
    Surroundings,
    size_class,
)
from simulate.config import SimulateConfig
from simulate.place.world import World, WorldObject


def describe_objects(place: World, items: Sequence[WorldObject]) -> Objects:
    """Return the contents of ``objects.json``: the objects and the named areas of a place."""

    def describe(item: WorldObject) -> SceneObject:
        size = (float(item.size[0]), float(item.size[1]), float(item.size[2]))
        return SceneObject(
            id=item.id,
            class_name=item.class_name,
            centre=(float(item.centre[0]), float(item.centre[1]), float(item.centre[2])),
            size=size,
            yaw_deg=float(np.degrees(item.yaw)),
            size_class=size_class(size),
        )

    return Objects(
        classes=CLASSES,
        objects=tuple(describe(item) for item in items),
        surroundings=tuple(
            Surroundings(name=part.name, outline=tuple((x, y) for x, y in part.outline.tolist()))
            for part in place.surroundings
        ),
    )


def list_splits(out: Path, config: SimulateConfig) -> Splits:
    """Return the contents of ``splits.json``: the frames of map and query flights in a folder.

    Raises:
        InputError: a session is missing or damaged.
    """
    sessions = config.session_names()
    frames = {name: read_frames(out / "sessions" / name / "frames.h5").names for name in sessions}
    roles = dict(zip(sessions, (s.role for s in config.sessions), strict=True))
    return Splits(
        map=tuple(f for name, names in frames.items() if roles[name] == "map" for f in names),
        queries={name: names for name, names in frames.items() if roles[name] == "query"},
    )
