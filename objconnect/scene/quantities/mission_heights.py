"""Height references of mission plans: MAVLink's frames and QGroundControl's modes."""

from __future__ import annotations

from enum import Enum
from typing import Final

from objconnect.scene.quantities.reading import Reading, known, unknown


class HeightReference(Enum):
    """What a height is measured from."""

    SEA = "mean sea level"  # the geoid, not the ellipsoid
    HOME = "home"  # the home position of the aircraft
    GROUND = "the ground below"  # the ground at the position itself


# MAV_FRAME: each reference has a variant for integer coordinates.
_FRAMES: Final = {
    0: HeightReference.SEA,
    5: HeightReference.SEA,
    3: HeightReference.HOME,
    6: HeightReference.HOME,
    10: HeightReference.GROUND,
    11: HeightReference.GROUND,
}
# QGroundControl's AltitudeMode and DistanceMode. 0 means several modes and 5 none.
_RELATIVE, _ABSOLUTE, _CALCULATED, _TERRAIN = 1, 2, 3, 4
# The reference of the height that is sent to the aircraft, and of the one that the user chose.
_SENT_AS: Final = {
    _RELATIVE: HeightReference.HOME,
    _ABSOLUTE: HeightReference.SEA,
    _CALCULATED: HeightReference.SEA,
    _TERRAIN: HeightReference.GROUND,
}
_MEANT_AS: Final = _SENT_AS | {_CALCULATED: HeightReference.GROUND}


def reference_of_frame(frame: int | None) -> Reading[HeightReference]:
    """Return the height reference of a MAV_FRAME; unknown for local and mission frames."""
    reference = None if frame is None else _FRAMES.get(frame)
    if reference is None:
        why = "frame is missing" if frame is None else f"MAV_FRAME {frame} states no height"
        return unknown("the reference of its height", why)
    return known(reference, "MAV_FRAME")


def check_mode(mode: float | None, stated: HeightReference) -> str | None:
    """Return how the AltitudeMode of an item contradicts its frame; None if it does not.

    The mode "calculated above terrain" is sent to the aircraft as a height above the sea.

    Args:
        mode: AltitudeMode of the item.
        stated: height reference of the item's frame.
    """
    if mode is None:
        return None
    sent = _SENT_AS.get(int(mode)) if mode == int(mode) else None
    if sent is None:
        return f"AltitudeMode is {mode:g}, which is not known"
    if sent is not stated:
        return f"AltitudeMode is {mode:g} ({sent.value}), but frame states {stated.value}"
    return None


def reference_of_survey(
    mode: float | None, relative: bool | None, follows_terrain: bool | None
) -> Reading[HeightReference]:
    """Return the height reference of a survey's DistanceToSurface; unknown if fields disagree.

    Args:
        mode: DistanceMode of newer files.
        relative: DistanceToSurfaceRelative of older files.
        follows_terrain: FollowTerrain of older files; it overrides ``relative``.
    """
    newer = None if mode is None else _MEANT_AS.get(int(mode)) if mode == int(mode) else None
    if mode is not None and newer is None:
        return unknown("DistanceMode", f"DistanceMode is {mode:g}, which has no reference")
    older = None if relative is None else HeightReference.HOME if relative else HeightReference.SEA
    older = HeightReference.GROUND if follows_terrain else older
    if newer is not None and older is not None and newer is not older:
        return unknown("DistanceMode", "DistanceMode contradicts DistanceToSurfaceRelative")
    if newer is not None:
        return known(newer, "DistanceMode")
    if older is not None:
        return known(older, "DistanceToSurfaceRelative")
    return unknown("DistanceMode", "neither DistanceMode nor DistanceToSurfaceRelative is there")
