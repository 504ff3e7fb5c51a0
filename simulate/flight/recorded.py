"""Repeat a recorded flight: the poses of a finished scene's photographs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import is_same_place
from simulate.flight.config import FlownFlight, scene_digest
from simulate.flight.context import FlightContext

Array = NDArray[np.float64]


def read_flown_poses(flight: FlownFlight, context: FlightContext) -> Array:
    """Return the poses ``cam_from_world`` (N, 4, 4) of a scene's photographs, in their order.

    Raises:
        InputError: The scene is not finished, has changed, has another origin, or has no
            photographs of the chosen role.
    """
    scene = Scene.open(flight.scene)
    if scene_digest(flight.scene) != flight.sha256:
        raise InputError(
            f"scene {flight.scene} has changed since the flight was configured: restore it"
        )
    if not is_same_place(context.origin, scene.manifest.origin):
        raise InputError(
            f"scene {flight.scene} has another origin than this scene: set the same origin in both"
        )
    queries = {name for names in scene.splits.queries.values() for name in names}
    chosen = {"map": set(scene.splits.map), "queries": queries}.get(flight.photographs)
    poses = [
        frames.cam_from_world[row]
        for frames in map(scene.frames, scene.sessions)
        for row, name in enumerate(frames.names)
        if chosen is None or name in chosen
    ]
    if not poses:
        raise InputError(
            f"scene {flight.scene} has no photographs for the option photographs "
            f"{flight.photographs!r} of the flight: set it to map, queries or all"
        )
    return np.stack(poses)
