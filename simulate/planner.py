"""Plan the poses of the photographs of a session (one flight) from its configuration."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.config import Config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from simulate.config import SessionConfig, SimulateConfig
from simulate.flight.clearance import is_free
from simulate.flight.config import (
    CorridorFlight,
    FlownFlight,
    FreeFlight,
    GridFlight,
    NadirFlight,
    ObliqueFlight,
    PlanFlight,
    StreetFlight,
    draw_plan,
    plan_digest,
)
from simulate.flight.context import FlightContext, FreeTest, Wind
from simulate.flight.flights import plan_grid, plan_nadir, plan_oblique
from simulate.flight.gimbal import Aims, perturb_poses
from simulate.flight.qgroundcontrol import check_plan, read_plan
from simulate.flight.recorded import read_flown_poses
from simulate.flight.routes import corridor_aims, free_aims, street_aims
from simulate.place.world import World
from simulate.seeds import course_generator

Array = NDArray[np.float64]

Planner = Callable[[Any, FlightContext, Any, np.random.Generator], Array]
"""A function that plans the poses (N, 4, 4) of a flight from its configuration, its
context, the number of frames (None where the flight determines it) and a random generator."""


def session_generator(config: SimulateConfig, index: int) -> np.random.Generator:
    """Return the generator that draws a session's path, its wind and the noise of its priors.

    Each session has its own generator, so that adding a session does not change others.

    Args:
        config: The configuration of the scene.
        index: The index of the session in the configuration, from 0.
    """
    preset = config.preset if config.courses == "own" else ""
    return course_generator(config.seed, index, preset)


def check_plans(config: SimulateConfig) -> None:
    """Check that the mission plans of all sessions can be read, before the slow build of a place.

    Raises:
        InputError: A plan cannot be read, or has changed since the scene was configured.
    """
    for session in config.sessions:
        if isinstance(session.flight, PlanFlight):
            _require_unchanged(session.flight)
            check_plan(session.flight.file)


def plan_session(
    session: SessionConfig,
    config: SimulateConfig,
    camera: Camera,
    world: World,
    rng: np.random.Generator,
    free_test: FreeTest | None = None,
) -> Array:
    """Plan the poses of a session's photographs.

    Args:
        session: The session, whose flight is planned.
        config: The configuration of the scene.
        camera: The camera of the photographs; its footprint is approximated by a pinhole.
        world: The place, with the objects that the session moves, removes or adds.
        rng: The random generator of the session, see ``session_generator``.
        free_test: Returns which positions (N, 3) are free for a camera; None tests them against
            the objects of ``world``.

    Returns:
        The poses ``cam_from_world`` (N, 4, 4) float64 in flying order.

    Raises:
        InputError: The flight cannot be planned.
    """
    flight = session.flight
    defaults = config.map_plan if session.role == "map" else config.query_plan
    context = FlightContext(
        side_m=config.area,
        ground_height=world.flight_ground.height,
        camera=camera,
        defaults=draw_plan(defaults, rng) if config.courses == "own" else defaults,
        wind=Wind(config.position_jitter_m, config.attitude_jitter_deg),
        roads=world.roads,
        is_free=free_test or partial(is_free, world=world),
        origin=config.origin,
    )
    frames = None if flight.determines_frames else session.frames or config.frames
    return PLANNERS[type(flight)](flight, context, frames, rng)


def _plan_corridor(
    flight: CorridorFlight, context: FlightContext, frames: int | None, rng: np.random.Generator
) -> Array:
    return perturb_poses(corridor_aims(flight, context, frames), context.wind, rng)


def _plan_free(
    flight: FreeFlight, context: FlightContext, frames: int, rng: np.random.Generator
) -> Array:
    return perturb_poses(free_aims(flight, context, frames, rng), context.wind, rng)


def _plan_street(
    flight: StreetFlight, context: FlightContext, frames: int, rng: np.random.Generator
) -> Array:
    """Plan a drive; the wind does not move a vehicle."""
    return perturb_poses(street_aims(flight, context, frames), Wind(), rng)


def _plan_mission(
    flight: PlanFlight, context: FlightContext, _frames: None, rng: np.random.Generator
) -> Array:
    """Plan the photographs of a mission plan, whose file must not have changed."""
    _require_unchanged(flight)
    aims: Aims = read_plan(
        flight.file,
        context.origin,
        context.side_m,
        context.ground_height,
        flight.pitch_deg,
        flight.undulation_m,
    )
    return perturb_poses(aims, context.wind, rng)


def _require_unchanged(flight: PlanFlight) -> None:
    if plan_digest(flight.file) != flight.sha256:
        raise InputError(
            f"mission plan {flight.file} has changed since the scene was configured: restore it"
        )


def _plan_recorded(
    flight: FlownFlight, context: FlightContext, _frames: None, _rng: np.random.Generator
) -> Array:
    """Return the recorded poses, which include the wind of their flight."""
    return read_flown_poses(flight, context)


PLANNERS: dict[type[Config], Planner] = {
    NadirFlight: plan_nadir,
    GridFlight: plan_grid,
    ObliqueFlight: plan_oblique,
    CorridorFlight: _plan_corridor,
    FreeFlight: _plan_free,
    StreetFlight: _plan_street,
    PlanFlight: _plan_mission,
    FlownFlight: _plan_recorded,
}
"""The planner of each kind of flight, by the type of its configuration."""
