"""Columns of tables of positions: their names tell the frame and the unit of the numbers."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from objconnect.scene.quantities.reading import Reading, known, unknown


class Frame(StrEnum):
    """What the numbers of a position are counted from."""

    MAP = "the map"
    EARTH = "the earth"


# The three axes of each frame, and all names that one column of it may have. A name that says
# nothing of its frame, as x, or that has another unit, as alt_ft, is not among them.
_AXES: Final = {
    Frame.MAP: (("e", "e_m"), ("n", "n_m"), ("u", "u_m")),
    Frame.EARTH: (
        ("lat", "latitude", "lat_deg", "latitude_deg"),
        ("lon", "longitude", "lon_deg", "longitude_deg"),
        ("alt", "altitude", "alt_m", "altitude_m"),
    ),
}
_OF: Final = {
    name: (frame, axis)
    for frame, axes in _AXES.items()
    for axis, names in enumerate(axes)
    for name in names
}

POSITION_COLUMNS: Final = (
    "write e, n, u (metres in the map's frame) or lat, lon, alt (degrees, metres)"
)
"""What a person can do about columns that are not known."""


@dataclass(frozen=True)
class PositionColumns:
    """The columns of a table that hold a position.

    Attributes:
        frame: what the numbers are counted from.
        horizontal: columns of east and north in metres, or of latitude and longitude in degrees.
        vertical: column of metres upwards; None where the table has none.
    """

    frame: Frame
    horizontal: tuple[str, str]
    vertical: str | None


def position_columns(header: Sequence[str], others: Collection[str]) -> Reading[PositionColumns]:
    """Return the columns of a table that hold a position.

    They are unknown where a column has no known meaning or unit, where two columns hold one
    number, or where numbers of both frames are given.

    Args:
        header: names of all columns.
        others: names of columns that are known and hold no position.

    Example:
        >>> position_columns(["name", "lat", "lon"], ["name"]).value
        PositionColumns(frame=<Frame.EARTH: 'the earth'>, horizontal=('lat', 'lon'), vertical=None)
        >>> position_columns(["name", "lat", "lon", "alt_ft"], ["name"]).why
        "the column 'alt_ft' has no known meaning or unit"
    """
    doubts = [
        f"the column {name!r} has no known meaning or unit"
        for name in header
        if name and name not in _OF and name not in others
    ]
    named: dict[Frame, dict[int, str]] = {}
    for name in header:
        if name in _OF:
            frame, axis = _OF[name]
            first = named.setdefault(frame, {}).setdefault(axis, name)
            if first != name:
                doubts.append(f"{first} and {name} are two columns for one number")
    if len(named) > 1:
        given = (", ".join(columns.values()) for columns in named.values())
        doubts.append(" and ".join(given) + " are of two frames")
    if not named:
        doubts.append("there are no columns of a position")
    for frame, columns in named.items():
        missing = [_AXES[frame][axis][0] for axis in (0, 1) if axis not in columns]
        doubts += [f"the column {name} is missing" for name in missing]
    if doubts:
        return unknown("the position", *doubts)
    ((frame, columns),) = named.items()
    return known(PositionColumns(frame, (columns[0], columns[1]), columns.get(2)), "the position")
