"""Simulate an aircraft that executes the commands of a mission and takes photographs.

Commands and frames are MAVLink's: https://mavlink.io/en/messages/common.html. A command between two
waypoints is executed at the first one, as all autopilots do; a command delayed by a condition is
executed on the way to the second. The path of a landing or a spline is unknown, so photographs on
it are refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.quantities.mission_heights import HeightReference
from simulate.flight.commands import (
    CAPTURES,
    CONDITIONS,
    DOUBTFUL,
    FLY_TO,
    HARMLESS,
    LANDINGS,
    NAVIGATION,
    Command,
    Mav,
)
from simulate.flight.context import MAX_PHOTOGRAPHS
from simulate.flight.gimbal import Aims
from simulate.flight.jumps import unroll
from simulate.flight.pointing import (
    ROI_LOCATION,
    ROI_NEXT,
    ROI_NONE,
    Gimbal,
    Region,
    mount_roi_mode,
    towards_next,
)
from simulate.flight.positions import Positions
from simulate.flight.trigger import Triggers, too_many_photographs
from simulate.flight.vehicle import Vehicle

Array = NDArray[np.float64]

_SAME_M = _SAME_S = 1e-6  # tolerance of distances (m) and times (s)
_AT_HOME_M = 1.0  # a takeoff within this horizontal distance of home has no position of its own


class Aircraft:
    """Executes commands in order and collects the exposures.

    The aircraft starts on the ground at home. Without a yaw, its nose points along the path.
    """

    def __init__(self, vehicle: Vehicle, pitch_deg: float, positions: Positions) -> None:
        """Start at home, with the camera along the nose at ``pitch_deg``."""
        self._vehicle, self._positions = vehicle, positions
        self._position = positions.home.copy()
        self._nose = 0.0  # heading of the nose, radians
        self._held_nose: float | None = None  # heading set by a command, for one leg
        self._gimbal, self._triggers = Gimbal(pitch_deg), Triggers()
        self._turning_s = 0.0  # remaining time of the camera's turn
        # Reason why the position is unknown; None where it is known.
        self._unknown_because: str | None = "the aircraft is not at its first waypoint"
        self._next: Array | None = None  # position of the next navigation command
        self._leg: Array | None = None  # vector (3,) of the last leg, metres
        self._exposures: list[tuple[float, ...]] = []

    @property
    def warnings(self) -> list[str]:
        """Return warnings for the user, one phrase each."""
        return self._triggers.warnings

    def fly(self, commands: Sequence[Command]) -> Aims:
        """Fly a mission and return its exposures.

        A mission without camera triggers takes a photograph at every waypoint.

        Raises:
            InputError: A command cannot be executed, or there are too many photographs.
        """
        triggered = any(command.command in CAPTURES for command in commands)
        rest = unroll(commands)
        while rest:
            todo = list(takewhile(lambda c: c.command not in NAVIGATION, rest))
            goal, rest = next(iter(rest[len(todo) :]), None), rest[len(todo) + 1 :]
            conditions = [k for k, command in enumerate(todo) if command.command in CONDITIONS]
            first = conditions[0] if conditions else len(todo)
            self._next = self._positions.target(goal, self._position)
            for command in todo[:first]:
                self._execute(command)
            if goal is None:
                _require_executed(todo[first:], "the mission ends")
                break
            if goal.command in LANDINGS:
                _require_executed(todo[first:], f"{goal.title} begins")
                if self._land(goal, rest):
                    break
            self._navigate(goal, todo[first:])
            if not triggered and goal.command in (Mav.WAYPOINT, Mav.SPLINE_WAYPOINT):
                self._photograph(self._position)
        self._warn_of_remaining()
        exposures = np.array(self._exposures).reshape(-1, 5)
        return Aims(exposures[:, :3], exposures[:, 3], exposures[:, 4])

    def waypoints(self, commands: Sequence[Command]) -> Array:
        """Return the positions of the mission's waypoints, (K, 3) metres."""
        goals = [self._positions.target(c, self._position) for c in commands if c.command in FLY_TO]
        return np.array([p for p in goals if p is not None]).reshape(-1, 3)

    def _execute(self, command: Command) -> None:
        """Execute a command that does not move the aircraft."""
        number = command.command
        if number in CAPTURES or number == Mav.STOP_CAPTURE:
            self._trigger_camera(command)
        elif number == Mav.CHANGE_SPEED:
            self._vehicle.change_speed(command)
        elif number == Mav.VTOL_TRANSITION:
            self._vehicle.transition(command)
        elif number == Mav.CONDITION_YAW:
            self._turn_nose(command)
        elif number in (Mav.ROI, Mav.NAV_ROI, Mav.ROI_LOCATION, Mav.ROI_NEXT, Mav.ROI_NONE):
            self._set_region(command)
        elif number == Mav.MOUNT_CONTROL and mount_roi_mode(command) is not None:
            self._gimbal.look_at(Region(self._positions.mount_target_position(command)))
        elif number in (Mav.MOUNT_CONFIGURE, Mav.MOUNT_CONTROL, Mav.GIMBAL_PITCHYAW):
            self._gimbal.turn(command)
            self._turning_s = self._gimbal.turning_s
        elif number == Mav.GUIDED_ENABLE and not command.params[0]:
            pass
        elif number in DOUBTFUL:
            self.warnings.append(f"{command.title} is ignored")
        elif number not in HARMLESS:
            raise command.error("is not supported", "remove it from the plan")

    def _trigger_camera(self, command: Command) -> None:
        """Execute a command that triggers the camera now or later."""
        at_once = self._triggers.execute(command)
        if self._unknown_because and (at_once or self._triggers.command):
            raise command.error(
                f"triggers the camera while {self._unknown_because}", "trigger it after a waypoint"
            )
        if at_once:
            self._photograph(self._position)

    def _set_region(self, command: Command) -> None:
        """Execute a command that sets or cancels a region of interest."""
        mode = {Mav.ROI_LOCATION: ROI_LOCATION, Mav.ROI_NEXT: ROI_NEXT, Mav.ROI_NONE: ROI_NONE}.get(
            Mav(command.command)
        )
        has_location = any(command.params[k] for k in (4, 5, 6))
        if mode is None:
            mode = int(command.number(0, "mode"))
            if mode == ROI_NONE and has_location:
                if not (self._vehicle.is_ardupilot or self._vehicle.is_px4):
                    raise command.error(
                        "has mode 0, none (params[0]), and a location", "set mode 3 for a location"
                    )
                mode = ROI_LOCATION if self._vehicle.is_ardupilot else ROI_NONE
        if mode == ROI_LOCATION and not has_location and self._vehicle.is_ardupilot:
            mode = ROI_NONE  # ArduPilot cancels the region
        self._turning_s = 0.0
        if mode == ROI_LOCATION:
            self._gimbal.look_at(Region(self._positions.position_of(command)))
        elif mode == ROI_NEXT:
            self._gimbal.look_at(towards_next(command))
        elif mode == ROI_NONE:
            if self._gimbal.cancel():
                self.warnings.append(
                    f"{command.title} returns the camera to its initial pitch, not to its pitch "
                    "before the region of interest"
                )
        else:
            raise command.error(f"has mode {mode} (params[0]), which is not supported", "set 3")

    def _turn_nose(self, command: Command) -> None:
        """Execute MAV_CMD_CONDITION_YAW, which is in effect until the next waypoint."""
        angle = math.radians(command.number(0, "angle"))
        if relative := command.number(3, "relative"):
            if relative != 1:
                raise command.error(f"has params[3] {relative:g}", "set 0 or 1")
            direction = command.number(2, "direction")
            angle = self._nose + (-angle if direction < 0 else angle)
        self._nose = self._held_nose = angle

    def _navigate(self, goal: Command, waiting: list[Command]) -> None:
        """Execute a navigation command; on the way, the conditions and commands in ``waiting``."""
        hovers = goal.command == Mav.LOITER_TIME and not self._vehicle.flies_forward
        if goal.command == Mav.WAYPOINT or hovers:
            if goal.command == Mav.WAYPOINT:
                self._check_waypoint(goal)
            self._fly_to(goal, waiting)
            if not self._vehicle.flies_forward:
                self._hold(goal)
            return
        _require_executed(waiting, f"{goal.title} begins")
        if goal.command == Mav.DELAY and not self._vehicle.flies_forward:
            self._hold(goal)
            return
        if (trigger := self._triggers.command) is not None:
            raise goal.error(
                f"flies an unknown path, while {trigger.title} triggers the camera",
                "stop the camera before it",
            )
        match goal.command:
            case Mav.LOITER_UNLIMITED:
                raise goal.error("never ends", "set a time by NAV_LOITER_TIME")
            case Mav.TAKEOFF | Mav.VTOL_TAKEOFF:
                self._take_off(goal)
            case Mav.SPLINE_WAYPOINT:
                self._fly_to(goal, [])
            case Mav.LAND | Mav.VTOL_LAND:
                self._arrive(goal, f"the aircraft is on the ground after {goal.title}")
                self._vehicle.enter(forward=False)
            case _:
                circles = goal.command == Mav.LOITER_TURNS or self._vehicle.flies_forward
                self._arrive(goal, f"the aircraft circles after {goal.title}" if circles else None)

    def _check_waypoint(self, goal: Command) -> None:
        if goal.params[2]:
            raise goal.error(
                f"is passed at a radius of {goal.params[2]:g} m (params[2])", "set it to 0"
            )
        if self._vehicle.is_ardupilot and goal.params[3]:
            self.warnings.append(f"{goal.title} has a yaw, which ArduPilot ignores")

    def _take_off(self, goal: Command) -> None:
        """Climb to the height of a takeoff, and fly to its position if it has one."""
        target = self._positions.target(goal, self._position)
        assert target is not None
        away = float(np.hypot(*(target - self._position)[:2])) > _AT_HOME_M
        self._nose = self._nose if goal.params[3] is None else math.radians(goal.params[3])
        self._unknown_because = None
        if goal.command == Mav.VTOL_TAKEOFF:
            self._vehicle.enter(forward=True)
        if self._vehicle.flies_forward or (away and not self._vehicle.is_px4):
            self._unknown_because = f"the aircraft climbs after {goal.title}"
        if self._vehicle.is_ardupilot and not self._vehicle.flies_forward:
            target[:2], self._unknown_because = self._position[:2], None
        self._position, self._leg, self._held_nose = target, None, None

    def _land(self, goal: Command, rest: Sequence[Command]) -> bool:
        """Land, and return whether the flight is over."""
        flies_on = goal.command != Mav.RETURN_TO_LAUNCH and any(
            c.command in NAVIGATION for c in rest
        )
        if not flies_on:
            if self._triggers.command is not None:
                self.warnings.append(
                    f"no photographs are taken from {goal.title} on, although "
                    f"{self._triggers.command.title} continues: the path is unknown"
                )
            if any(c.command in (*CAPTURES, *FLY_TO) for c in rest):
                self.warnings.append(f"commands after {goal.title} are ignored")
        return not flies_on

    def _arrive(self, goal: Command, unknown_because: str | None) -> None:
        """Move to a command's position; ``unknown_because`` says why it is not exactly known."""
        target = self._positions.target(goal, self._position)
        self._position = self._position if target is None else target
        self._leg, self._held_nose, self._unknown_because = None, None, unknown_because

    def _fly_to(self, goal: Command, waiting: list[Command]) -> None:
        """Fly straight to a position; in a frame above the ground, follow the terrain."""
        target = self._positions.target(goal, self._position)
        assert target is not None
        start, leg = self._position, target - self._position
        length = float(np.linalg.norm(leg))
        yaw = goal.params[3] if goal.command == Mav.WAYPOINT else None
        if yaw is not None and not (self._vehicle.is_ardupilot or self._vehicle.flies_forward):
            self._nose = math.radians(yaw)
        elif self._held_nose is not None:
            self._nose = self._held_nose
        elif np.linalg.norm(leg[:2]) > 0.01:
            self._nose = math.atan2(leg[0], leg[1])
        self._leg = leg if length > 0.01 else self._leg
        ground_height = self._positions.ground_height
        heights = start[2] - ground_height(start), target[2] - ground_height(target)
        follow = goal.height_reference() is HeightReference.GROUND

        def position_at(flown: float) -> Array:
            share = flown / length if length else 0.0
            here = start + share * leg
            if follow:
                here[2] = ground_height(here) + (1 - share) * heights[0] + share * heights[1]
            return np.asarray(here)

        if self._unknown_because and self._triggers.command:
            raise self._triggers.command.error(
                f"triggers the camera while {self._unknown_because}", "trigger it after a waypoint"
            )
        flown = 0.0
        while waiting:
            condition, waiting = waiting[0], waiting[1:]
            todo = list(takewhile(lambda c: c.command not in CONDITIONS, waiting))
            waiting = waiting[len(todo) :]
            if not todo:
                continue
            condition_m = self._distance_until(condition, start, target, flown)
            if not flown - _SAME_M <= condition_m <= length + _SAME_M:
                raise condition.error(
                    f"is not met on the way to {goal.where}, so {todo[0].title} is not executed",
                    "correct its value",
                )
            self._advance(position_at, flown, condition_m)
            flown, self._position = condition_m, position_at(condition_m)
            for command in todo:
                self._execute(command)
        self._advance(position_at, flown, length)
        self._position, self._held_nose, self._unknown_because = target, None, None

    def _distance_until(
        self, condition: Command, start: Array, target: Array, flown: float
    ) -> float:
        """Return the distance along a leg at which a condition is met, metres."""
        leg = target - start
        length, horizontal = float(np.linalg.norm(leg)), float(np.hypot(leg[0], leg[1]))
        if condition.command == Mav.CONDITION_DELAY:
            return flown + condition.number(0, "delay") * self._vehicle.speed(condition)
        if horizontal < 0.01:
            raise condition.error("is on a vertical leg", "remove it")
        if condition.command == Mav.CONDITION_DISTANCE:
            left = condition.number(0, "distance")
            return max(length * (1 - left / horizontal), flown)
        gate = self._positions.position_of(condition)
        return float((gate - start)[:2] @ leg[:2]) / horizontal**2 * length

    def _advance(self, position_at: Callable[[float], Array], flown: float, until: float) -> None:
        """Fly along a leg from ``flown`` to ``until`` metres, and take photographs."""
        timer = self._triggers.timer
        speed = self._vehicle.speed_or_none() if timer is None else self._vehicle.speed(timer)
        left = max(until - flown, 0.0)
        self._triggers.require_few_photographs(left, left / speed if speed else 0.0)
        while True:
            step = min(self._triggers.next_distance_m(speed), left)
            time_s = step / speed if speed else 0.0
            due = self._triggers.advance(step, time_s)
            self._turning_s -= time_s
            flown, left = flown + step, left - step
            for _ in range(due):
                self._photograph(position_at(flown))
            if left <= 0 and not due:
                break

    def _hold(self, command: Command) -> None:
        """Hover for the time in a command's first parameter, and take photographs."""
        timer = self._triggers.timer
        if timer is None and self._turning_s <= 0:
            return
        left = command.number(0, "time")
        if left < 0:
            raise command.error(f"waits for {left:g} s (params[0])", "set the time in seconds")
        if left and self._vehicle.kind is None:
            raise command.error(
                "waits, but vehicleType is missing", "save the plan in QGroundControl"
            )
        self._triggers.require_few_photographs(0.0, left)
        while True:
            step = min(self._triggers.next_time_s(), left)
            due = self._triggers.advance(0.0, step)
            self._turning_s, left = self._turning_s - step, left - step
            for _ in range(due):
                self._photograph(self._position)
            if left <= 0 and not due:
                break

    def _photograph(self, position: Array) -> None:
        if self._turning_s > _SAME_S:
            raise InputError(
                f"a photograph is taken while the camera turns, {self._turning_s:.1f} s before the "
                "turn ends: turn it earlier, or remove the rate"
            )
        if len(self._exposures) >= MAX_PHOTOGRAPHS:
            raise too_many_photographs()
        ahead = None if self._next is None else self._next - position
        if ahead is None or np.linalg.norm(ahead) < 0.01:
            ahead = self._leg
        heading, pitch = self._gimbal.direction(position, self._nose, ahead)
        self._exposures.append((*position, heading, pitch))

    def _warn_of_remaining(self) -> None:
        for repeater in self._triggers.running.values():
            if repeater.count:
                self.warnings.append(
                    f"{repeater.command.title} has {repeater.count} photographs left when the "
                    "flight ends"
                )


def _require_executed(waiting: Sequence[Command], before: str) -> None:
    """Require that no command still waits for a condition."""
    left = [c for c in waiting if c.command not in CONDITIONS and c.command not in HARMLESS]
    if left:
        raise waiting[0].error(
            f"is not met before {before}, so {left[0].title} is not executed", "correct its value"
        )
