"""Names of files and slices in Extended CMU Seasons.

The name of a photograph contains its camera, c0 or c1, and its time. Each slice lies in one kind of
surroundings.
"""

from __future__ import annotations

import re
from datetime import UTC, date, datetime, timedelta
from typing import Final, Literal, NamedTuple

from objconnect.scene.errors import InputError

# First line of intrinsics.txt of simulated photographs. It keeps their results from being taken for
# results on the real data set, whose files have the same names.
SIMULATED_HEADER: Final = "# simulated by ObjConnect"

CAMERAS: Final = ("c0", "c1")
FIRST_SLICES: Final = {"urban": 2, "suburban": 9, "park": 18}
"""Number of the first slice of each kind of surroundings."""

_IMAGE: Final = re.compile(r"img_(\d+)_(c[01])_(\d+)us\.jpg")
# The time zone of Pittsburgh, which decides the day of a photograph.
_UTC_OFFSET: Final = timedelta(hours=-5)


class ImageName(NamedTuple):
    """The parts of an image's name: number, camera and microseconds since 1970 (UTC)."""

    number: int
    camera: str
    microseconds: int

    @staticmethod
    def parse(name: str) -> ImageName:
        """Read the name of a file.

        Raises:
            InputError: the name is not one of this data set.
        """
        match = _IMAGE.fullmatch(name)
        if match is None:
            raise InputError(
                f"image {name!r} is not named like img_00119_c0_1303398474779439us.jpg"
            )
        return ImageName(int(match[1]), match[2], int(match[3]))

    @staticmethod
    def matches(name: str) -> bool:
        """Return whether the name of a file is one of this data set."""
        return _IMAGE.fullmatch(name) is not None

    @property
    def day(self) -> date:
        """Return the day of the photograph in the time zone of the data set."""
        return (datetime.fromtimestamp(self.microseconds / 1e6, UTC) + _UTC_OFFSET).date()

    def __str__(self) -> str:
        return f"img_{self.number:05d}_{self.camera}_{self.microseconds}us.jpg"


def surroundings(number: int) -> Literal["urban", "suburban", "park"]:
    """Return the surroundings of a slice by its number."""
    if number < FIRST_SLICES["suburban"]:
        return "urban"
    return "suburban" if number < FIRST_SLICES["park"] else "park"
