"""Poses in results files, and in journals that resume interrupted runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.storage.records import Record

if TYPE_CHECKING:
    from objconnect.scene.geometry.pose import Pose

_Number = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
PoseNumbers = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number]
"""A pose as qw qx qy qz tx ty tz."""


class NamedRecord(Record):
    """An entry of a journal with the name of its photograph as its key."""

    name: str


def pose_of(numbers: PoseNumbers) -> Pose:
    """Convert qw qx qy qz tx ty tz to a pose."""
    from objconnect.scene.geometry.pose import Pose  # imported here, because it loads torch

    return Pose.from_quaternion(numbers[:4], numbers[4:])
