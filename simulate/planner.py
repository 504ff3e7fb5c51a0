"""From a session's configuration to the poses of its photographs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from scene.geometry.camera import Camera
from simulate.config import SessionConfig, SimulateConfig
from simulate.flight.clearance import is_free
from simulate.flight.config import (
    CorridorFlight,
    FreeFlight,
    GridFlight,
    NadirFlight,
    ObliqueFlight,
    PlanFlight,
    StreetFlight,
    plan_digest,
)
from simulate.flight.flights import plan_grid, plan_nadir, plan_oblique
from simulate.flight.gimbal import Aims, perturbed_poses
from simulate.flight.qgroundcontrol import read_plan
from simulate.flight.routes import plan_corridor, plan_free, plan_street
from simulate.place.world import Road, World, polyline_length, polyline_points

Array = NDArray[np.float64]


def plan_session(
    session: SessionConfig,
    config: SimulateConfig,
    camera: Camera,
    world: World,
    rng: np.random.Generator,
) -> Array:
    """Poses of a session's photographs in flying order.

    Args:
        camera: that takes them; its footprint is that of a pinhole.
        rng: of the wind and of free flights.

    Returns:
        cam_from_world (N, 4, 4) float64.

    Raises:
        InputError: the flight asks for what cannot be planned.
    """
    flight = session.flight
    usual = config.map_plan if session.role == "map" else config.query_plan
    frames = session.frames or config.frames
    ground = world.terrain.height
    focal = camera.focal[0]
    aims: Aims
    match flight:
        case NadirFlight() | GridFlight():
            forward_overlap, side_overlap = flight.overlaps
            heading = flight.heading_deg
            plan = plan_grid if isinstance(flight, GridFlight) else plan_nadir
            return plan(
                config.area,
                ground,
                width=camera.width,
                height=camera.height,
                focal=focal,
                altitude_m=flight.altitude(focal, usual.nadir_altitude_m),
                heading_deg=usual.nadir_heading_deg if heading is None else heading,
                pitch_deg=flight.pitch_deg,
                frames=None if flight.counts_photographs else frames,
                forward_overlap=forward_overlap,
                side_overlap=side_overlap,
                terrain_following=flight.terrain_following,
                position_jitter_m=config.position_jitter_m,
                attitude_jitter_deg=config.attitude_jitter_deg,
                rng=rng,
            )
        case ObliqueFlight():
            start = flight.start_deg
            return plan_oblique(
                ground,
                radius_m=flight.radius_m or usual.orbit_radius_share * config.area,
                altitude_m=flight.altitude_m or usual.orbit_altitude_m,
                frames=frames,
                pitch_deg=flight.pitch_deg,
                centre=flight.centre,
                start_deg=usual.orbit_start_deg if start is None else start,
                position_jitter_m=config.position_jitter_m,
                attitude_jitter_deg=config.attitude_jitter_deg,
                rng=rng,
            )
        case CorridorFlight():
            line = _longest_road(world) if flight.line is None else np.array(flight.line)
            altitude_m = flight.altitude(focal, usual.nadir_altitude_m)
            forward_overlap, side_overlap = flight.overlaps
            aims = plan_corridor(
                line[::-1] if usual.backwards else line,
                ground,
                footprint_m=(camera.width * altitude_m / focal, camera.height * altitude_m / focal),
                altitude_m=altitude_m,
                width_m=flight.width_m,
                lines=flight.lines,
                frames=None if flight.counts_photographs else frames,
                forward_overlap=forward_overlap,
                side_overlap=side_overlap,
                pitch_deg=flight.pitch_deg,
                terrain_following=flight.terrain_following,
            )
        case FreeFlight():
            altitude = usual.nadir_altitude_m
            aims = plan_free(
                config.area,
                ground,
                altitude_m=flight.altitude_m or (0.7 * altitude, 1.1 * altitude),
                pitch_deg=flight.pitch_deg,
                frames=frames,
                rng=rng,
            )
        case StreetFlight():
            reach = max(0.5 * config.area - flight.edge_m, 0.0)

            def is_clear(centres: Array) -> NDArray[np.bool_]:
                inside: NDArray[np.bool_] = (np.abs(centres[:, :2]) <= reach).all(1)
                return inside & is_free(centres, world)

            aims = plan_street(
                _driven(world, flight, usual.backwards),
                ground,
                is_clear,
                height_m=flight.height_m,
                yaws_deg=flight.yaws_deg,
                pitch_deg=flight.pitch_deg,
                frames=frames,
                offset_m=flight.offset_m,
            )
            return perturbed_poses(aims, 0.0, 0.0, rng)
        case PlanFlight():
            if plan_digest(flight.file) != flight.sha256:
                raise InputError(f"mission plan {flight.file} is no longer the scene's: restore it")
            aims = read_plan(flight.file, config.origin, config.area, ground, flight.pitch_deg)
        case _:
            assert_never(flight)
    return perturbed_poses(aims, config.position_jitter_m, config.attitude_jitter_deg, rng)


def _driven(world: World, flight: StreetFlight, backwards: bool) -> list[tuple[Array, float]]:
    """Centre lines in the direction they are driven, and the widths of their roads."""
    roads: Sequence[Road] = world.roads
    if flight.roads is not None:
        roads = sorted(roads, key=lambda road: -len(_inside(road, world)))[: flight.roads]
    way = flight.way or ("back" if backwards else "there")
    steps = {"there": (1,), "back": (-1,), "both": (1, -1)}[way]
    return [(road.line[::step], road.width_m) for road in roads for step in steps]


def _longest_road(world: World) -> Array:
    """The road with most of its length in the place, from where it enters to where it leaves."""
    best = max((_inside(road, world) for road in world.roads), key=len, default=np.empty((0, 2)))
    if len(best) < 2:
        raise InputError("this place has no road for a corridor to follow: give the flight a line")
    return best


def _inside(road: Road, world: World) -> Array:
    """Points (N, 2) of a road, metres apart, from where it enters the place to where it leaves."""
    points, _ = polyline_points(road.line, np.arange(0.0, polyline_length(road.line), 5.0))
    inside = np.flatnonzero((np.abs(points) <= 0.5 * world.area_m).all(1))
    return points[inside[0] : inside[-1] + 1] if len(inside) else points[:0]
