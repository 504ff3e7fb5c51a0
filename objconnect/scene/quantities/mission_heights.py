"""What the heights of mission plans are above: MAVLink's frames and QGroundControl's modes."""

from __future__ import annotations

from enum import Enum
from typing import Final

from objconnect.scene.quantities.reading import Reading, known, unknown


class Above(Enum):
    """What a height is above.

    Attributes:
        SEA: Mean sea level, which is the geoid and not the ellipsoid.
        HOME: The home position of the aircraft.
        GROUND: The ground below the position itself.
    """

    SEA = "mean sea level"
    HOME = "home"
    GROUND = "the ground below"


# MAV_FRAME, each with its variant for integer coordinates.
_FRAMES: Final = {
    0: Above.SEA,
    5: Above.SEA,
    3: Above.HOME,
    6: Above.HOME,
    10: Above.GROUND,
    11: Above.GROUND,
}
# QGroundControl's AltitudeMode and DistanceMode. 0 stands for several modes and 5 for none.
_RELATIVE, _ABSOLUTE, _CALCULATED, _TERRAIN = 1, 2, 3, 4
_SENT_AS: Final = {
    _RELATIVE: Above.HOME,
    _ABSOLUTE: Above.SEA,
    _CALCULATED: Above.SEA,
    _TERRAIN: Above.GROUND,
}
_MEANT_AS: Final = _SENT_AS | {_CALCULATED: Above.GROUND}


def above_of_frame(frame: int | None) -> Reading[Above]:
    """Return what a height is above by its MAV_FRAME; unknown in local and mission frames."""
    above = None if frame is None else _FRAMES.get(frame)
    if above is None:
        why = "frame is missing" if frame is None else f"MAV_FRAME {frame} is not one of heights"
        return unknown("the reference of its height", why)
    return known(above, "MAV_FRAME")


def check_mode(mode: float | None, frame: Above) -> str | None:
    """Return how the AltitudeMode of an item contradicts its frame; None where it does not.

    An item without AltitudeMode says nothing. The mode "calculated above terrain" is sent to the
    aircraft as a height above the sea.
    """
    if mode is None:
        return None
    sent = _SENT_AS.get(int(mode)) if mode == int(mode) else None
    if sent is None:
        return f"AltitudeMode is {mode:g}, which is not known"
    if sent is not frame:
        return f"AltitudeMode is {mode:g} ({sent.value}), and frame says {frame.value}"
    return None


def above_of_survey(
    mode: float | None, relative: bool | None, follows_terrain: bool | None
) -> Reading[Above]:
    """Return what the DistanceToSurface of a survey is above.

    Args:
        mode: DistanceMode, which newer files have.
        relative: DistanceToSurfaceRelative, which older files have.
        follows_terrain: FollowTerrain, which older files have; it goes before ``relative``.

    Returns:
        The reference. It is unknown where no field tells it or two of them disagree.
    """
    newer = None if mode is None else _MEANT_AS.get(int(mode)) if mode == int(mode) else None
    if mode is not None and newer is None:
        return unknown("DistanceMode", f"DistanceMode is {mode:g}, which has no reference")
    older = None if relative is None else Above.HOME if relative else Above.SEA
    older = Above.GROUND if follows_terrain else older
    if newer is not None and older is not None and newer is not older:
        return unknown("DistanceMode", "DistanceMode contradicts DistanceToSurfaceRelative")
    if newer is not None:
        return known(newer, "DistanceMode")
    if older is not None:
        return known(older, "DistanceToSurfaceRelative")
    return unknown("DistanceMode", "neither DistanceMode nor DistanceToSurfaceRelative is there")
