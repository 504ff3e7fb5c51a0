"""Configurations of flights: one word, or a kind with its options.

Options that are left out are taken from the ``FlightPlan`` of the flight's role, so that map and
query flights differ by default.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from objconnect.scene.config import Config
from objconnect.scene.storage.digests import sha256, sha256_of
from objconnect.scene.storage.files import read_text

Positive = Annotated[float, Field(gt=0)]
Overlap = Annotated[float, Field(ge=0, le=0.95)]
Pitch = Annotated[float, Field(ge=-90, le=60)]
Point = tuple[float, float]

_FORWARD_OVERLAP = 0.7
_SIDE_OVERLAP = 0.6


class FlightPlan(Config):
    """Defaults of the flights of one role. Map and query flights differ in every value."""

    nadir_altitude_m: float = Field(gt=0, description="Altitude of surveys above the ground, m.")
    nadir_heading_deg: float = Field(
        description="Heading of the first line of a survey, deg clockwise from north."
    )
    orbit_altitude_m: float = Field(
        gt=0, description="Altitude of orbits above the ground at the centre, m."
    )
    orbit_radius_share: float = Field(
        gt=0, description="Radius of orbits as a share of the side of the area."
    )
    orbit_start_deg: float = Field(description="Bearing of the first exposure of an orbit, deg.")
    backwards: bool = Field(
        False, description="Whether corridors and streets are followed from their end."
    )


MAP_PLAN = FlightPlan(
    nadir_altitude_m=80,
    nadir_heading_deg=0,
    orbit_altitude_m=55,
    orbit_radius_share=0.4,
    orbit_start_deg=0,
)
QUERY_PLAN = FlightPlan(
    nadir_altitude_m=70,
    nadir_heading_deg=35,
    orbit_altitude_m=48,
    orbit_radius_share=0.36,
    orbit_start_deg=20,
    backwards=True,
)


def draw_plan(plan: FlightPlan, rng: np.random.Generator) -> FlightPlan:
    """Draw the defaults of one flight: any heading, and lengths within 15 % of the role's lengths.

    Args:
        plan: The defaults of the role.
        rng: The generator of the session.
    """
    heading_deg, start_deg = rng.uniform(0, 360, 2)
    factors = rng.uniform(0.85, 1.15, 3)
    lengths = "nadir_altitude_m", "orbit_altitude_m", "orbit_radius_share"
    drawn = {name: getattr(plan, name) * float(f) for name, f in zip(lengths, factors, strict=True)}
    angles = {"nadir_heading_deg": float(heading_deg), "orbit_start_deg": float(start_deg)}
    return plan.model_copy(update=drawn | angles)


class _Flight(Config):
    model_config = ConfigDict(allow_inf_nan=False)

    @property
    def determines_frames(self) -> bool:
        """Return whether the flight itself determines its number of photographs."""
        return False


class _Survey(_Flight):
    """Options common to all surveys by parallel lines."""

    altitude_m: Positive | None = Field(
        None, description="Altitude above the ground, m. None takes the default of the role."
    )
    gsd_cm: Positive | None = Field(
        None,
        description="Ground sampling distance straight below, cm per pixel, instead of the "
        "altitude.",
    )
    forward_overlap: Overlap | None = Field(
        None,
        description="Overlap of neighbours on a line, 0 to 0.95 of the footprint on flat ground. "
        "If either overlap is given, the overlaps determine the number of photographs. Otherwise "
        "the session's number of photographs is spread evenly.",
    )
    side_overlap: Overlap | None = Field(
        None, description="Overlap of neighbouring lines, 0 to 0.95 of the footprint."
    )
    terrain_following: bool = Field(
        True,
        description="Whether the flight keeps its altitude above the ground below. Otherwise it is "
        "level, and its altitude is above the ground at the centre of the area, or at the start of "
        "a corridor.",
    )

    @model_validator(mode="after")
    def _check_altitude(self) -> _Survey:
        if self.altitude_m is not None and self.gsd_cm is not None:
            raise ValueError("give altitude_m or gsd_cm, not both")
        return self

    @property
    def determines_frames(self) -> bool:
        return self.forward_overlap is not None or self.side_overlap is not None

    @property
    def overlaps(self) -> tuple[float, float]:
        """Return forward and side overlap; the defaults are 0.7 and 0.6."""
        forward, side = self.forward_overlap, self.side_overlap
        return (
            _FORWARD_OVERLAP if forward is None else forward,
            _SIDE_OVERLAP if side is None else side,
        )

    def altitude(self, focal: float, default_m: float) -> float:
        """Return the altitude in metres for a focal length in pixels, else ``default_m``."""
        if self.gsd_cm is not None:
            return 0.01 * self.gsd_cm * focal
        return default_m if self.altitude_m is None else self.altitude_m


class NadirFlight(_Survey):
    """A lawn-mower pattern over the area; every second line is flown back."""

    kind: Literal["nadir"] = Field("nadir", description="Kind of the flight.")
    heading_deg: float | None = Field(
        None, description="Heading of the first line, deg clockwise from north."
    )
    pitch_deg: Pitch = Field(-90, description="Pitch of the gimbal, deg; -90 is straight down.")


class GridFlight(_Survey):
    """A double grid: two lawn-mower patterns at right angles."""

    kind: Literal["grid"] = Field("grid", description="Kind of the flight.")
    heading_deg: float | None = Field(
        None, description="Heading of the first line of the first pattern, deg."
    )
    pitch_deg: Pitch = Field(
        -70,
        description="Pitch of the gimbal, deg. A tilt shows facades from four sides.",
    )


class ObliqueFlight(_Flight):
    """A level orbit whose cameras look inwards."""

    kind: Literal["oblique"] = Field("oblique", description="Kind of the flight.")
    radius_m: Positive | None = Field(None, description="Radius of the orbit, m.")
    altitude_m: Positive | None = Field(
        None, description="Altitude above the ground at the centre, m."
    )
    pitch_deg: Pitch = Field(-45, description="Pitch of the gimbal, deg.")
    centre: Point = Field((0.0, 0.0), description="Centre of the orbit, east and north, m.")
    start_deg: float | None = Field(
        None, description="Bearing of the first exposure from the centre, deg from north."
    )


class CorridorFlight(_Survey):
    """Parallel flight lines along a polyline, such as a road."""

    kind: Literal["corridor"] = Field("corridor", description="Kind of the flight.")
    line: Annotated[tuple[Point, ...], Field(min_length=2)] | None = Field(
        None,
        description="Points of the polyline, east and north, m. None follows the longest road.",
    )
    width_m: Positive = Field(60, description="Width of the strip, m, which cameras do not leave.")
    lines: Annotated[int, Field(ge=1, le=100)] | None = Field(
        None,
        description="Number of parallel lines. None takes the number that the side overlap needs.",
    )
    pitch_deg: Pitch = Field(-90, description="Pitch of the gimbal, deg.")


class FreeFlight(_Flight):
    """A smooth random path over the area, which differs for every seed and session."""

    kind: Literal["free"] = Field("free", description="Kind of the flight.")
    altitude_m: tuple[Positive, Positive] | None = Field(
        None,
        description="Minimum and maximum altitude above the ground, m. None takes 0.7 and 1.1 "
        "times the altitude of a survey.",
    )
    pitch_deg: tuple[Pitch, Pitch] = Field(
        (-90, -45), description="Minimum and maximum pitch of the gimbal, deg."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> FreeFlight:
        for name, bounds in (("altitude_m", self.altitude_m), ("pitch_deg", self.pitch_deg)):
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError(f"{name} must be minimum, then maximum")
        return self


class StreetFlight(_Flight):
    """A drive on the right-hand lanes of the roads, without wind, with cameras to both sides."""

    kind: Literal["street"] = Field("street", description="Kind of the flight.")
    roads: Annotated[int, Field(ge=1)] | None = Field(
        None,
        description="Number of roads to drive, the longest first. None drives all of them.",
    )
    way: Literal["there", "back", "both"] | None = Field(
        None,
        description='Direction: "there" drives roads from their start, "back" from their end, '
        '"both" both ways. None drives "there" in map sessions and "back" in query sessions '
        "(``backwards`` of ``FlightPlan``).",
    )
    offset_m: Annotated[float, Field(ge=-1, le=1)] = Field(
        0.0, description="Offset of the cameras to the right of the lane's centre, m."
    )
    edge_m: Annotated[float, Field(ge=0)] = Field(
        0.0, description="Minimum distance from the edge of the place, m."
    )
    height_m: Positive = Field(1.7, description="Height of the cameras above the road, m.")
    yaws_deg: Annotated[tuple[float, ...], Field(min_length=1)] = Field(
        (-45, 45), description="Yaw of each camera, deg clockwise from the driving direction."
    )
    pitch_deg: Pitch = Field(0, description="Pitch of the cameras, deg.")


class PlanFlight(_Flight):
    """The photographs of a mission plan of QGroundControl."""

    kind: Literal["plan"] = Field("plan", description="Kind of the flight.")
    file: Path = Field(description="The ``.plan`` file, relative to the working directory.")
    sha256: str = Field(
        description="SHA-256 of the file, computed when left out. A changed file is refused."
    )
    pitch_deg: Pitch = Field(
        -90,
        description="Pitch of the gimbal until the plan changes it, and after a region of "
        "interest, deg.",
    )
    undulation_m: float | None = Field(
        None,
        ge=-150,
        le=150,
        description="Height of the geoid above the ellipsoid, m, for heights above sea level. None "
        "takes it from the grid of PROJ. Without the grid, such heights are treated as "
        "ellipsoidal, with a warning.",
    )

    @model_validator(mode="before")
    @classmethod
    def _take_digest(cls, values: object) -> object:
        return _add_digest(values, "file", plan_digest)

    @property
    def determines_frames(self) -> bool:
        return True


class FlownFlight(_Flight):
    """The poses of a finished scene's photographs in the same world."""

    kind: Literal["flown"] = Field("flown", description="Kind of the flight.")
    scene: Path = Field(description="The folder of the scene, relative to the working directory.")
    photographs: Literal["map", "queries", "all"] = Field(
        "all", description="Photographs to repeat: map, queries or all."
    )
    sha256: str = Field(description="SHA-256 of the scene's manifest, computed when left out.")

    @model_validator(mode="before")
    @classmethod
    def _take_digest(cls, values: object) -> object:
        return _add_digest(values, "scene", scene_digest)

    @property
    def determines_frames(self) -> bool:
        return True


def _add_digest(values: object, field: str, digest: Callable[[Path], str]) -> object:
    """Add the digest of the path in a field, unless it exists or there is no path."""
    if not isinstance(values, dict) or values.get("sha256"):
        return values
    path = values.get(field)
    return values | {"sha256": digest(Path(path))} if isinstance(path, str | Path) else values


def scene_digest(scene: Path) -> str:
    """Return the SHA-256 of a scene's manifest, which holds the digests of its other files.

    Raises:
        InputError: The folder is not a finished scene.
    """
    return sha256_of(scene / "scene.json")


def plan_digest(file: Path) -> str:
    """Return the SHA-256 of a mission plan.

    Raises:
        InputError: The file cannot be read.
    """
    return sha256(read_text(file, "mission plan"))


PATH_FIELDS: Final = {"plan": "file", "flown": "scene"}
"""The path field of each kind of flight that is written with a path."""


def _parse_word(flight: object) -> object:
    """Parse a flight written as one word: its kind, "plan=FILE" or "flown=SCENE"."""
    if not isinstance(flight, str):
        return flight
    kind, equals, path = flight.partition("=")
    field = PATH_FIELDS.get(kind) if equals else None
    return {"kind": flight} if field is None else {"kind": kind, field: path}


Flight = Annotated[
    Annotated[
        NadirFlight
        | GridFlight
        | ObliqueFlight
        | CorridorFlight
        | FreeFlight
        | StreetFlight
        | PlanFlight
        | FlownFlight,
        Field(discriminator="kind"),
    ],
    BeforeValidator(_parse_word),
]
"""A flight, discriminated by ``kind``; one word is the kind with its defaults."""
