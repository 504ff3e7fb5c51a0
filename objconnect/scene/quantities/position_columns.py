"""Position columns of tables: their names determine frame and unit."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from objconnect.scene.quantities.reading import Reading, known, unknown


class CoordinateFrame(StrEnum):
    """The coordinate frame of a position."""

    MAP = "the map"
    EARTH = "the earth"


# Accepted column names by frame and axis. Names without a frame (x) or with another unit (alt_ft)
# are not accepted.
_AXES: Final = {
    CoordinateFrame.MAP: (("e", "e_m"), ("n", "n_m"), ("u", "u_m")),
    CoordinateFrame.EARTH: (
        ("lat", "latitude", "lat_deg", "latitude_deg"),
        ("lon", "longitude", "lon_deg", "longitude_deg"),
        ("alt", "altitude", "alt_m", "altitude_m"),
    ),
}
_FRAME_AND_AXIS: Final = {
    name: (frame, axis)
    for frame, axes in _AXES.items()
    for axis, names in enumerate(axes)
    for name in names
}

POSITION_COLUMNS: Final = (
    "write e, n, u (metres in the map's frame) or lat, lon, alt (degrees, metres)"
)
"""The remedy in messages about unknown columns."""


@dataclass(frozen=True)
class PositionColumns:
    """The columns of a table that hold a position.

    Attributes:
        frame: frame of the numbers.
        horizontal: columns of east and north in metres, or of latitude and longitude in degrees.
        vertical: column of the height in metres; None if the table has none.
    """

    frame: CoordinateFrame
    horizontal: tuple[str, str]
    vertical: str | None


def position_columns(header: Sequence[str], others: Collection[str]) -> Reading[PositionColumns]:
    """Return the columns of a table that hold a position.

    They are unknown if a column has no known meaning or unit, if two columns hold the same number,
    or if the table has columns of both frames.

    Args:
        header: names of all columns.
        others: names of known columns that hold no position.

    Examples:
        >>> columns = position_columns(["name", "lat", "lon"], ["name"]).value
        >>> columns.frame, columns.horizontal, columns.vertical
        (<CoordinateFrame.EARTH: 'the earth'>, ('lat', 'lon'), None)
        >>> position_columns(["name", "lat", "lon", "alt_ft"], ["name"]).why
        "the column 'alt_ft' has no known meaning or unit"
    """
    doubts = [
        f"the column {name!r} has no known meaning or unit"
        for name in header
        if name and name not in _FRAME_AND_AXIS and name not in others
    ]
    named: dict[CoordinateFrame, dict[int, str]] = {}
    for name in header:
        if name in _FRAME_AND_AXIS:
            frame, axis = _FRAME_AND_AXIS[name]
            first = named.setdefault(frame, {}).setdefault(axis, name)
            if first != name:
                doubts.append(f"{first} and {name} are two columns for one number")
    if len(named) > 1:
        columns_of_frame = (", ".join(columns.values()) for columns in named.values())
        doubts.append(" and ".join(columns_of_frame) + " are of two frames")
    if not named:
        doubts.append("there are no columns of a position")
    for frame, columns in named.items():
        missing = [_AXES[frame][axis][0] for axis in (0, 1) if axis not in columns]
        doubts += [f"the column {name} is missing" for name in missing]
    if doubts:
        return unknown("the position", *doubts)
    ((frame, columns),) = named.items()
    return known(PositionColumns(frame, (columns[0], columns[1]), columns.get(2)), "the position")
