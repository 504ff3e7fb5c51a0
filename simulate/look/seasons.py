"""Seasons: the day of the year, the colours of ground and leaves, and what lies on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date

from objconnect.scene.registry import Registry
from simulate.place.world import Rgb

# Linear albedo of each kind of ground: (fresh, worn).
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
_SPRING_GROUND = _SUMMER_GROUND | {
    "grass": ((0.052, 0.098, 0.026), (0.090, 0.120, 0.042)),
    "field": ((0.050, 0.095, 0.026), (0.150, 0.110, 0.070)),
}
_THAW_GROUND = _WINTER_GROUND | {
    "grass": ((0.062, 0.066, 0.030), (0.120, 0.100, 0.056)),
    "field": ((0.070, 0.054, 0.036), (0.120, 0.094, 0.060)),
}
_HARVEST_GROUND = _SUMMER_GROUND | {
    "grass": ((0.088, 0.100, 0.038), (0.205, 0.175, 0.090)),
    "field": ((0.250, 0.195, 0.100), (0.340, 0.275, 0.155)),
}
_PLOUGHED: tuple[Rgb, Rgb] = (0.068, 0.046, 0.031), (0.105, 0.075, 0.052)
_AUTUMN_GROUND = _SUMMER_GROUND | {
    "grass": ((0.078, 0.086, 0.034), (0.165, 0.120, 0.056)),
    "field": ((0.098, 0.072, 0.048), (0.170, 0.130, 0.082)),
}


@dataclass(frozen=True)
class Season:
    """A season: the day of the year, the colours of ground and leaves, and the snow.

    Attributes:
        day: Month and day in the northern hemisphere. In the southern hemisphere the season is half
            a year later.
        ground: Linear albedo (fresh, worn) by class of ground.
        leaf: Linear colour of the inner leaves of broadleaved trees.
        leaf_tip: Linear colour of their outer leaves.
        snow: Fraction of open ground under snow, 0 to 1.
        bare: Whether broadleaved trees have no leaves, a change of the geometry, which scenes
            record for each flight.
        thaw: How far the snow has melted, 0 to 1. Thawing snow remains in shade and hollows, and
            its water soaks the ground.
        litter: Coverage of the ground under broadleaved trees by fallen leaves, 0 to 1.
        ploughed: Linear albedo (fresh, worn) of ploughed fields. None leaves all fields unploughed.
    """

    day: date
    ground: Mapping[str, tuple[Rgb, Rgb]]
    leaf: Rgb
    leaf_tip: Rgb
    snow: float = 0.0
    bare: bool = False
    thaw: float = 0.0
    litter: float = 0.0
    ploughed: tuple[Rgb, Rgb] | None = None


_BROWN_LEAF: Rgb = (0.042, 0.036, 0.024)
_BROWN_TIP: Rgb = (0.130, 0.105, 0.068)
SUMMER_LEAF: tuple[Rgb, Rgb] = (0.028, 0.046, 0.016), (0.120, 0.150, 0.050)
"""Linear colours of the inner and outer leaves in summer, and of conifers all year."""

_SEASONS: dict[str, Season] = {
    "spring": Season(
        date(2026, 4, 28),
        _SPRING_GROUND,
        leaf=(0.040, 0.066, 0.014),
        leaf_tip=(0.170, 0.215, 0.050),
    ),
    "summer": Season(date(2025, 7, 2), _SUMMER_GROUND, *SUMMER_LEAF),
    "harvest": Season(
        date(2025, 8, 24),
        _HARVEST_GROUND,
        leaf=(0.030, 0.042, 0.015),
        leaf_tip=(0.130, 0.140, 0.048),
        ploughed=_PLOUGHED,
    ),
    "autumn": Season(
        date(2025, 10, 20),
        _AUTUMN_GROUND,
        leaf=(0.085, 0.042, 0.012),
        leaf_tip=(0.330, 0.170, 0.030),
    ),
    "leaffall": Season(
        date(2025, 11, 6),
        _AUTUMN_GROUND,
        leaf=(0.070, 0.036, 0.015),
        leaf_tip=(0.215, 0.105, 0.034),
        litter=0.85,
    ),
    "leafoff": Season(date(2025, 12, 3), _WINTER_GROUND, _BROWN_LEAF, _BROWN_TIP, bare=True),
    "winter": Season(date(2026, 1, 20), _WINTER_GROUND, _BROWN_LEAF, _BROWN_TIP, snow=0.62),
    "snow": Season(date(2026, 2, 6), _WINTER_GROUND, _BROWN_LEAF, _BROWN_TIP, snow=0.95),
    "melt": Season(date(2026, 3, 8), _THAW_GROUND, _BROWN_LEAF, _BROWN_TIP, snow=0.55, thaw=1.0),
}
SEASONS = Registry("season", "objconnect.seasons", _SEASONS, lambda e: isinstance(e, Season))
