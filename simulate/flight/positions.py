"""Convert the positions of a mission's commands to world coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.quantities.mission_heights import HeightReference
from simulate.flight.commands import CALCULATED_ABOVE_TERRAIN, LANDINGS, Command, Mav
from simulate.flight.context import GroundHeight
from simulate.flight.vehicle import Vehicle

Array = NDArray[np.float64]

_HIGHEST_M = 20_000  # larger heights are mistakes
_MISSION_FRAME = 2  # MAV_FRAME_MISSION


class Positions:
    """Converts positions of commands to world metres (3,).

    Heights above home are above the ground at home. If the geoid is unknown, heights above sea
    level are treated as ellipsoidal.

    Attributes:
        home: The ground at home, (3,).
    """

    def __init__(
        self,
        vehicle: Vehicle,
        origin: Geodetic,
        ground_height: GroundHeight,
        geoid_m: float | None,
    ) -> None:
        """Take the aircraft, the world's origin and ground, and the geoid's height in metres."""
        self._vehicle, self._origin = vehicle, origin
        self._height_at, self._geoid_m = ground_height, geoid_m
        self.home = enu_from_geodetic(Geodetic(*vehicle.home, origin.altitude), origin)
        self.home[2] = self.ground_height(self.home)

    def ground_height(self, position: Array) -> float:
        """Return the height of the ground at a position, world metres."""
        return float(self._height_at(position[:1], position[1:2])[0])

    def target(self, goal: Command | None, start: Array) -> Array | None:
        """Return the target (3,) of a command that begins at ``start`` (3,); None if unknown.

        Raises:
            InputError: The position is invalid, or its height has no reference.
        """
        if goal is None or goal.command in (Mav.DELAY, Mav.RETURN_TO_LAUNCH):
            return None
        has_no_location = not goal.params[4] and not goal.params[5]
        if goal.command in LANDINGS:
            target = (
                start.copy() if has_no_location else self._convert(goal, 0.0, HeightReference.HOME)
            )
            target[2] = self.ground_height(target)
            return target
        if has_no_location and goal.command in (Mav.TAKEOFF, Mav.VTOL_TAKEOFF, Mav.LOITER_TO_ALT):
            return self._move_to_height(start, goal.number(6, "altitude"), goal.height_reference())
        return self.position_of(goal)

    def position_of(self, command: Command) -> Array:
        """Return the position (3,) in a command's last three parameters.

        Raises:
            InputError: The position is invalid, or its height has no reference.
        """
        # QGroundControl may store only the height above the ground.
        if (
            command.mode == CALCULATED_ABOVE_TERRAIN
            and command.params[6] is None
            and command.height is not None
        ):
            return self._convert(command, command.height, HeightReference.GROUND)
        return self._convert(command, command.number(6, "altitude"), command.height_reference())

    def mount_target_position(self, command: Command) -> Array:
        """Return the point (3,) at which MAV_CMD_DO_MOUNT_CONTROL looks.

        Raises:
            InputError: The position is invalid, or its height has no reference.
        """
        height = command.number(3, "altitude")
        # The mission frame has no height reference, and autopilots differ in their interpretation.
        if command.frame not in (None, _MISSION_FRAME):
            return self._convert(command, height, command.height_reference())
        if self._vehicle.is_px4 or self._vehicle.is_ardupilot:
            return self._convert(
                command,
                height,
                HeightReference.SEA if self._vehicle.is_px4 else HeightReference.HOME,
            )
        raise command.error(
            f"has an altitude in frame {command.frame}, whose reference is unknown",
            "use DO_SET_ROI_LOCATION",
        )

    def _convert(self, command: Command, height: float, reference: HeightReference) -> Array:
        """Return the position (3,) of a command's coordinates at a height."""
        latitude, longitude = command.number(4, "latitude"), command.number(5, "longitude")
        invalid = abs(latitude) > 90 or abs(longitude) > 180 or abs(height) > _HIGHEST_M
        if invalid or latitude == longitude == 0:
            raise InputError(
                f"{command.title} has the invalid position latitude {latitude:g}, longitude "
                f"{longitude:g}, height {height:g} m: correct it"
            )
        altitude = self._origin.altitude
        if reference is HeightReference.SEA:
            altitude = height + (self._geoid_m or 0.0)
        position = enu_from_geodetic(Geodetic(latitude, longitude, altitude), self._origin)
        if reference is HeightReference.SEA:
            return position
        return self._move_to_height(position, height, reference)

    def _move_to_height(self, position: Array, height: float, reference: HeightReference) -> Array:
        """Return a position moved to a height above a reference.

        The earth's curvature is neglected.
        """
        if reference is HeightReference.SEA:
            up = height + (self._geoid_m or 0.0) - self._origin.altitude
        else:
            at_home = reference is HeightReference.HOME
            up = height + (self.home[2] if at_home else self.ground_height(position))
        return np.array([position[0], position[1], up])
