"""The lamps of a place that shine at night: street lamps and headlights of vehicles in traffic."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulate.place.world import Rgb, World, WorldObject

Array = NDArray[np.float64]

_SODIUM: Final[Rgb] = (1.0, 0.42, 0.09)
_LED: Final[Rgb] = (1.0, 0.72, 0.42)
_LED_SHARE: Final = 0.6  # share of places whose street lamps are LEDs
# Power in W of Blender's spot lights: a power P is P / (4 pi) per steradian. The irradiance below a
# street lamp is 1 W/m2, see ``simulate.look.conditions``.
_STREET_W: Final = 560.0
_HEADLIGHTS_W: Final = 10000.0
_STREET_CONE_DEG: Final = 150.0
_HEADLIGHTS_CONE_DEG: Final = 44.0
_DIP: Final = 0.07  # downward slope of headlights
_ASPECT: Final = 0.4  # height of the beam of headlights, relative to its width


class Beam(NamedTuple):
    """A spot light.

    Attributes:
        position: Position (3,) of the lamp, world metres.
        direction: Unit vector (3,) along the middle of the beam.
        cone_deg: Angle of the cone, degrees.
        aspect: Height of the beam, relative to its width.
        watts: Power, on Blender's scale.
        rgb: Linear colour.
        reach_m: Distance beyond which the light is left out, metres.
    """

    position: Array
    direction: Array
    cone_deg: float
    aspect: float
    watts: float
    rgb: Rgb
    reach_m: float


def beams(world: World) -> Iterator[Beam]:
    """Yield the beams of all lamps of a place at night. Its street lamps have one colour."""
    rng = np.random.default_rng([world.seed, 4])
    street = _LED if rng.random() < _LED_SHARE else _SODIUM
    for item in world.objects:
        ahead = np.array([np.cos(item.yaw), np.sin(item.yaw), 0.0])
        if item.class_name == "lamp":
            yield _street_light(item, ahead, street)
        elif item.driven:
            yield _headlights(item, ahead)


def _street_light(item: WorldObject, ahead: Array, rgb: Rgb) -> Beam:
    """Return the beam of a lamp, whose head is at the end of its arm, just under its box's top."""
    position = item.centre + 0.32 * item.size[0] * ahead + [0.0, 0.0, 0.47 * item.size[2]]
    return Beam(position, np.array([0.0, 0.0, -1.0]), _STREET_CONE_DEG, 1.0, _STREET_W, rgb, 40.0)


def _headlights(item: WorldObject, ahead: Array) -> Beam:
    """Return the common beam of both headlights, from the middle of a vehicle's front."""
    forward = 0.5 * item.size[0] + 0.1
    ascent = 0.0 if item.slope is None else item.slope[0]
    above_centre = 0.65 - 0.5 * item.height_m + ascent * forward
    position = item.centre + forward * ahead + [0.0, 0.0, above_centre]
    direction = ahead - [0.0, 0.0, _DIP - ascent]
    direction /= np.linalg.norm(direction)
    return Beam(position, direction, _HEADLIGHTS_CONE_DEG, _ASPECT, _HEADLIGHTS_W, _LED, 90.0)
