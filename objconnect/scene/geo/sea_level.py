"""Altitudes of photographs that are above sea level, turned into ones above the ellipsoid."""

from __future__ import annotations

from objconnect.scene.geo.crs import geoid_undulation
from objconnect.scene.storage.images import Exif


def above_ellipsoid(exif: Exif, undulation_m: float | None = None) -> Exif:
    """Return what a photograph says, with an altitude above the ellipsoid where that is known.

    An altitude that is said to be above sea level and cannot be turned stays, with its doubt.

    Args:
        exif: what the photograph says.
        undulation_m: height of the geoid above the ellipsoid at the place, metres; None takes that
            of PROJ's grid, where it is installed.
    """
    if exif.position is None or not exif.is_above_sea:
        return exif
    if undulation_m is None:
        undulation_m = geoid_undulation(exif.position)
    return exif if undulation_m is None else exif.above_ellipsoid(undulation_m)
