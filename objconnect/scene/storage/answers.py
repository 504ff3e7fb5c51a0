"""Entries of files and journals that hold a pose of a photograph."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.records import Record

_Number = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
PoseNumbers = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number]
"""A pose as qw qx qy qz tx ty tz."""


class Named(Record):
    """An entry of a journal, which is identified by the name of its photograph."""

    name: str


def pose_of(numbers: PoseNumbers) -> Pose:
    """Return the pose that a results file holds as qw qx qy qz tx ty tz."""
    return Pose.from_quaternion(numbers[:4], numbers[4:])
