"""Conversion of a photograph's altitude from sea level to the ellipsoid."""

from __future__ import annotations

from objconnect.scene.geo.crs import geoid_undulation
from objconnect.scene.storage.exif import Exif


def convert_to_ellipsoid(exif: Exif, undulation_m: float | None = None) -> Exif:
    """Return metadata with the altitude converted from sea level to the ellipsoid.

    If no undulation is known, the metadata are returned unchanged: the altitude is above sea level,
    and ``doubts`` says so.

    Args:
        exif: metadata of the photograph.
        undulation_m: geoid undulation at the place, metres; None takes it from PROJ's grid, if
            that is installed.
    """
    if exif.position is None or not exif.refers_to_sea_level:
        return exif
    if undulation_m is None:
        undulation_m = geoid_undulation(exif.position)
    return exif if undulation_m is None else exif.convert_to_ellipsoid(undulation_m)
