"""Read mission plans of QGroundControl (``.plan``).

The format is https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html.
Simple items, surveys, corridor scans, structure scans and landing patterns are supported. Surveys
and corridor scans are read from their items, or from their transects if they have no items.
``structure_scan`` computes the commands of structure scans.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import geoid_undulation
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.quantities.mission_heights import HeightReference, reference_of_survey
from simulate.flight.commands import HARMLESS, Command, Mav
from simulate.flight.context import GroundHeight
from simulate.flight.gimbal import Aims
from simulate.flight.mission import Aircraft
from simulate.flight.positions import Positions
from simulate.flight.structure_scan import StructureScan
from simulate.flight.vehicle import Vehicle

log = logging.getLogger(__name__)

_Latitude = Annotated[float, Field(ge=-90, le=90)]
_Longitude = Annotated[float, Field(ge=-180, le=180)]
_Length = Annotated[float, Field(gt=0)]

# MAV_FRAME by the reference of its heights.
_FRAMES = {HeightReference.SEA: 0, HeightReference.HOME: 3, HeightReference.GROUND: 10}
_SEA_LEVEL_FRAMES = (0, 5)  # MAV_FRAME: global, with decimal and with integer coordinates


class _PlanPart(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


class _SimpleItem(Command):
    type: Literal["SimpleItem", "missionItem"]


class _CameraCalc(_PlanPart):
    distance_m: float | None = Field(None, alias="DistanceToSurface")
    trigger_m: _Length | None = Field(None, alias="AdjustedFootprintFrontal")
    mode: float | None = Field(None, alias="DistanceMode")
    relative: bool | None = Field(None, alias="DistanceToSurfaceRelative")


class _Transects(_PlanPart):
    items: tuple[_SimpleItem, ...] = Field((), alias="Items")
    points: tuple[tuple[_Latitude, _Longitude], ...] = Field((), alias="VisualTransectPoints")
    camera: _CameraCalc = Field(_CameraCalc(), alias="CameraCalc")
    follows_terrain: bool | None = Field(None, alias="FollowTerrain")
    hovers: bool = Field(False, alias="HoverAndCapture")
    # The default of QGroundControl.
    in_turnarounds: bool = Field(True, alias="CameraTriggerInTurnAround")
    turn_m: float = Field(0.0, alias="TurnAroundDistance")


class _ComplexItem(_PlanPart):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False, frozen=True)

    type: Literal["ComplexItem"]
    kind: str = Field("ComplexItem", alias="complexItemType")
    transects: _Transects | None = Field(None, alias="TransectStyleComplexItem")
    polyline: tuple[tuple[float, ...], ...] = ()
    stops_photographs: bool = Field(False, alias="stopTakingPhotos")


class _Mission(_PlanPart):
    items: tuple[Annotated[_SimpleItem | _ComplexItem, Field(discriminator="type")], ...]
    home: tuple[_Latitude, _Longitude, float | None] = Field(alias="plannedHomePosition")
    autopilot: int | None = Field(None, alias="firmwareType")
    vehicle: int | None = Field(None, alias="vehicleType")
    hover_m_s: _Length | None = Field(None, alias="hoverSpeed")
    cruise_m_s: _Length | None = Field(None, alias="cruiseSpeed")


class _Plan(_PlanPart):
    file_type: Literal["Plan"] = Field(alias="fileType")
    mission: _Mission


def read_plan(
    path: Path,
    origin: Geodetic,
    side_m: float,
    ground_height: GroundHeight,
    pitch_deg: float,
    undulation_m: float | None = None,
) -> Aims:
    """Read a mission plan and return its exposures.

    Each ambiguity of the plan is logged as a warning.

    Args:
        path: The ``.plan`` file.
        origin: Geodetic coordinates of the world's origin.
        side_m: Side of the square place around the origin, metres.
        ground_height: Height of the ground in metres at world x, y in metres.
        pitch_deg: Pitch of the gimbal until the plan changes it.
        undulation_m: Height of the geoid above the ellipsoid, metres, for heights above sea level;
            None takes it from the grid of PROJ if that is installed.

    Raises:
        InputError: The file cannot be read or interpreted, the plan takes no photographs or too
            many, or it lies outside the place.
    """
    mission = _read_mission(path)
    vehicle = Vehicle(
        mission.home[:2],
        mission.autopilot,
        mission.vehicle,
        mission.hover_m_s,
        mission.cruise_m_s,
    )
    geoid_m = geoid_undulation(origin) if undulation_m is None else undulation_m
    aircraft = Aircraft(vehicle, pitch_deg, Positions(vehicle, origin, ground_height, geoid_m))
    try:
        commands = list(_commands(mission))
        _require_near(aircraft, commands, origin, 0.5 * side_m)
        aims = aircraft.fly(commands)
    except InputError as error:
        raise InputError(f"mission plan {path}: {error}") from None
    if not len(aims.centres):
        raise InputError(f"mission plan {path} takes no photographs: give it camera triggers")
    warnings = list(aircraft.warnings)
    if geoid_m is None and any(
        c.frame in _SEA_LEVEL_FRAMES and c.command not in HARMLESS for c in commands
    ):
        warnings.append(
            "its heights above sea level are treated as ellipsoidal: give the height of the geoid "
            "as undulation_m of the flight"
        )
    for warning in warnings:
        log.warning("mission plan %s: %s", path, warning)
    return aims


def check_plan(path: Path) -> None:
    """Check that a mission plan can be read.

    Checks that need the place, such as positions and heights, are left out.

    Raises:
        InputError: The file cannot be read.
    """
    _read_mission(path)


def _read_mission(path: Path) -> _Mission:
    return read_json(path, _Plan, "mission plan").mission


def _commands(mission: _Mission) -> Iterator[Command]:
    """Yield all commands in flying order, including those of surveys."""
    for number, item in enumerate(mission.items):
        where = f"item {number}"
        if isinstance(item, _SimpleItem):
            yield item.model_copy(update={"where": where})
        elif item.transects is not None:
            inner = item.transects.items
            for row, command in enumerate(inner or _survey_commands(item, item.transects, where)):
                yield command.model_copy(update={"where": f"{where}.Items[{row}]"})
        elif "landing" in item.kind.lower():
            yield from _landing(item, f"{where}, {item.kind}")
        elif item.kind.lower() == "structurescan":
            yield from _parse_structure_scan(item, where).commands(where)
        else:
            raise InputError(
                f"{where} is a {item.kind}, which is not supported: replace it by waypoints"
            )


def _parse_structure_scan(item: _ComplexItem, where: str) -> StructureScan:
    """Parse a structure scan.

    Raises:
        InputError: A field is missing or wrong.
    """
    fields = item.model_extra or {}
    calculated = fields.get("CameraCalc")
    camera = calculated if isinstance(calculated, dict) else {}
    lengths = {
        "distance_m": "DistanceToSurface",
        "photograph_spacing_m": "AdjustedFootprintSide",
        "layer_spacing_m": "AdjustedFootprintFrontal",
    }
    try:
        known = {name: camera[key] for name, key in lengths.items() if key in camera}
        return StructureScan.model_validate(fields | known)
    except ValidationError as error:
        name = str(error.errors()[0]["loc"][0])
        field = lengths.get(name, name)
        raise InputError(
            f"{where} is a StructureScan whose field {field!r} is missing or wrong: save it again "
            "in QGroundControl"
        ) from None


def _landing(item: _ComplexItem, where: str) -> Iterator[Command]:
    """Yield the commands of a landing pattern, which may stop the camera first."""
    nothing = (0.0,) * 7
    if item.stops_photographs:
        for stop in (Mav.TRIGGER_DISTANCE, Mav.STOP_CAPTURE):
            yield Command(command=stop, params=nothing, where=where)
    yield Command(command=Mav.LAND, params=nothing, where=where)


def _survey_commands(item: _ComplexItem, transects: _Transects, where: str) -> Iterator[Command]:
    """Yield the commands of a survey that was saved without items, from its transects."""
    camera, remedy = transects.camera, "save it again in QGroundControl"
    height, trigger = camera.distance_m, camera.trigger_m
    if not transects.points:
        raise InputError(f"{where} has neither Items nor transects: {remedy}")
    if height is None or trigger is None:
        what = "the surface" if height is None else "the next photograph"
        raise InputError(f"{where} has no Items, and states no distance to {what}: {remedy}")
    reference = reference_of_survey(
        camera.mode, camera.relative, transects.follows_terrain
    ).require(where, remedy)
    intervals = _intervals(item, transects, trigger)
    if intervals is None:
        raise InputError(
            f"{where} has no Items, and its transects do not determine where its camera is "
            f"triggered: {remedy}"
        )
    for row, (latitude, longitude) in enumerate(transects.points):
        params = (0.0, 0.0, 0.0, None, latitude, longitude, height)
        yield Command(command=Mav.WAYPOINT, frame=_FRAMES[reference], params=params)
        if transects.hovers:
            once = (0.0, 0.0, 1.0, 0.0, None, None, None)
            yield Command(command=Mav.START_CAPTURE, params=once)
        elif row in intervals:
            start = (intervals[row], 0.0, 1.0, None, None, None, None)
            yield Command(command=Mav.TRIGGER_DISTANCE, params=start)


def _intervals(
    item: _ComplexItem, transects: _Transects, trigger_m: float
) -> dict[int, float] | None:
    """Return the trigger distance by the row of the point that sets it.

    QGroundControl sets the distance at the start of each transect and resets it at its end, or at
    the end of the last one if photographs are also taken in turnarounds. The result is None if the
    points cannot be assigned to transects.
    """
    turn_points = 1 if transects.turn_m else 0
    if transects.hovers:
        return None if turn_points else {}
    inner = len(item.polyline) if item.kind.lower() == "corridorscan" else 2
    # Number of points of each transect, and of all transects.
    per_transect, count = inner + 2 * turn_points, len(transects.points)
    if item.kind.lower() not in ("survey", "corridorscan") or inner < 2 or count % per_transect:
        return None
    starts = [row for row in range(count) if row % per_transect == turn_points]
    ends = [row for row in range(count) if row % per_transect == turn_points + inner - 1]
    if transects.in_turnarounds:
        starts, ends = [0, *starts], [count - 1]
    return dict.fromkeys(starts, trigger_m) | dict.fromkeys(ends, 0.0)


def _require_near(
    aircraft: Aircraft, commands: list[Command], origin: Geodetic, half_m: float
) -> None:
    waypoints = aircraft.waypoints(commands)
    if not len(waypoints):
        raise InputError("it has no waypoints: plan a flight")
    from_centre = np.abs(waypoints[:, :2])
    if not (from_centre <= half_m).all(1).any():
        nearest = np.linalg.norm(from_centre, axis=1).min()
        raise InputError(
            f"its nearest waypoint lies {nearest:,.0f} m from the centre of the place: plan around "
            f"{origin.latitude:.6f}, {origin.longitude:.6f} or set the origin"
        )
