"""The aircraft of a mission plan: type, speeds and autopilot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from objconnect.scene.errors import InputError
from simulate.flight.commands import Command

_ARDUPILOT, _PX4 = 3, 12  # MAV_AUTOPILOT
_PLANE: Final = 1  # MAV_TYPE
_VTOL: Final = range(19, 26)
_HOVERING, _FORWARD = 3, 4  # MAV_VTOL_STATE
# SPEED_TYPE.
_AIR, _GROUND, _CLIMB, _DESCENT = 0, 1, 2, 3
_UNCHANGED, _DEFAULT = -1, -2


@dataclass
class Vehicle:
    """An aircraft as a plan describes it; missing values are None.

    Attributes:
        home: Latitude and longitude, degrees.
        autopilot: MAV_AUTOPILOT.
        kind: MAV_TYPE.
        hover_m_s: Speed of an aircraft that can hover, outside of forward flight.
        cruise_m_s: Speed of a plane, or of a VTOL aircraft in forward flight.
        is_forward: Whether a VTOL aircraft is in forward flight.
        commanded_m_s: Speed set by the mission.
    """

    home: tuple[float, float]
    autopilot: int | None = None
    kind: int | None = None
    hover_m_s: float | None = None
    cruise_m_s: float | None = None
    is_forward: bool = False
    commanded_m_s: float | None = None

    @property
    def is_ardupilot(self) -> bool:
        """Return whether the autopilot is ArduPilot."""
        return self.autopilot == _ARDUPILOT

    @property
    def is_px4(self) -> bool:
        """Return whether the autopilot is PX4."""
        return self.autopilot == _PX4

    @property
    def is_vtol(self) -> bool:
        """Return whether the aircraft takes off vertically and cruises like a plane."""
        return self.kind in _VTOL

    @property
    def flies_forward(self) -> bool:
        """Return whether the aircraft is in forward flight and cannot hover."""
        return self.kind == _PLANE or (self.is_vtol and self.is_forward)

    def speed_or_none(self) -> float | None:
        """Return the speed, metres per second; None if unknown."""
        if self.commanded_m_s is not None:
            return self.commanded_m_s
        if self.kind is None:
            return self.hover_m_s if self.hover_m_s == self.cruise_m_s else None
        return self.cruise_m_s if self.flies_forward else self.hover_m_s

    def speed(self, needed_by: Command) -> float:
        """Return the speed, metres per second.

        Raises:
            InputError: The speed is unknown.
        """
        speed = self.speed_or_none()
        if speed is None:
            name = "cruiseSpeed" if self.flies_forward else "hoverSpeed"
            raise InputError(
                f"{'vehicleType' if self.kind is None else name} is missing, so the speed of "
                f"{needed_by.title} is unknown: save the plan in QGroundControl again"
            )
        return speed

    def change_speed(self, command: Command) -> None:
        """Execute MAV_CMD_DO_CHANGE_SPEED. Without wind, air speed equals ground speed.

        Raises:
            InputError: A parameter is missing or not a speed.
        """
        kind, speed = command.number(0, "speed type"), command.number(1, "speed")
        if kind not in (_AIR, _GROUND, _CLIMB, _DESCENT):
            raise command.error(
                f"has the speed type {kind:g} (params[0])", "set 0 (air speed) or 1 (ground speed)"
            )
        if kind in (_CLIMB, _DESCENT) or speed == _UNCHANGED:
            return
        if speed == _DEFAULT:
            self.commanded_m_s = None
            return
        if not speed > 0:
            raise command.error(f"sets the speed {speed:g} m/s (params[1])", "set it above 0")
        self.commanded_m_s = speed

    def transition(self, command: Command) -> None:
        """Execute MAV_CMD_DO_VTOL_TRANSITION, which resets the speed.

        Raises:
            InputError: The state is neither hovering nor forward flight.
        """
        state = command.number(0, "state")
        if state not in (_HOVERING, _FORWARD):
            raise command.error(
                f"has the state {state:g} (params[0])", "set 3 (hover) or 4 (forward flight)"
            )
        self.enter(forward=state == _FORWARD)

    def enter(self, *, forward: bool) -> None:
        """Change between hovering and forward flight, for VTOL aircraft."""
        if forward != self.is_forward:
            self.is_forward, self.commanded_m_s = forward, None
