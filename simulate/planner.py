"""Plan the poses of a session's photographs from its configuration."""

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
    plan_digest,
)
from simulate.flight.flights import plan_grid, plan_nadir, plan_oblique
from simulate.flight.gimbal import Aims, perturb_poses
from simulate.flight.qgroundcontrol import read_plan
from simulate.flight.recorded import read_flown_poses
from simulate.flight.routes import corridor_aims, free_aims, street_aims
from simulate.flight.site import FlightSite, Wind
from simulate.place.world import World

Array = NDArray[np.float64]

Planner = Callable[[Any, FlightSite, Any, np.random.Generator], Array]
"""A function that plans the poses (N, 4, 4) of a flight from its configuration, the site, the
number of frames (None where the flight determines it) and a random generator."""


def plan_session(
    session: SessionConfig,
    config: SimulateConfig,
    camera: Camera,
    world: World,
    rng: np.random.Generator,
) -> Array:
    """Plan the poses of a session's photographs.

    Args:
        session: The session, whose flight is planned.
        config: The configuration of the scene.
        camera: The camera of the photographs; its footprint is approximated by a pinhole.
        world: The place with the session's change.
        rng: The random generator of the wind and of free flights.

    Returns:
        The poses ``cam_from_world`` (N, 4, 4) float64 in flying order.

    Raises:
        InputError: The flight cannot be planned.
    """
    flight = session.flight
    site = FlightSite(
        area_m=config.area,
        ground_height=world.footing.height,
        camera=camera,
        usual=config.map_plan if session.role == "map" else config.query_plan,
        wind=Wind(config.position_jitter_m, config.attitude_jitter_deg),
        roads=world.roads,
        is_free=partial(is_free, world=world),
        origin=config.origin,
    )
    frames = None if flight.counts_photographs else session.frames or config.frames
    return PLANNERS[type(flight)](flight, site, frames, rng)


def _plan_corridor(
    flight: CorridorFlight, site: FlightSite, frames: int | None, rng: np.random.Generator
) -> Array:
    return perturb_poses(corridor_aims(flight, site, frames), site.wind, rng)


def _plan_free(
    flight: FreeFlight, site: FlightSite, frames: int, rng: np.random.Generator
) -> Array:
    return perturb_poses(free_aims(flight, site, frames, rng), site.wind, rng)


def _plan_street(
    flight: StreetFlight, site: FlightSite, frames: int, rng: np.random.Generator
) -> Array:
    """Plan a drive; the wind does not move a vehicle."""
    return perturb_poses(street_aims(flight, site, frames), Wind(), rng)


def _plan_mission(
    flight: PlanFlight, site: FlightSite, _frames: None, rng: np.random.Generator
) -> Array:
    """Plan the photographs of a mission plan, whose file must not have changed."""
    if plan_digest(flight.file) != flight.sha256:
        raise InputError(
            f"mission plan {flight.file} has changed since the scene was configured: restore it"
        )
    aims: Aims = read_plan(
        flight.file,
        site.origin,
        site.area_m,
        site.ground_height,
        flight.pitch_deg,
        flight.undulation_m,
    )
    return perturb_poses(aims, site.wind, rng)


def _plan_recorded(
    flight: FlownFlight, site: FlightSite, _frames: None, _rng: np.random.Generator
) -> Array:
    """Return the recorded poses, which include the wind of their flight."""
    return read_flown_poses(flight, site)


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
