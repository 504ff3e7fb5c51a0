"""How a session's flight is flown, as a person writes it: one word, or its numbers.

A number left out is that of the flight's role (`simulate.config.FlightPlan`), so that map and
query flights differ when nothing is said.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from scene.config import Config
from scene.storage.files import read_text

Positive = Annotated[float, Field(gt=0)]
Overlap = Annotated[float, Field(ge=0, le=0.95)]
Pitch = Annotated[float, Field(ge=-90, le=60)]
Point = tuple[float, float]

_FORWARD_OVERLAP = 0.7
_SIDE_OVERLAP = 0.6


class _Flight(Config):
    model_config = ConfigDict(allow_inf_nan=False)

    @property
    def counts_photographs(self) -> bool:
        """Whether the flight itself says how many photographs it takes."""
        return False


class _Survey(_Flight):
    """What every survey by parallel lines says.

    Attributes:
        altitude_m: above the ground.
        gsd_cm: the same as centimetres of ground per pixel, straight below.
        forward_overlap: of neighbours on a line, as a fraction of the footprint on flat ground.
        side_overlap: of neighbouring lines. With either overlap, the flight takes as many
            photographs as it needs; without, as many as its session says, evenly spaced.
        terrain_following: or level, the altitude being above the ground at the area's centre (a
            corridor's start).
    """

    altitude_m: Positive | None = None
    gsd_cm: Positive | None = None
    forward_overlap: Overlap | None = None
    side_overlap: Overlap | None = None
    terrain_following: bool = True

    @model_validator(mode="after")
    def _one_altitude(self) -> _Survey:
        if self.altitude_m is not None and self.gsd_cm is not None:
            raise ValueError("say altitude_m or gsd_cm, not both")
        return self

    @property
    def counts_photographs(self) -> bool:
        return self.forward_overlap is not None or self.side_overlap is not None

    @property
    def overlaps(self) -> tuple[float, float]:
        """Forward and side, with the usual ones where nothing is said."""
        forward, side = self.forward_overlap, self.side_overlap
        return (
            _FORWARD_OVERLAP if forward is None else forward,
            _SIDE_OVERLAP if side is None else side,
        )

    def altitude(self, focal: float, usual_m: float) -> float:
        """Metres above the ground for a focal length in pixels; `usual_m` when nothing is said."""
        if self.gsd_cm is not None:
            return 0.01 * self.gsd_cm * focal
        return usual_m if self.altitude_m is None else self.altitude_m


class NadirFlight(_Survey):
    """A lawn-mower over the area; every second line is flown back.

    Attributes:
        heading_deg: of the first line, clockwise from north.
        pitch_deg: of the gimbal, -90 straight down.
    """

    kind: Literal["nadir"] = "nadir"
    heading_deg: float | None = None
    pitch_deg: Pitch = -90


class GridFlight(_Survey):
    """A double grid: two lawn-mowers at right angles.

    Attributes:
        heading_deg: of the first grid's first line.
        pitch_deg: of the gimbal: tilted, facades are seen from four sides.
    """

    kind: Literal["grid"] = "grid"
    heading_deg: float | None = None
    pitch_deg: Pitch = -70


class ObliqueFlight(_Flight):
    """An orbit looking inwards.

    Attributes:
        radius_m: of the orbit.
        altitude_m: above the ground at the centre; the orbit is level.
        pitch_deg: of the gimbal.
        centre: east and north, metres.
        start_deg: bearing of the first exposure from the centre.
    """

    kind: Literal["oblique"] = "oblique"
    radius_m: Positive | None = None
    altitude_m: Positive | None = None
    pitch_deg: Pitch = -45
    centre: Point = (0.0, 0.0)
    start_deg: float | None = None


class CorridorFlight(_Survey):
    """Parallel lines along a line.

    Attributes:
        line: points east and north, metres; None is the longest road.
        width_m: of the strip to photograph; no camera leaves it.
        lines: side by side; None is as many as the side overlap needs.
        pitch_deg: of the gimbal.
    """

    kind: Literal["corridor"] = "corridor"
    line: Annotated[tuple[Point, ...], Field(min_length=2)] | None = None
    width_m: Positive = 60
    lines: Annotated[int, Field(ge=1, le=100)] | None = None
    pitch_deg: Pitch = -90


class FreeFlight(_Flight):
    """A smooth random course over the area, other for every seed and session.

    Attributes:
        altitude_m: lowest and highest above the ground; None is 0.7 to 1.1 of a survey's altitude.
        pitch_deg: lowest and highest of the gimbal.
    """

    kind: Literal["free"] = "free"
    altitude_m: tuple[Positive, Positive] | None = None
    pitch_deg: tuple[Pitch, Pitch] = (-90, -45)

    @model_validator(mode="after")
    def _ranges(self) -> FreeFlight:
        for name, bounds in (("altitude_m", self.altitude_m), ("pitch_deg", self.pitch_deg)):
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError(f"{name} is lowest, then highest")
        return self


class StreetFlight(_Flight):
    """A vehicle on the right-hand lanes of the roads, photographing to both sides. No wind.

    Attributes:
        roads: how many of the roads, the longest first; None is all.
        way: along them from their start, back from their end, or both; None is there for map
            flights and back for queries (`backwards` of the plan).
        offset_m: to the right of the middle of the lane.
        edge_m: kept between the cameras and the edge of the place, which is open country.
        height_m: of the cameras above the road.
        yaws_deg: of the cameras, clockwise from the direction of travel.
        pitch_deg: of the cameras.
    """

    kind: Literal["street"] = "street"
    roads: Annotated[int, Field(ge=1)] | None = None
    way: Literal["there", "back", "both"] | None = None
    offset_m: Annotated[float, Field(ge=-1, le=1)] = 0.0
    edge_m: Annotated[float, Field(ge=0)] = 0.0
    height_m: Positive = 1.7
    yaws_deg: Annotated[tuple[float, ...], Field(min_length=1)] = (-45, 45)
    pitch_deg: Pitch = 0


class PlanFlight(_Flight):
    """What a mission plan of QGroundControl photographs.

    Attributes:
        file: the ``.plan``, relative to the working directory.
        sha256: of the file, taken when nothing is said, so that a scene knows its flight.
        pitch_deg: of the gimbal until the plan says.
    """

    kind: Literal["plan"] = "plan"
    file: Path
    sha256: str
    pitch_deg: Pitch = -90

    @model_validator(mode="before")
    @classmethod
    def _take_digest(cls, values: object) -> object:
        if not isinstance(values, dict) or values.get("sha256"):
            return values
        file = values.get("file")
        if not isinstance(file, str | Path):
            return values
        return values | {"sha256": plan_digest(Path(file))}

    @property
    def counts_photographs(self) -> bool:
        return True


def plan_digest(file: Path) -> str:
    """SHA-256 of a mission plan; InputError when it cannot be read."""
    return hashlib.sha256(read_text(file, "mission plan").encode()).hexdigest()


def _from_word(flight: object) -> object:
    """ "nadir", or "plan=FILE"."""
    if not isinstance(flight, str):
        return flight
    kind, equals, file = flight.partition("=")
    return {"kind": kind, "file": file} if equals and kind == "plan" else {"kind": flight}


Flight = Annotated[
    Annotated[
        NadirFlight
        | GridFlight
        | ObliqueFlight
        | CorridorFlight
        | FreeFlight
        | StreetFlight
        | PlanFlight,
        Field(discriminator="kind"),
    ],
    BeforeValidator(_from_word),
]
"""A flight by its `kind`; a word alone stands for the kind with its usual numbers."""
