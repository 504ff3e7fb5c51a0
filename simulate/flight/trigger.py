"""Camera triggers of a mission: by distance, by time and by capture sequence."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from objconnect.scene.errors import InputError
from simulate.flight.commands import Command, Mav
from simulate.flight.context import MAX_PHOTOGRAPHS

# Tolerance of distances (m) and times (s) at which a photograph is due.
_TOLERANCE = 1e-6
_SECONDS_PER_MS = 0.001
# Minimum time (s) between photographs of a drone's camera.
_MIN_INTERVAL_S = 0.05
# A restarted distance trigger takes a photograph at once only if the last one is farther away (m).
_MIN_DISTANCE_M = 0.1


@dataclass
class Repeater:
    """A trigger that takes photographs repeatedly.

    Attributes:
        interval: Metres or seconds between photographs.
        remaining: Metres or seconds to the next photograph.
        is_timer: Whether ``interval`` and ``remaining`` are seconds.
        count: Number of photographs left; None is unlimited.
        command: The command that started the trigger.
        since_m: Distance since the last photograph that was due, metres. Photographs that a command
            takes at once do not count.
    """

    interval: float
    remaining: float
    is_timer: bool
    count: int | None
    command: Command
    since_m: float = math.inf

    def advance(self, distance_m: float, time_s: float) -> None:
        """Advance by a distance and the time that it took."""
        self.remaining -= time_s if self.is_timer else distance_m
        self.since_m += distance_m

    def take_if_due(self) -> bool:
        """Return whether a photograph is due, and count it if so."""
        if self.remaining > _TOLERANCE or self.count == 0:
            return False
        self.remaining += self.interval
        self.since_m = 0.0
        if self.count is not None:
            self.count -= 1
        return True


@dataclass
class Triggers:
    """The concurrent triggers of a camera.

    Attributes:
        running: Running triggers, by the command that starts their kind.
        paused: Triggers that can be resumed.
        warnings: Warnings for the user, one phrase each.
    """

    running: dict[Mav, Repeater] = field(default_factory=dict)
    paused: dict[Mav, Repeater] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    @property
    def command(self) -> Command | None:
        """The command of a trigger with photographs left; None without one."""
        return next((r.command for r in self.running.values() if r.count != 0), None)

    @property
    def timer(self) -> Command | None:
        """The command of a running trigger by time; None without one."""
        return next((r.command for r in self.running.values() if r.is_timer and r.count != 0), None)

    def execute(self, command: Command) -> bool:
        """Start or stop a trigger, and return whether a photograph is taken at once.

        Raises:
            InputError: A parameter is missing or out of range.
        """
        match command.command:
            case Mav.DIGICAM_CONTROL:
                return self._digicam(command)
            case Mav.TRIGGER_DISTANCE:
                return self._trigger_by_distance(command)
            case Mav.OBLIQUE_SURVEY:
                self._oblique(command)
            case Mav.TRIGGER_INTERVAL:
                return self._trigger_by_cycle(command)
            case Mav.TRIGGER_CONTROL:
                return self._control(command)
            case Mav.START_CAPTURE:
                return self._capture(command)
            case Mav.STOP_CAPTURE:
                self._stop(command, Mav.START_CAPTURE)
        return False

    def next_distance_m(self, speed: float | None) -> float:
        """Return the distance to the next photograph, metres; infinite without one."""
        distances = [
            r.remaining * (speed or 0.0) if r.is_timer else r.remaining
            for r in self.running.values()
            if r.count != 0
        ]
        return max(min(distances, default=float("inf")), 0.0)

    def next_time_s(self) -> float:
        """Return the time to the next photograph of a hovering aircraft, seconds."""
        times = [r.remaining for r in self.running.values() if r.is_timer and r.count != 0]
        return max(min(times, default=float("inf")), 0.0)

    def require_few_photographs(self, distance_m: float, time_s: float) -> None:
        """Require that the number of photographs over a distance and time is not too large."""
        for repeater in self.running.values():
            passed = time_s if repeater.is_timer else distance_m
            endless = repeater.count is None or repeater.count > MAX_PHOTOGRAPHS
            if endless and passed / repeater.interval > MAX_PHOTOGRAPHS:
                raise too_many_photographs()

    def advance(self, distance_m: float, time_s: float) -> int:
        """Advance by a distance and its time, and return the number of photographs due."""
        for repeater in self.running.values():
            repeater.advance(distance_m, time_s)
        return sum(repeater.take_if_due() for repeater in self.running.values())

    def _start(self, command: Command, interval: float, count: int | None = None) -> None:
        kind = Mav(command.command)
        if kind is Mav.OBLIQUE_SURVEY:
            kind = Mav.TRIGGER_DISTANCE
        is_timer = kind is not Mav.TRIGGER_DISTANCE
        self.running[kind] = Repeater(interval, interval, is_timer, count, command)

    def _stop(self, command: Command, *kinds: Mav) -> None:
        stopped = [self.running.pop(kind) for kind in kinds if kind in self.running]
        if not stopped and (other := self.command) is not None:
            self.warnings.append(f"{command.title} does not stop {other.title}, which continues")

    def _digicam(self, command: Command) -> bool:
        shoot = command.number(4, "shoot command")
        if shoot not in (0, 1):
            raise command.error(f"has the shoot command {shoot:g} (params[4])", "set it to 1")
        return shoot == 1

    def _trigger_by_distance(self, command: Command) -> bool:
        spacing_m = command.number(0, "distance")
        at_once = command.number(2, "trigger at once") if spacing_m > 0 else command.params[2] or 0
        if at_once not in (0, 1):
            raise command.error(f"has params[2] {at_once:g}", "set it to 0 or 1")
        repeater = self.running.get(Mav.TRIGGER_DISTANCE)
        since_m = math.inf if repeater is None else repeater.since_m
        if spacing_m > 0:
            self._start(command, spacing_m)
            self.running[Mav.TRIGGER_DISTANCE].since_m = since_m
        elif spacing_m in (0, -1):
            self._stop(command, Mav.TRIGGER_DISTANCE)
        else:
            raise command.error(f"has the distance {spacing_m:g} m (params[0])", "set it above 0")
        return at_once == 1 and since_m > _MIN_DISTANCE_M

    def _oblique(self, command: Command) -> None:
        spacing_m = command.number(0, "distance")
        if spacing_m > 0:
            raise command.error(
                "swings the camera from side to side in an unknown order",
                "trigger by distance",
            )
        self._stop(command, Mav.TRIGGER_DISTANCE)

    def _trigger_by_cycle(self, command: Command) -> bool:
        """Execute MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL, whose cycle is in milliseconds.

        The first cycle begins with a photograph.
        """
        cycle_ms = command.number(0, "cycle")
        if 0 < _SECONDS_PER_MS * cycle_ms < _MIN_INTERVAL_S:
            raise command.error(
                f"has a cycle of {cycle_ms:g} ms (params[0]), which is too short for a camera",
                "set it in milliseconds, not seconds",
            )
        if cycle_ms > 0:
            self._start(command, _SECONDS_PER_MS * cycle_ms)
            return True
        if cycle_ms not in (0, -1):
            raise command.error(f"has a cycle of {cycle_ms:g} ms (params[0])", "set it above 0")
        if (other := self.command) is not None:
            self.warnings.append(
                f"{command.title} with a cycle of {cycle_ms:g} ms has no effect, so "
                f"{other.title} continues"
            )
        return False

    def _control(self, command: Command) -> bool:
        """Execute MAV_CMD_DO_TRIGGER_CONTROL; parameters of -1 are ignored."""
        start, pause = (command.params[k] for k in (0, 2))
        if start not in (None, -1, 0, 1) or pause not in (None, -1, 0, 1):
            raise command.error("is neither start, stop nor pause", "set params[0] to 0 or 1")
        kinds = (Mav.TRIGGER_DISTANCE, Mav.TRIGGER_INTERVAL)  # the aircraft's own triggers
        if start == 0 or pause == 1:
            self.paused |= {kind: self.running.pop(kind) for kind in kinds if kind in self.running}
        elif start == 1 and not any(kind in self.running for kind in kinds):
            if not self.paused:
                raise command.error(
                    "starts the aircraft's own trigger, whose interval is unknown",
                    "set one by DO_SET_CAM_TRIGG_DIST or DO_SET_CAM_TRIGG_INTERVAL",
                )
            self.running |= self.paused
            for repeater in self.paused.values():
                repeater.remaining = repeater.interval
            self.paused = {}
            return Mav.TRIGGER_INTERVAL in self.running
        return False

    def _capture(self, command: Command) -> bool:
        """Execute MAV_CMD_IMAGE_START_CAPTURE, whose interval is in seconds."""
        count = command.number(2, "number of images")
        if count < 0 or count != int(count):
            raise command.error(
                f"takes {count:g} images (params[2])", "set a whole number, or 0 for no limit"
            )
        self.running.pop(Mav.START_CAPTURE, None)
        if count == 1:
            return True
        interval_s = command.number(1, "interval")
        if not interval_s >= _MIN_INTERVAL_S:
            raise command.error(
                f"has an interval of {interval_s:g} s (params[1])", "set it in seconds"
            )
        self._start(command, interval_s, int(count) - 1 if count else None)
        return True


def too_many_photographs() -> InputError:
    """Return the error for a plan with too many photographs."""
    return InputError(f"it takes more than {MAX_PHOTOGRAPHS} photographs: trigger less often")
