"""Plan a scene: its place, the objects and the flight of every session, before it is rendered."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulate.base_place import base_place
from simulate.camera.lens import cover_by_pinhole
from simulate.config import SimulateConfig
from simulate.flight.clearance import check_flight
from simulate.place.change import ChangedWorld, change_worlds, list_objects
from simulate.place.presets import PRESETS
from simulate.place.tiles import TiledPlace, is_tiled
from simulate.place.world import World, WorldObject
from simulate.planner import plan_session, session_generator
from simulate.render.window import Window
from simulate.tiled_scene import TiledScene
from simulate.twin.report import SiteReport


class SessionPlan(NamedTuple):
    """A planned session (flight).

    Attributes:
        poses: Poses ``cam_from_world`` (N, 4, 4).
        rng: Generator of the noise of its position and attitude priors.
        first_new_id: First id of objects that the session moves or adds, in a place without tiles.
        windows: Squares of tiles of a tiled place, each with the photographs that need them; empty
            for other places.
    """

    poses: NDArray[np.float64]
    rng: np.random.Generator
    first_new_id: int = 0
    windows: tuple[Window, ...] = ()


class ScenePlan(NamedTuple):
    """A planned scene.

    Attributes:
        place: The place before sessions change objects. A tiled place has no objects here.
        report: Report of a site (a real place), if it must still be written; None otherwise.
        objects: Objects of all sessions, by ascending id. Of a tiled place, these are the objects
            of the tiles that photographs may show.
        worlds: The world of each session.
        sessions: The plan of each session.
    """

    place: World
    report: SiteReport | None
    objects: tuple[WorldObject, ...]
    worlds: list[ChangedWorld]
    sessions: list[SessionPlan]


def plan_scene(config: SimulateConfig, out: Path, twin: Path | None) -> ScenePlan:
    """Build the place of a scene and plan its flights.

    Args:
        config: Configuration of the scene.
        out: Folder of the scene.
        twin: Folder of a finished scene of the same site, whose place is reused.

    Raises:
        InputError: The place cannot be built, or a session cannot be flown.
    """
    if config.site is None and is_tiled(config.area):
        return _plan_tiled(config)
    base, report = base_place(config, out, twin)
    sessions = config.drawn_sessions()
    worlds = change_worlds(base, [session.world_change for session in sessions])
    plans = []
    for index, (name, session) in enumerate(zip(config.session_names(), sessions, strict=True)):
        rng, camera = session_generator(config, index), config.photo_camera(session)
        world = worlds[index].world
        poses = plan_session(session, config, camera, world, rng)
        check_flight(name, poses, camera, world)
        plans.append(SessionPlan(poses, rng, worlds[index].first_new_id))
    return ScenePlan(base, report, list_objects(base, worlds), worlds, plans)


def _plan_tiled(config: SimulateConfig) -> ScenePlan:
    """Plan a scene over a tiled place: flights first, then the tiles that they show."""
    place = TiledPlace(PRESETS.load(config.preset), config.seed, config.area)
    sessions = config.drawn_sessions()
    scene = TiledScene(place, [session.world_change for session in sessions])
    plans, views = [], []
    for index, (name, session) in enumerate(zip(config.session_names(), sessions, strict=True)):
        rng, camera = session_generator(config, index), config.photo_camera(session)
        free_test = scene.free_test(index)
        poses = plan_session(session, config, camera, scene.land, rng, free_test)
        plans.append(SessionPlan(poses, rng))
        views.append(scene.find_views(name, cover_by_pinhole(camera)[0], poses))
    numbered = scene.number(views)
    for index, name in enumerate(config.session_names()):
        camera, world = config.photo_camera(sessions[index]), numbered.worlds[index].world
        check_flight(name, plans[index].poses, camera, world)
    return ScenePlan(
        place=scene.land,
        report=None,
        objects=numbered.objects,
        worlds=numbered.worlds,
        sessions=[
            plan._replace(windows=numbered.windows(index, views[index]))
            for index, plan in enumerate(plans)
        ],
    )
