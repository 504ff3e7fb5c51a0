"""An aircraft that follows the commands of a mission and takes photographs when commanded.

Commands and frames are MAVLink's: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from scene.errors import InputError
from scene.geometry.geodesy import Geodetic, enu_from_geodetic
from simulate.flight.gimbal import Aims
from simulate.flight.site import MAX_PHOTOGRAPHS, GroundHeight

Array = NDArray[np.float64]


class Mav(IntEnum):
    """The commands that are interpreted. Other commands do not move the camera."""

    WAYPOINT = 16
    TAKEOFF = 22
    SPLINE_WAYPOINT = 82
    CHANGE_SPEED = 178
    DIGICAM_CONTROL = 203
    MOUNT_CONTROL = 205
    TRIGGER_DISTANCE = 206
    TRIGGER_INTERVAL = 214
    GIMBAL_PITCHYAW = 1000
    START_CAPTURE = 2000
    STOP_CAPTURE = 2001


# Values of MAV_FRAME, each with its variant for integer coordinates.
ABSOLUTE, RELATIVE, TERRAIN = (0, 5), (3, 6), (10, 11)

_PLACES = (Mav.WAYPOINT, Mav.SPLINE_WAYPOINT, Mav.TAKEOFF)
_TRIGGERS = (Mav.DIGICAM_CONTROL, Mav.TRIGGER_DISTANCE, Mav.TRIGGER_INTERVAL, Mav.START_CAPTURE)
_YAW_LOCK = 16  # flag of the gimbal manager: yaw counts from north, not from the vehicle's nose
_HIGHEST_M = 20_000


class Command(BaseModel):
    """A command, its MAV_FRAME and its seven parameters, which are None where unused."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)

    command: int
    frame: int = 2
    params: tuple[float | None, ...] = Field(min_length=7, max_length=7)

    def number(self, index: int) -> float:
        """Return a parameter, counted from 0. Its value is 0 where it is unused."""
        return self.params[index] or 0.0


class Aircraft:
    """Flies commands one after the other and collects the exposures.

    The aircraft starts on the ground at home. Relative heights are above the ground at home, and
    absolute heights are treated as ellipsoidal. Where a waypoint has no yaw, the nose points along
    the way.
    """

    def __init__(
        self,
        home: tuple[float, float],
        speed_m_s: float,
        pitch_deg: float,
        origin: Geodetic,
        ground_height: GroundHeight,
    ) -> None:
        """Place the aircraft at ``home`` (latitude, longitude) with the gimbal at ``pitch_deg``."""
        self._origin, self._height_at = origin, ground_height
        self._at = enu_from_geodetic(Geodetic(*home, origin.altitude), origin)
        self._home_m = self._at[2] = self._ground(self._at)
        self._speed = speed_m_s
        self._nose, self._pitch = 0.0, np.radians(pitch_deg)
        self._yaw, self._locked = 0.0, False
        # Intervals between photographs, infinite where none is set.
        self._every_m = self._every_s = np.inf
        self._since_m = 0.0  # distance flown since the last photograph
        self._shots: list[tuple[float, float, float, float, float]] = []

    def fly(self, commands: list[Command]) -> Aims:
        """Fly a mission and return its exposures.

        A mission without camera triggers takes a photograph at every waypoint.

        Raises:
            InputError: a position or frame is invalid, or there are too many photographs.
        """
        triggered = any(command.command in _TRIGGERS for command in commands)
        for command in commands:
            self._obey(command)
            if not triggered and command.command in (Mav.WAYPOINT, Mav.SPLINE_WAYPOINT):
                self._photograph(self._at)
        shots = np.array(self._shots).reshape(-1, 5)
        return Aims(shots[:, :3], shots[:, 3], shots[:, 4])

    def places(self, commands: list[Command]) -> Array:
        """Return the positions of the mission's waypoints, (K, 3) metres."""
        positions = [self._place(c) for c in commands if c.command in _PLACES[:2]]
        return np.array(positions).reshape(-1, 3)

    def _obey(self, command: Command) -> None:
        number = command.number
        match command.command:
            case Mav.WAYPOINT | Mav.SPLINE_WAYPOINT | Mav.TAKEOFF:
                self._go(self._place(command), command.params[3], command.frame in TERRAIN)
            case Mav.CHANGE_SPEED if number(1) > 0:
                self._speed = number(1)
            case Mav.MOUNT_CONTROL:
                self._pitch, self._yaw = np.radians([number(0), number(2)])
                self._locked = False
            case Mav.GIMBAL_PITCHYAW:
                self._pitch, self._yaw = np.radians([number(0), number(1)])
                self._locked = bool(int(number(4)) & _YAW_LOCK)
            case Mav.DIGICAM_CONTROL if number(4) == 1:
                self._photograph(self._at)
            case Mav.TRIGGER_DISTANCE:
                self._trigger(every_m=number(0))
                if number(0) > 0 and number(2) == 1:
                    self._photograph(self._at)
            case Mav.TRIGGER_INTERVAL:
                self._trigger(every_s=number(0))
            case Mav.START_CAPTURE:
                self._photograph(self._at)
                if number(2) != 1:
                    self._trigger(every_s=number(1))
            case Mav.STOP_CAPTURE:
                self._trigger()

    def _trigger(self, every_m: float = 0.0, every_s: float = 0.0) -> None:
        """Set the intervals between photographs from here on. 0 stands for no photographs."""
        self._every_m = every_m if every_m > 0 else np.inf
        self._every_s = every_s if every_s > 0 else np.inf
        self._since_m = 0.0

    def _go(self, target: Array, yaw_deg: float | None, follow: bool) -> None:
        """Fly straight to a position. With ``follow``, the height follows the ground."""
        start, way = self._at, target - self._at
        length = float(np.linalg.norm(way))
        if yaw_deg is not None:
            self._nose = np.radians(yaw_deg)
        elif np.linalg.norm(way[:2]) > 0.01:
            self._nose = np.arctan2(way[0], way[1])
        every = min(self._every_m, self._every_s * self._speed)
        if len(self._shots) + length / every > MAX_PHOTOGRAPHS:
            raise InputError(
                f"it takes more than {MAX_PHOTOGRAPHS} photographs: trigger less often"
            )
        above = start[2] - self._ground(start), target[2] - self._ground(target)
        flown = max(every - self._since_m, 0.0)
        while flown <= length:
            share = flown / length if length else 0.0
            place = start + share * way
            if follow:
                place[2] = self._ground(place) + (1 - share) * above[0] + share * above[1]
            self._photograph(place)
            self._since_m = (
                -flown
            )  # the addition below then leaves the distance since this photograph
            flown += every
        self._since_m += length
        self._at = target

    def _photograph(self, place: Array) -> None:
        heading = self._yaw if self._locked else self._nose + self._yaw
        self._shots.append((*place, heading, self._pitch))
        self._since_m = 0.0

    def _place(self, command: Command) -> Array:
        """Return east, north, up of a command. A takeoff without coordinates is straight up."""
        latitude, longitude, height = (command.number(k) for k in (4, 5, 6))
        if abs(latitude) > 90 or abs(longitude) > 180 or abs(height) > _HIGHEST_M:
            raise InputError(
                f"a waypoint lies at latitude {latitude:g}, longitude {longitude:g}, height "
                f"{height:g} m: correct it"
            )
        if command.frame not in ABSOLUTE + RELATIVE + TERRAIN:
            raise InputError(
                f"a waypoint has MAV_FRAME {command.frame}, which is not understood: make its "
                "height relative, absolute or above terrain"
            )
        if latitude == longitude == 0 and command.command == Mav.TAKEOFF:
            return np.array([*self._at[:2], self._home_m + height])
        altitude = height + (0 if command.frame in ABSOLUTE else self._origin.altitude)
        place = enu_from_geodetic(Geodetic(latitude, longitude, altitude), self._origin)
        if command.frame in RELATIVE:
            place[2] = self._home_m + height
        elif command.frame in TERRAIN:
            place[2] = self._ground(place) + height
        return place

    def _ground(self, place: Array) -> float:
        return float(self._height_at(place[:1], place[1:2])[0])
