"""Reader of mission plans of QGroundControl (``.plan``).

The format is https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html. The
reader interprets simple items, and surveys and corridor scans by the items that they contain, or by
their transects where they contain none.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from scene.bundle.manifest import read_json
from scene.errors import InputError
from scene.geometry.geodesy import Geodetic
from simulate.flight.gimbal import Aims
from simulate.flight.mission import RELATIVE, TERRAIN, Aircraft, Command, Mav
from simulate.flight.site import GroundHeight

_Latitude = Annotated[float, Field(ge=-90, le=90)]
_Longitude = Annotated[float, Field(ge=-180, le=180)]
_Length = Annotated[float, Field(gt=0)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


class _SimpleItem(Command):
    type: Literal["SimpleItem"]


class _CameraCalc(_Part):
    distance_m: _Length | None = Field(None, alias="DistanceToSurface")
    trigger_m: _Length | None = Field(None, alias="AdjustedFootprintFrontal")


class _Transects(_Part):
    items: tuple[_SimpleItem, ...] = Field((), alias="Items")
    points: tuple[tuple[_Latitude, _Longitude], ...] = Field((), alias="VisualTransectPoints")
    camera: _CameraCalc = Field(_CameraCalc(), alias="CameraCalc")
    follows_terrain: bool = Field(False, alias="FollowTerrain")


class _ComplexItem(_Part):
    type: Literal["ComplexItem"]
    kind: str = Field("ComplexItem", alias="complexItemType")
    transects: _Transects | None = Field(None, alias="TransectStyleComplexItem")


class _Mission(_Part):
    items: tuple[Annotated[_SimpleItem | _ComplexItem, Field(discriminator="type")], ...]
    home: tuple[_Latitude, _Longitude, float | None] = Field(alias="plannedHomePosition")
    speed_m_s: _Length = Field(5.0, alias="hoverSpeed")


class _Plan(_Part):
    file_type: Literal["Plan"] = Field(alias="fileType")
    mission: _Mission


def read_plan(
    path: Path,
    origin: Geodetic,
    area_m: float,
    ground_height: GroundHeight,
    pitch_deg: float,
) -> Aims:
    """Read a mission plan and return its exposures.

    Args:
        path: The ``.plan`` file.
        origin: Where on earth the origin of the world lies.
        area_m: Side of the square place around the origin, metres.
        ground_height: Height of the ground in metres at world x, y in metres.
        pitch_deg: Pitch of the gimbal until the plan changes it.

    Raises:
        InputError: The file cannot be read or interpreted, the plan takes no photographs or too
            many, or it lies outside the place.
    """
    mission = read_json(path, _Plan, "mission plan").mission
    aircraft = Aircraft(mission.home[:2], mission.speed_m_s, pitch_deg, origin, ground_height)
    try:
        commands = list(_commands(mission))
        _require_near(aircraft, commands, origin, 0.5 * area_m)
        aims = aircraft.fly(commands)
    except InputError as error:
        raise InputError(f"mission plan {path}: {error}") from None
    if not len(aims.centres):
        raise InputError(f"mission plan {path} takes no photographs: give it camera triggers")
    return aims


def _commands(mission: _Mission) -> Iterator[Command]:
    """Yield all commands in flying order, including those of surveys."""
    for number, item in enumerate(mission.items):
        if isinstance(item, _SimpleItem):
            yield item
        elif item.transects is not None:
            yield from item.transects.items or _along(item.transects, number)
        elif "landing" not in item.kind.lower():
            raise InputError(
                f"item {number} is a {item.kind}, which is not understood: fly it by waypoints"
            )


def _along(transects: _Transects, number: int) -> Iterator[Command]:
    """Yield the commands of a survey that was saved without them, made from its transects."""
    height, trigger = transects.camera.distance_m, transects.camera.trigger_m
    if not transects.points or height is None or trigger is None:
        raise InputError(
            f"item {number} has neither Items nor transects with a distance to the surface and "
            "between photographs: save it again in QGroundControl"
        )
    frame = (TERRAIN if transects.follows_terrain else RELATIVE)[0]
    for k, (latitude, longitude) in enumerate(transects.points):
        place = (0.0, 0.0, 0.0, None, latitude, longitude, height)
        yield Command(command=Mav.WAYPOINT, frame=frame, params=place)
        if k == 0:
            start = (trigger, 0.0, 1.0, None, None, None, None)
            yield Command(command=Mav.TRIGGER_DISTANCE, params=start)
    yield Command(command=Mav.TRIGGER_DISTANCE, params=(0.0,) * 7)


def _require_near(
    aircraft: Aircraft, commands: list[Command], origin: Geodetic, half_m: float
) -> None:
    places = aircraft.places(commands)
    if not len(places):
        raise InputError("it has no waypoints: plan a flight")
    off = np.abs(places[:, :2])
    if not (off <= half_m).all(1).any():
        nearest = np.linalg.norm(off, axis=1).min()
        raise InputError(
            f"its nearest waypoint lies {nearest:,.0f} m from the place's "
            f"middle: plan around {origin.latitude:.6f}, {origin.longitude:.6f} or set the origin"
        )
