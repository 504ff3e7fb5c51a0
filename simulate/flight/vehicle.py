"""The aircraft of a mission plan: how it flies, how fast, and by which autopilot."""

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
_UNCHANGED, _USUAL = -1, -2


@dataclass
class Vehicle:
    """An aircraft as a plan describes it; what the plan leaves out is None.

    Attributes:
        home: Latitude and longitude, degrees.
        autopilot: MAV_AUTOPILOT.
        kind: MAV_TYPE.
        hover_m_s: Speed of an aircraft that hovers.
        cruise_m_s: Speed of an aircraft in forward flight.
        transitioned: Whether a VTOL aircraft is in forward flight.
        told_m_s: Speed that the mission asks for.
    """

    home: tuple[float, float]
    autopilot: int | None = None
    kind: int | None = None
    hover_m_s: float | None = None
    cruise_m_s: float | None = None
    transitioned: bool = False
    told_m_s: float | None = None

    @property
    def is_ardupilot(self) -> bool:
        """Return whether ArduPilot flies."""
        return self.autopilot == _ARDUPILOT

    @property
    def is_px4(self) -> bool:
        """Return whether PX4 flies."""
        return self.autopilot == _PX4

    @property
    def is_vtol(self) -> bool:
        """Return whether the aircraft takes off like a helicopter and flies like a plane."""
        return self.kind in _VTOL

    @property
    def glides(self) -> bool:
        """Return whether the aircraft cannot stop in the air now."""
        return self.kind == _PLANE or (self.is_vtol and self.transitioned)

    def speed_or_none(self) -> float | None:
        """Return the speed, metres per second; None where the plan does not tell it."""
        if self.told_m_s is not None:
            return self.told_m_s
        if self.kind is None:
            return self.hover_m_s if self.hover_m_s == self.cruise_m_s else None
        return self.cruise_m_s if self.glides else self.hover_m_s

    def speed(self, needed_by: Command) -> float:
        """Return the speed, metres per second.

        Raises:
            InputError: The plan does not tell it.
        """
        speed = self.speed_or_none()
        if speed is None:
            name = "cruiseSpeed" if self.glides else "hoverSpeed"
            raise InputError(
                f"{'vehicleType' if self.kind is None else name} is missing, without which "
                f"{needed_by.title} has no speed: save the plan in QGroundControl again"
            )
        return speed

    def change_speed(self, command: Command) -> None:
        """Obey MAV_CMD_DO_CHANGE_SPEED. Without wind, speeds in the air are those over ground.

        Raises:
            InputError: A parameter is missing or not a speed.
        """
        kind, speed = command.number(0, "speed type"), command.number(1, "speed")
        if kind not in (_AIR, _GROUND, _CLIMB, _DESCENT):
            raise command.fault(f"has the speed type {kind:g} (params[0])", "set 0 or 1")
        if kind in (_CLIMB, _DESCENT) or speed == _UNCHANGED:
            return
        if speed == _USUAL:
            self.told_m_s = None
            return
        if not speed > 0:
            raise command.fault(f"sets the speed {speed:g} m/s (params[1])", "set it above 0")
        self.told_m_s = speed

    def transition(self, command: Command) -> None:
        """Obey MAV_CMD_DO_VTOL_TRANSITION, which ends a speed that was set before.

        Raises:
            InputError: The state is neither hovering nor forward flight.
        """
        state = command.number(0, "state")
        if state not in (_HOVERING, _FORWARD):
            raise command.fault(f"asks for the state {state:g} (params[0])", "set 3 or 4")
        self.enter(forward=state == _FORWARD)

    def enter(self, *, forward: bool) -> None:
        """Hover or fly forward from now on, which only VTOL aircraft can change."""
        if forward != self.transitioned:
            self.transitioned, self.told_m_s = forward, None
