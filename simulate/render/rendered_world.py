"""Build the world that a render job shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulate.place.change import change_world
from simulate.place.presets import PRESETS, preset
from simulate.place.tiles import TiledPlace
from simulate.place.world import World
from simulate.render.job import RenderJob
from simulate.render.window import MAX_SCENE_ID, build_window


def build_world(job: RenderJob) -> tuple[World, tuple[float, float]]:
    """Return the world of a job, and the position of its origin in the place, metres.

    The job of a tiled place has one window, a square of tiles, and this is the world of that
    window. The poses of the job are relative to the place, not to the window.

    Raises:
        InputError: The place cannot be built.
    """
    if not job.windows:
        base = preset(job.preset, job.site_path)(job.seed, job.side_m)
        return change_world(base, job.change, job.first_new_id).world, (0.0, 0.0)
    (window,) = job.windows
    place = TiledPlace(PRESETS.load(job.preset), job.seed, job.side_m)
    x, y = place.window_centre(window.first, window.side).tolist()
    return build_window(place, window, job.change), (x, y)


def find_ids(pass_indices: NDArray[np.float32], ids: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Return the object ids (H, W) of a picture from its pass indices (H, W).

    ``ids`` are the ids of objects by their pass index.

    Raises:
        ValueError: The picture shows an object of a tile that was not expected in it. Objects of
            such tiles have placeholders above ``MAX_SCENE_ID`` instead of ids.
    """
    found = ids[np.rint(pass_indices).astype(np.int64)]
    if found.max() > MAX_SCENE_ID:
        raise ValueError("a photograph shows an object of a tile that was not expected in it")
    return found.astype(np.uint16)
