"""Seasons and light: the colours a place wears and the sun above it. Geometry never changes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from scene.errors import InputError
from simulate.world import Rgb

# Linear albedo pairs (fresh, worn) of each kind of ground.
_SUMMER_GROUND: dict[str, tuple[Rgb, Rgb]] = {
    "grass": ((0.066, 0.092, 0.034), (0.150, 0.140, 0.075)),
    "field": ((0.105, 0.125, 0.040), (0.260, 0.205, 0.100)),
    "road": ((0.085, 0.085, 0.088), (0.125, 0.122, 0.118)),
    "pavement": ((0.240, 0.230, 0.215), (0.300, 0.285, 0.265)),
    "parking": ((0.100, 0.100, 0.103), (0.150, 0.147, 0.142)),
    "driveway": ((0.210, 0.190, 0.170), (0.260, 0.215, 0.185)),
    "path": ((0.270, 0.225, 0.165), (0.320, 0.280, 0.220)),
}
_WINTER_GROUND: dict[str, tuple[Rgb, Rgb]] = {
    "grass": ((0.080, 0.085, 0.042), (0.135, 0.115, 0.070)),
    "field": ((0.105, 0.085, 0.060), (0.155, 0.125, 0.085)),
    "road": ((0.070, 0.071, 0.075), (0.115, 0.113, 0.112)),
    "pavement": ((0.170, 0.168, 0.165), (0.220, 0.215, 0.208)),
    "parking": ((0.078, 0.079, 0.082), (0.125, 0.123, 0.121)),
    "driveway": ((0.150, 0.140, 0.130), (0.185, 0.160, 0.142)),
    "path": ((0.180, 0.155, 0.120), (0.220, 0.195, 0.160)),
}


@dataclass(frozen=True)
class Condition:
    """Season and light. Angles in degrees: azimuth clockwise from north, elevation above the
    horizon. Colours are linear RGB; `snow` 0..1 is how much of open ground is covered,
    `time` when a flight under it begins.

    `leaf` and `leaf_tip` are the inner and outer colours of foliage, `sun_watts` and
    `sky_strength` Blender's irradiance (W/m2) and background factor, `exposure` in stops.
    """

    name: str
    time: datetime
    sun_azimuth: float
    sun_elevation: float
    sun_watts: float
    sun_rgb: Rgb
    sky_zenith: Rgb
    sky_horizon: Rgb
    sky_strength: float
    exposure: float
    snow: float
    ground: dict[str, tuple[Rgb, Rgb]]
    leaf: Rgb
    leaf_tip: Rgb


CONDITIONS: dict[str, Condition] = {
    c.name: c
    for c in (
        Condition(
            name="summer-noon",
            time=datetime(2025, 7, 2, 11, 0, tzinfo=UTC),
            sun_azimuth=165.0,
            sun_elevation=56.0,
            sun_watts=4.2,
            sun_rgb=(1.0, 0.95, 0.87),
            sky_zenith=(0.30, 0.44, 0.72),
            sky_horizon=(0.72, 0.80, 0.88),
            sky_strength=1.35,
            exposure=0.45,
            snow=0.0,
            ground=_SUMMER_GROUND,
            leaf=(0.028, 0.046, 0.016),
            leaf_tip=(0.120, 0.150, 0.050),
        ),
        Condition(
            name="winter-dusk",
            time=datetime(2026, 1, 20, 15, 0, tzinfo=UTC),
            sun_azimuth=228.0,
            sun_elevation=13.0,
            sun_watts=2.1,
            sun_rgb=(1.0, 0.78, 0.58),
            sky_zenith=(0.20, 0.30, 0.52),
            sky_horizon=(0.55, 0.56, 0.62),
            sky_strength=0.8,
            exposure=1.0,
            snow=0.62,
            ground=_WINTER_GROUND,
            leaf=(0.042, 0.036, 0.024),
            leaf_tip=(0.130, 0.105, 0.068),
        ),
    )
}


def condition(name: str) -> Condition:
    """The condition called `name`; InputError naming the valid ones when there is none."""
    try:
        return CONDITIONS[name]
    except KeyError:
        raise InputError(
            f"unknown condition {name!r}: choose one of {', '.join(CONDITIONS)}"
        ) from None
