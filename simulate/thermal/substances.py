"""The substances of surfaces, with their albedo, emissivity and heat transfer.

Albedos and emissivities are rounded values within the ranges of Oke, Boundary Layer Climates (2nd
edition, 1987), for natural and urban materials, and of the emissivity tables of manufacturers of
thermal cameras for glass, paint and rubber. A time constant is the heat capacity of the layer at
the surface, which follows the weather of the last hours, divided by its heat transfer.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES, FIRST_OBJECT_LABEL
from simulate.look.textures import facade_material
from simulate.place.world import Facade

Backing = Literal["ground", "water", "indoors"]


class Substance(NamedTuple):
    """A substance at a surface.

    Attributes:
        albedo: Share of sunlight that is reflected, used if the colour is not known.
        solar_ratio: Ratio of the albedo in sunlight to the albedo in visible light, used if the
            colour is known. Leaves reflect far more near infrared than visible light.
        emissivity: Emissivity between 8 and 14 micrometres.
        hours: Time constant of the temperature, hours.
        transfer: Heat transfer to the air by convection, W/(m2 K), in light wind.
        evaporation: Share of the absorbed sunlight that evaporates water.
        conductance: Heat transfer to the ground, water or room behind the surface, W/(m2 K).
        backing: What lies behind the surface.
    """

    albedo: float
    solar_ratio: float
    emissivity: float
    hours: float
    transfer: float = 12.0
    evaporation: float = 0.0
    conductance: float = 0.0
    backing: Backing = "indoors"


SUBSTANCES: Final[dict[str, Substance]] = {
    "asphalt": Substance(0.10, 1.1, 0.95, 2.5, conductance=4.0, backing="ground"),
    "concrete": Substance(0.28, 1.1, 0.94, 2.5, conductance=5.0, backing="ground"),
    "gravel": Substance(0.28, 1.1, 0.93, 1.5, conductance=5.0, backing="ground"),
    "grass": Substance(0.22, 2.3, 0.98, 0.4, 14.0, 0.55, 2.0, "ground"),
    "soil": Substance(0.18, 1.6, 0.96, 1.2, 12.0, 0.30, 4.0, "ground"),
    "water": Substance(0.07, 1.0, 0.985, 6.0, 12.0, 0.0, 400.0, "water"),
    "leaf": Substance(0.22, 2.3, 0.98, 0.1, 30.0, 0.55),
    "wood": Substance(0.30, 1.2, 0.91, 0.5),
    "straw": Substance(0.35, 1.2, 0.95, 0.5),
    "masonry": Substance(0.32, 1.0, 0.92, 4.0, conductance=0.8),
    "stone": Substance(0.30, 1.0, 0.92, 3.0, conductance=3.0, backing="ground"),
    "tile": Substance(0.25, 1.2, 0.92, 0.8, 14.0, conductance=0.4),
    "slate": Substance(0.12, 1.1, 0.90, 0.7, 14.0, conductance=0.4),
    "bitumen": Substance(0.12, 1.0, 0.92, 0.9, 14.0, conductance=0.3),
    "bare sheet": Substance(0.35, 1.0, 0.28, 0.2, 16.0, conductance=0.5),
    "painted sheet": Substance(0.35, 1.0, 0.92, 0.25, 16.0, conductance=0.5),
    "bodywork": Substance(0.35, 1.0, 0.93, 0.35, 18.0),
    "iron": Substance(0.25, 1.0, 0.85, 0.6),
    "rubber": Substance(0.05, 1.0, 0.94, 0.8),
    "pane": Substance(0.30, 1.0, 0.87, 0.3, conductance=3.0),
    "solar cell": Substance(0.25, 1.0, 0.88, 0.2, 18.0),
}
"""Every substance by its name."""

NAMES: Final = tuple(SUBSTANCES)
"""The names of the substances. The number of a substance is its position here."""

# Substance of the ground by class. The ground of a site (a real place) includes its buildings and
# trees.
_BY_GROUND_CLASS: Final[dict[str, str]] = {
    "grass": "grass",
    "field": "soil",
    "road": "asphalt",
    "pavement": "concrete",
    "parking": "asphalt",
    "driveway": "concrete",
    "path": "gravel",
    "water": "water",
    "building": "tile",
    "tree": "leaf",
    "hedge": "leaf",
}
# Substance by class, for parts of objects whose material does not determine the substance.
_BY_CLASS: Final[dict[str, str]] = {
    "building": "masonry",
    "tree": "wood",
    "hedge": "leaf",
    "fence": "wood",
    "car": "bodywork",
    "truck": "bodywork",
    "container": "bodywork",
    "bench": "wood",
    "lamp": "iron",
    "van": "bodywork",
    "bin": "bodywork",
    "hydrant": "iron",
    "sign": "bodywork",
    "bollard": "stone",
    "table": "wood",
    "bale": "straw",
    "tractor": "bodywork",
    "pole": "wood",
    "wire": "iron",
    "tank": "bodywork",
    "pallet": "wood",
    "boat": "bodywork",
    "panel": "iron",
    "cabinet": "bodywork",
    "grave": "stone",
    "crane": "bodywork",
}
# Substance by material, for materials that are always the same substance.
_BY_MATERIAL: Final[dict[str, str]] = {
    **{facade_material(style): "masonry" for style in Facade},
    facade_material(Facade.HALL_CLADDING): "painted sheet",
    facade_material(Facade.SHED_BOARDS): "wood",
    "roof_tile": "tile",
    "roof_slate": "slate",
    "roof_metal": "bare sheet",
    "roof_flat": "bitumen",
    "leaf": "leaf",
    "needle": "leaf",
    "street_light": "pane",
    "headlight": "pane",
    "tail_light": "pane",
}
# Vehicles whose unpainted parts are tyres and trim.
_WITH_TYRES: Final = ("car", "van", "truck", "tractor")


def substance_name(material: str, class_name: str) -> str:
    """Return the substance of a surface by its rendering material and its class.

    Raises:
        ValueError: No substance is known for this combination.
    """
    is_object = CLASSES[class_name] >= FIRST_OBJECT_LABEL
    if class_name in _BY_GROUND_CLASS and (
        material == "ground" or (material == "plain" and not is_object)
    ):
        return _BY_GROUND_CLASS[class_name]
    if is_object and material in _BY_MATERIAL:
        return _BY_MATERIAL[material]
    if is_object and material in ("plain", "paint", "glass"):
        if class_name == "panel" and material != "plain":
            return "solar cell"
        if material == "glass":
            return "pane"
        if material == "plain" and class_name in _WITH_TYRES:
            return "rubber"
        return _BY_CLASS[class_name]
    raise ValueError(
        f"no substance is known for the material {material!r} of the class {class_name!r}"
    )


def substance_table(materials: Sequence[str]) -> NDArray[np.int16]:
    """Return the number of the substance (materials + 1, 256) by material and class label.

    Materials are counted from 1, as in the renderer's material pass. The number is -1 for
    combinations that no surface has.
    """
    table = np.full((len(materials) + 1, 256), -1, np.int16)
    for row, material in enumerate(materials, 1):
        for class_name, label in CLASSES.items():
            with suppress(ValueError):
                table[row, label] = NAMES.index(substance_name(material, class_name))
    return table


def property_array(name: str) -> NDArray[np.float32]:
    """Return a numeric attribute of all substances, in the order of ``NAMES``."""
    return np.array([getattr(SUBSTANCES[each], name) for each in NAMES], np.float32)
