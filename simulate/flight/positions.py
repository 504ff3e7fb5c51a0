"""Positions of the commands of a mission in the world, by what their heights are above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.quantities.mission_heights import Above
from simulate.flight.commands import LANDINGS, Command, Mav
from simulate.flight.site import GroundHeight
from simulate.flight.vehicle import Vehicle

Array = NDArray[np.float64]

_HIGHEST_M = 20_000
_MISSION_FRAME = 2


class Positions:
    """The places (3,) of commands in world metres.

    Heights above home are above the ground there. Where the height of the geoid is unknown, heights
    above the sea are taken for heights above the ellipsoid.

    Attributes:
        home: The ground at home.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        origin: Geodetic,
        ground_height: GroundHeight,
        geoid_m: float | None,
    ) -> None:
        """Take the aircraft with its home, the world's origin and ground, and the geoid's height
        above the ellipsoid in metres."""
        self._vehicle, self._origin = vehicle, origin
        self._height_at, self._geoid_m = ground_height, geoid_m
        self.home = enu_from_geodetic(Geodetic(*vehicle.home, origin.altitude), origin)
        self.home[2] = self.ground(self.home)

    def ground(self, place: Array) -> float:
        """Return the height of the ground at a place, world metres."""
        return float(self._height_at(place[:1], place[1:2])[0])

    def goal(self, goal: Command | None, at: Array) -> Array | None:
        """Return where a command flies to from ``at``; None where the plan does not tell it.

        Raises:
            InputError: The position is invalid, or its height has no reference.
        """
        if goal is None or goal.command in (Mav.DELAY, Mav.RETURN_TO_LAUNCH):
            return None
        here = not goal.params[4] and not goal.params[5]
        if goal.command in LANDINGS:
            place = at.copy() if here else self._place(goal, 0.0, Above.HOME)
            place[2] = self.ground(place)
            return place
        if here and goal.command in (Mav.TAKEOFF, Mav.VTOL_TAKEOFF, Mav.LOITER_TO_ALT):
            return self._above(at, goal.number(6, "altitude"), goal.above())
        return self.of(goal)

    def of(self, command: Command) -> Array:
        """Return the place of a command's last three parameters.

        Raises:
            InputError: The position is invalid, or its height has no reference.
        """
        # QGroundControl knows what is above the ground where it has not computed it above the sea.
        if command.mode == 3 and command.params[6] is None and command.height is not None:
            return self._place(command, command.height, Above.GROUND)
        return self._place(command, command.number(6, "altitude"), command.above())

    def of_mount(self, command: Command) -> Array:
        """Return the place at which MAV_CMD_DO_MOUNT_CONTROL looks.

        Raises:
            InputError: The position is invalid, or its height has no reference.
        """
        height = command.number(3, "altitude")
        # The frame of a mission has no heights, and autopilots differ in what they read.
        if command.frame not in (None, _MISSION_FRAME):
            return self._place(command, height, command.above())
        if self._vehicle.is_px4 or self._vehicle.is_ardupilot:
            return self._place(command, height, Above.SEA if self._vehicle.is_px4 else Above.HOME)
        raise command.fault(
            f"has an altitude in frame {command.frame}, whose reference is unknown",
            "use DO_SET_ROI_LOCATION",
        )

    def _place(self, command: Command, height: float, above: Above) -> Array:
        """Return the place of the coordinates of a command at a height."""
        latitude, longitude = command.number(4, "latitude"), command.number(5, "longitude")
        nowhere = abs(latitude) > 90 or abs(longitude) > 180 or abs(height) > _HIGHEST_M
        if nowhere or latitude == longitude == 0:
            raise InputError(
                f"{command.title} lies at latitude {latitude:g}, longitude {longitude:g}, height "
                f"{height:g} m: correct it"
            )
        altitude = self._origin.altitude
        if above is Above.SEA:
            altitude = height + (self._geoid_m or 0.0)
        place = enu_from_geodetic(Geodetic(latitude, longitude, altitude), self._origin)
        return place if above is Above.SEA else self._above(place, height, above)

    def _above(self, at: Array, height: float, above: Above) -> Array:
        """Return the place at a height over a position; the curvature of the earth is left out."""
        if above is Above.SEA:
            up = height + (self._geoid_m or 0.0) - self._origin.altitude
        else:
            up = height + (self.home[2] if above is Above.HOME else self.ground(at))
        return np.array([at[0], at[1], up])
