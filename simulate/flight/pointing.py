"""Where the camera of a mission looks: at angles, at a region of interest, or nobody knows where.

Angles are radians: headings clockwise from north, pitches above the horizon. Turns take no time
unless a plan states their rates.
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
# Rotations that a plan may state in MAV_CMD_DO_MOUNT_CONFIGURE.
_FROM_NOSE, _BY_RATE, _FROM_NORTH = 0, 1, 2

_HALF_TURN: Final = 180.0
_FULL_TURN: Final = 360.0
_LOOKS_STRAIGHT_M = 0.01  # closer to the vertical than this, a direction has no heading


@dataclass(frozen=True)
class Angles:
    """Angles of the gimbal; the yaw counts from the nose, or from north where it is locked."""

    pitch: float
    yaw: float = 0.0
    locked: bool = False


@dataclass(frozen=True)
class Region:
    """A place (3,) in world metres at which the camera looks from everywhere."""

    place: Array


@dataclass(frozen=True)
class TowardsNext:
    """The direction of the next waypoint, and angles that are added to it."""

    pitch: float
    yaw: float


@dataclass(frozen=True)
class Anywhere:
    """A direction that the plan does not tell; ``why`` is a phrase for messages."""

    why: str


Aim = Angles | Region | TowardsNext | Anywhere


class Gimbal:
    """Holds the camera as the commands of a mission ask.

    Attributes:
        aim: What the camera looks at now.
        turning_s: How long the last command to turn takes, seconds.
    """

    def __init__(self, pitch_deg: float) -> None:
        """Point the camera along the nose at a pitch, to which it returns after a region."""
        self._usual = Angles(math.radians(pitch_deg))
        self.aim: Aim = self._usual
        self.turning_s = 0.0
        self._yaw_input = _FROM_NOSE
        self._before: Aim = self._usual

    def look_at(self, aim: Aim) -> None:
        """Look at a region, or towards waypoints, until another command."""
        if isinstance(self.aim, Angles):
            self._before = self.aim
        self.aim, self.turning_s = aim, 0.0

    def cancel(self) -> bool:
        """Return to the usual angles after a region; tell whether the plan had set others."""
        had_others = self._before != self._usual
        if isinstance(self.aim, Region | TowardsNext):
            self.aim, self._before = self._usual, self._usual
            return had_others
        return False

    def turn(self, command: Command) -> None:
        """Obey a command of the gimbal's angles, of its mount or of its manager.

        Raises:
            InputError: A parameter is missing or has a meaning that is not followed.
        """
        self.turning_s = 0.0
        match command.command:
            case Mav.MOUNT_CONFIGURE:
                self._configure(command)
            case Mav.MOUNT_CONTROL:
                self.aim = self._mount(command)
            case _:
                self.aim = self._manage(command)

    def direction(self, place: Array, nose: float, ahead: Array | None) -> tuple[float, float]:
        """Return heading and pitch of the camera.

        Args:
            place: Where the camera is, (3,) world metres.
            nose: Heading of the aircraft.
            ahead: The way (3,) to the next waypoint, metres; None where there is none.

        Raises:
            InputError: The plan does not tell where the camera looks.
        """
        match self.aim:
            case Angles(pitch, yaw, locked):
                return (yaw if locked else nose + yaw), pitch
            case Region(region):
                return _direction(region - place, nose)
            case TowardsNext(pitch, yaw):
                way = np.array([math.sin(nose), math.cos(nose), 0.0]) if ahead is None else ahead
                heading, elevation = _direction(way, nose)
                return heading + yaw, elevation + pitch
            case Anywhere(why):
                raise InputError(
                    f"a photograph is taken while {why}: point the camera by angles before it"
                )

    def _configure(self, command: Command) -> None:
        """Obey MAV_CMD_DO_MOUNT_CONFIGURE."""
        inputs = [command.params[k] or 0 for k in (4, 5, 6)]
        known = {float(_FROM_NOSE), float(_BY_RATE), float(_FROM_NORTH)}
        if not known.issuperset(inputs) or _BY_RATE in inputs:
            raise command.fault(
                "turns the camera by rates or unknown inputs (params[4] to params[6])",
                "point the camera by angles",
            )
        self._yaw_input = int(inputs[2])
        mode = command.number(0, "mode")
        if mode != _TARGETING:
            self.aim = Anywhere(f"{command.title} has left the camera in mode {mode:g}")

    def _mount(self, command: Command) -> Aim:
        """Return the aim of MAV_CMD_DO_MOUNT_CONTROL, but for modes that look at places."""
        mode = command.number(6, "mode")
        if mode != _TARGETING:
            return Anywhere(f"{command.title} has left the camera in mode {mode:g}")
        _require_level(command, 1)
        pitch, yaw = command.number(0, "pitch"), command.number(2, "yaw")
        _require_degrees(command, {0: _HALF_TURN, 2: _FULL_TURN})
        return Angles(math.radians(pitch), math.radians(yaw), self._yaw_input == _FROM_NORTH)

    def _manage(self, command: Command) -> Aim:
        """Return the aim of MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW."""
        pitch, yaw, pitch_rate, yaw_rate, flags_now = command.params[:5]
        _require_degrees(command, {0: _HALF_TURN, 1: _FULL_TURN})
        flags = int(flags_now or 0)
        if flags & (_RETRACT | _NEUTRAL):
            return Anywhere(f"{command.title} has retracted the camera or left it neutral")
        locked = bool(flags & _YAW_LOCK)
        if yaw is not None:
            self._check_frame(command, flags_now, locked)
        before = self.aim
        if not isinstance(before, Angles) and None in (pitch, yaw):
            return Anywhere(f"{command.title} has set only one angle, or none")
        was = before if isinstance(before, Angles) else None
        for angle, rate in ((pitch, pitch_rate), (yaw, yaw_rate)):
            if angle is None and rate:
                return Anywhere(f"{command.title} turns the camera on and on")
        aim = Angles(
            was.pitch if pitch is None and was else math.radians(pitch or 0.0),
            was.yaw if yaw is None and was else math.radians(yaw or 0.0),
            was.locked if yaw is None and was else locked,
        )
        self.turning_s = _turning_s(was, aim, (pitch_rate, yaw_rate))
        return aim

    def _check_frame(self, command: Command, flags_now: float | None, locked: bool) -> None:
        """Require that it is known from where the yaw counts."""
        flags = int(command.number(4, "flags")) if flags_now is None else int(flags_now)
        if flags & (_IN_EARTH if not locked else _IN_VEHICLE) or flags & 96 == 96:
            raise command.fault(
                f"has flags {flags} (params[4]), by which its yaw counts from north and from the "
                "nose at once",
                "set 80 for a yaw from north or 32 for a yaw from the nose",
            )


def mount_target(command: Command) -> int | None:
    """Return the mode of MAV_ROI that MAV_CMD_DO_MOUNT_CONTROL asks for; None where none."""
    mode = command.number(6, "mode")
    if command.command == Mav.MOUNT_CONTROL and mode == _NEXT_WAYPOINT:
        raise command.fault("looks at the next waypoint with an offset", "use DO_SET_ROI_WPNEXT")
    return ROI_LOCATION if mode == _GPS_POINT else None


def towards_next(command: Command) -> TowardsNext:
    """Return the aim of a command whose last parameters are offsets of pitch, roll and yaw."""
    _require_level(command, 5)
    _require_degrees(command, {4: _HALF_TURN, 6: _FULL_TURN})
    pitch, yaw = (math.radians(command.params[k] or 0.0) for k in (4, 6))
    return TowardsNext(pitch, yaw)


def _require_level(command: Command, index: int) -> None:
    if command.params[index]:
        raise command.fault(
            f"rolls the camera (params[{index}]), which cannot be flown", "set the roll to 0"
        )


def _require_degrees(command: Command, most: dict[int, float]) -> None:
    """Require that parameters are at most so many degrees, either way."""
    for index, degrees in most.items():
        angle = command.params[index]
        if angle is not None and abs(angle) > degrees:
            raise command.fault(
                f"turns the camera by {angle:g} degrees (params[{index}]), which no camera can",
                "set it in degrees, not in hundredths",
            )


def _direction(way: Array, nose: float) -> tuple[float, float]:
    """Return heading and pitch of a way (3,); straight up and down, the heading is the nose's."""
    level = float(np.hypot(way[0], way[1]))
    heading = nose if level < _LOOKS_STRAIGHT_M else math.atan2(way[0], way[1])
    return heading, math.atan2(way[2], level)


def _turning_s(
    before: Angles | None, after: Angles, rates: tuple[float | None, float | None]
) -> float:
    """Return how long a turn takes at rates in degrees per second; at no rate, it takes no time."""
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
