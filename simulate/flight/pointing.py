"""Viewing direction of a mission's camera: fixed angles, a region of interest, or unknown.

Angles are radians: headings clockwise from north, pitches above the horizon. Turns take no time
unless a plan states rates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from simulate.flight.commands import Command, Mav

Array = NDArray[np.float64]

# MAV_MOUNT_MODE.
_TARGETING, _GPS_POINT, _NEXT_WAYPOINT = 2, 4, 7
# MAV_ROI.
ROI_NONE, ROI_NEXT, ROI_LOCATION = 0, 1, 3
# Flags of the gimbal manager.
_RETRACT, _NEUTRAL, _YAW_LOCK, _IN_VEHICLE, _IN_EARTH = 1, 2, 16, 32, 64
# Input modes of MAV_CMD_DO_MOUNT_CONFIGURE.
_FROM_NOSE, _BY_RATE, _FROM_NORTH = 0, 1, 2

_HALF_TURN: Final = 180.0
_FULL_TURN: Final = 360.0
# Vectors with a smaller horizontal length are vertical: they have no heading.
_MIN_HORIZONTAL_M = 0.01


@dataclass(frozen=True)
class Angles:
    """Angles of the gimbal; the yaw is relative to the nose, or to north if locked."""

    pitch: float
    yaw: float = 0.0
    locked: bool = False


@dataclass(frozen=True)
class Region:
    """A region of interest: a point (3,) in world metres at which the camera looks."""

    point: Array


@dataclass(frozen=True)
class TowardsNext:
    """The direction to the next waypoint, with offset angles."""

    pitch: float
    yaw: float


@dataclass(frozen=True)
class Unknown:
    """A direction that the plan does not determine; ``why`` is a phrase for messages."""

    why: str


Aim = Angles | Region | TowardsNext | Unknown


class Gimbal:
    """The gimbal that executes a mission's commands.

    Attributes:
        aim: The current aim of the camera.
        turning_s: Duration of the last commanded turn, seconds.
    """

    def __init__(self, pitch_deg: float) -> None:
        """Point the camera along the nose at ``pitch_deg``.

        The camera returns to these angles after a region of interest.
        """
        self._default = Angles(math.radians(pitch_deg))
        self.aim: Aim = self._default
        self.turning_s = 0.0
        self._yaw_input = _FROM_NOSE
        self._angles_before: Aim = self._default  # the aim before a region of interest

    def look_at(self, aim: Aim) -> None:
        """Look at a region, or towards waypoints, until another command."""
        if isinstance(self.aim, Angles):
            self._angles_before = self.aim
        self.aim, self.turning_s = aim, 0.0

    def cancel(self) -> bool:
        """Return to the default angles if the camera looks at a region or towards a waypoint.

        Return whether this discards angles that were set before the region or waypoint.
        """
        had_set_angles = self._angles_before != self._default
        if isinstance(self.aim, Region | TowardsNext):
            self.aim, self._angles_before = self._default, self._default
            return had_set_angles
        return False

    def turn(self, command: Command) -> None:
        """Execute a command of the gimbal's mount or manager.

        Raises:
            InputError: A parameter is missing or not supported.
        """
        self.turning_s = 0.0
        match command.command:
            case Mav.MOUNT_CONFIGURE:
                self._configure(command)
            case Mav.MOUNT_CONTROL:
                self.aim = self._mount(command)
            case _:
                self.aim = self._manage(command)

    def direction(self, position: Array, nose: float, ahead: Array | None) -> tuple[float, float]:
        """Return heading and pitch of the camera.

        Args:
            position: Position (3,) of the camera, world metres.
            nose: Heading of the aircraft.
            ahead: Vector (3,) to the next waypoint, metres; None without one.

        Raises:
            InputError: The direction is unknown.
        """
        match self.aim:
            case Angles(pitch, yaw, locked):
                return (yaw if locked else nose + yaw), pitch
            case Region(region):
                return _direction(region - position, nose)
            case TowardsNext(pitch, yaw):
                along_nose = np.array([math.sin(nose), math.cos(nose), 0.0])
                heading, elevation = _direction(along_nose if ahead is None else ahead, nose)
                return heading + yaw, elevation + pitch
            case Unknown(why):
                raise InputError(
                    f"a photograph is taken while {why}: point the camera by angles before it"
                )

    def _configure(self, command: Command) -> None:
        """Execute MAV_CMD_DO_MOUNT_CONFIGURE."""
        inputs = [command.params[k] or 0 for k in (4, 5, 6)]
        known = {float(_FROM_NOSE), float(_BY_RATE), float(_FROM_NORTH)}
        if not known.issuperset(inputs) or _BY_RATE in inputs:
            raise command.error(
                "turns the camera by rates or unknown inputs (params[4] to params[6])",
                "point the camera by angles",
            )
        self._yaw_input = int(inputs[2])
        mode = command.number(0, "mode")
        if mode != _TARGETING:
            self.aim = Unknown(f"{command.title} has left the camera in mode {mode:g}")

    def _mount(self, command: Command) -> Aim:
        """Return the aim of MAV_CMD_DO_MOUNT_CONTROL in modes without a location."""
        mode = command.number(6, "mode")
        if mode != _TARGETING:
            return Unknown(f"{command.title} has left the camera in mode {mode:g}")
        _require_no_roll(command, 1)
        pitch, yaw = command.number(0, "pitch"), command.number(2, "yaw")
        _require_degrees(command, {0: _HALF_TURN, 2: _FULL_TURN})
        return Angles(math.radians(pitch), math.radians(yaw), self._yaw_input == _FROM_NORTH)

    def _manage(self, command: Command) -> Aim:
        """Return the aim of MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW."""
        pitch, yaw, pitch_rate, yaw_rate, stated_flags = command.params[:5]
        _require_degrees(command, {0: _HALF_TURN, 1: _FULL_TURN})
        flags = int(stated_flags or 0)
        if flags & (_RETRACT | _NEUTRAL):
            return Unknown(f"{command.title} has retracted the camera or left it neutral")
        locked = bool(flags & _YAW_LOCK)
        if yaw is not None:
            self._check_frame(command, stated_flags, locked)
        before = self.aim
        if not isinstance(before, Angles) and None in (pitch, yaw):
            return Unknown(f"{command.title} has set only one angle, or none")
        previous = before if isinstance(before, Angles) else None
        for angle, rate in ((pitch, pitch_rate), (yaw, yaw_rate)):
            if angle is None and rate:
                return Unknown(f"{command.title} turns the camera continuously")
        aim = Angles(
            previous.pitch if pitch is None and previous else math.radians(pitch or 0.0),
            previous.yaw if yaw is None and previous else math.radians(yaw or 0.0),
            previous.locked if yaw is None and previous else locked,
        )
        self.turning_s = _turning_s(previous, aim, (pitch_rate, yaw_rate))
        return aim

    def _check_frame(self, command: Command, stated_flags: float | None, locked: bool) -> None:
        """Require an unambiguous reference of the yaw."""
        both = _IN_VEHICLE | _IN_EARTH
        flags = int(command.number(4, "flags")) if stated_flags is None else int(stated_flags)
        if flags & (_IN_EARTH if not locked else _IN_VEHICLE) or flags & both == both:
            raise command.error(
                f"has flags {flags} (params[4]), by which its yaw is relative to both north and "
                "the nose",
                "set 80 for a yaw from north or 32 for a yaw from the nose",
            )


def mount_roi_mode(command: Command) -> int | None:
    """Return the MAV_ROI mode of MAV_CMD_DO_MOUNT_CONTROL; None without a region of interest.

    Raises:
        InputError: The command looks at the next waypoint, or its mode is missing.
    """
    mode = command.number(6, "mode")
    if command.command == Mav.MOUNT_CONTROL and mode == _NEXT_WAYPOINT:
        raise command.error("looks at the next waypoint with an offset", "use DO_SET_ROI_WPNEXT")
    return ROI_LOCATION if mode == _GPS_POINT else None


def towards_next(command: Command) -> TowardsNext:
    """Return the aim of a command with offsets of pitch, roll and yaw."""
    _require_no_roll(command, 5)
    _require_degrees(command, {4: _HALF_TURN, 6: _FULL_TURN})
    pitch, yaw = (math.radians(command.params[k] or 0.0) for k in (4, 6))
    return TowardsNext(pitch, yaw)


def _require_no_roll(command: Command, index: int) -> None:
    if command.params[index]:
        raise command.error(
            f"rolls the camera (params[{index}]), which is not supported", "set the roll to 0"
        )


def _require_degrees(command: Command, max_degrees: dict[int, float]) -> None:
    """Require that the absolute angles do not exceed their maxima, by index of the parameter."""
    for index, degrees in max_degrees.items():
        angle = command.params[index]
        if angle is not None and abs(angle) > degrees:
            raise command.error(
                f"turns the camera by {angle:g} degrees (params[{index}]), which is out of range",
                "set it in degrees, not in hundredths",
            )


def _direction(vector: Array, nose: float) -> tuple[float, float]:
    """Return heading and pitch of a vector (3,); a vertical one has the heading of the nose."""
    horizontal = float(np.hypot(vector[0], vector[1]))
    heading = nose if horizontal < _MIN_HORIZONTAL_M else math.atan2(vector[0], vector[1])
    return heading, math.atan2(vector[2], horizontal)


def _turning_s(
    before: Angles | None, after: Angles, rates: tuple[float | None, float | None]
) -> float:
    """Return the duration of a turn at rates in degrees per second; 0 without rates.

    From unknown angles, or between a yaw from north and one from the nose, a full turn is assumed.
    """
    turns = [_FULL_TURN, _FULL_TURN]
    if before is not None and before.locked == after.locked:
        turns = [
            abs(math.degrees(after.pitch - before.pitch)),
            abs(math.degrees(after.yaw - before.yaw)),
        ]
    return max(
        (turn / abs(rate) if rate else 0.0 for turn, rate in zip(turns, rates, strict=True)),
        default=0.0,
    )
