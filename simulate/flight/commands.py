"""MAVLink commands of missions, grouped by their effect on the camera.

The meanings are those of https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, model_validator

from objconnect.scene.errors import InputError
from objconnect.scene.quantities.mission_heights import (
    HeightReference,
    check_mode,
    reference_of_frame,
)
from simulate.flight.command_names import NAMES

# A plan may state one height twice; the two agree if they differ by at most this, metres.
_SAME_HEIGHT_M = 0.05

CALCULATED_ABOVE_TERRAIN: Final = 3
"""QGroundControl's AltitudeMode in which Altitude is above the ground, params[6] above the sea."""


class Mav(IntEnum):
    """The commands that the simulated aircraft executes."""

    WAYPOINT = 16
    LOITER_UNLIMITED = 17
    LOITER_TURNS = 18
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    LOITER_TO_ALT = 31
    NAV_ROI = 80
    SPLINE_WAYPOINT = 82
    VTOL_TAKEOFF = 84
    VTOL_LAND = 85
    GUIDED_ENABLE = 92
    DELAY = 93
    CONDITION_DELAY = 112
    CONDITION_DISTANCE = 114
    CONDITION_YAW = 115
    JUMP = 177
    CHANGE_SPEED = 178
    ROI_LOCATION = 195
    ROI_NEXT = 196
    ROI_NONE = 197
    ROI = 201
    DIGICAM_CONTROL = 203
    MOUNT_CONFIGURE = 204
    MOUNT_CONTROL = 205
    TRIGGER_DISTANCE = 206
    TRIGGER_INTERVAL = 214
    OBLIQUE_SURVEY = 260
    JUMP_TAG = 600
    JUMP_TO_TAG = 601
    GIMBAL_PITCHYAW = 1000
    START_CAPTURE = 2000
    STOP_CAPTURE = 2001
    TRIGGER_CONTROL = 2003
    VTOL_TRANSITION = 3000
    CONDITION_GATE = 4501


FLY_TO: Final = (
    Mav.WAYPOINT,
    Mav.SPLINE_WAYPOINT,
    Mav.LOITER_UNLIMITED,
    Mav.LOITER_TURNS,
    Mav.LOITER_TIME,
    Mav.LOITER_TO_ALT,
)
"""Commands that fly to a position and, except ``LOITER_UNLIMITED``, continue from there."""

LANDINGS: Final = (Mav.RETURN_TO_LAUNCH, Mav.LAND, Mav.VTOL_LAND)
NAVIGATION: Final = (*FLY_TO, *LANDINGS, Mav.TAKEOFF, Mav.VTOL_TAKEOFF, Mav.DELAY)
"""Commands that complete before the next one; all others are executed on the way."""

CONDITIONS: Final = (Mav.CONDITION_DELAY, Mav.CONDITION_DISTANCE, Mav.CONDITION_GATE)
"""Commands that delay the following ones, up to the next navigation command."""

CAPTURES: Final = (
    Mav.DIGICAM_CONTROL,
    Mav.TRIGGER_DISTANCE,
    Mav.TRIGGER_INTERVAL,
    Mav.OBLIQUE_SURVEY,
    Mav.START_CAPTURE,
    Mav.TRIGGER_CONTROL,
)
"""Commands that trigger a camera; a plan without any takes a photograph at every waypoint."""

HARMLESS: Final = frozenset(
    {95, 159, 188, 189, 200, 202, 207, 208, 211, 212, 222, 223, 240, 241, 242, 243, 245}
    | {300, 400, 401, 405, 406, 410, 500, 510, 511, 512, 519, 520, 521, 522, 525, 526, 527, 528}
    | {529, 530, 532, 533, 1001, 2002, 2010, 2500, 2501, 2502, 2503, 2504, 2505, 2510, 2511, 2520}
    | {2600, 3001, 5000, 5001, 5002, 5003, 5004, 5100, 5300, 10001, 42600}
)
"""Commands that change neither where nor when photographs are taken: fences, video, storage."""

DOUBTFUL: Final = frozenset({181, 182, 183, 184, 187, 531, 534})
"""Commands that are ignored with a warning: relays and servos may move or trigger a camera, and a
zoom changes photographs."""


class Command(BaseModel):
    """A command of a plan.

    Attributes:
        command: MAV_CMD.
        frame: MAV_FRAME; None where the plan has none.
        params: The seven parameters, None where a plan has null.
        jump_id: The number that jump commands state to continue at this command.
        mode: QGroundControl's AltitudeMode.
        height: QGroundControl's Altitude, metres in that mode.
        where: Position in the file, for messages.
    """

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)

    command: int
    frame: int | None = None
    params: tuple[float | None, ...] = Field(min_length=7, max_length=7)
    jump_id: int | None = Field(None, alias="doJumpId")
    mode: float | None = Field(None, alias="AltitudeMode")
    height: float | None = Field(None, alias="Altitude")
    where: str = ""

    @model_validator(mode="before")
    @classmethod
    def _gather_params(cls, values: Any) -> Any:
        """Read the older forms: ``param1`` to ``param4``, and ``coordinate`` for the last three."""
        if not isinstance(values, dict) or "coordinate" not in values:
            return values
        first = values.get("params", [values.get(f"param{k}") for k in range(1, 5)])
        last = values["coordinate"]
        if isinstance(first, list) and isinstance(last, list) and len(first) == 4:
            return values | {"params": [*first, *last]}
        return values

    @property
    def title(self) -> str:
        """Return position in the file, number and name of the command, for messages."""
        name = NAMES.get(self.command, "unknown command")
        return f"{self.where or 'a command'} ({self.command}, {name})"

    def error(self, what: str, remedy: str) -> InputError:
        """Return the error for a command that cannot be executed."""
        return InputError(f"{self.title} {what}: {remedy}")

    def number(self, index: int, meaning: str) -> float:
        """Return a parameter, counted from 0.

        Raises:
            InputError: The parameter is null.
        """
        value = self.params[index]
        if value is None:
            raise self.error(f"has no {meaning} (params[{index}] is null)", "set it in the plan")
        return value

    def height_reference(self) -> HeightReference:
        """Return the reference of the command's height, its last parameter.

        Raises:
            InputError: The frame has no heights, or the plan contradicts itself.
        """
        reference = reference_of_frame(self.frame).require(
            self.title, "make its height relative, absolute or above terrain"
        )
        if contradiction := check_mode(self.mode, reference):
            raise self.error(
                f"contradicts itself: {contradiction}", "save the plan in QGroundControl again"
            )
        height, altitude = self.params[6], self.height
        if self.mode in (None, CALCULATED_ABOVE_TERRAIN) or altitude is None or height is None:
            return reference
        if abs(altitude - height) > _SAME_HEIGHT_M:
            raise self.error(
                f"contradicts itself: Altitude is {altitude:g} m, params[6] is {height:g} m",
                "save the plan in QGroundControl again",
            )
        return reference
