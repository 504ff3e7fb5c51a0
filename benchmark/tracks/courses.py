"""Find flights along the same path (a *course*) among all rendered places of a benchmark track."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.courses import find_courses
from benchmark.tracks.description import Track
from benchmark.tracks.renders import Render, read_render, render_path


def track_courses(folder: Path, track: Track) -> dict[str, str]:
    """Map each flight, ``DATASET/FLIGHT``, to the first flight along the same path.

    Flights over different places are compared in local coordinates, because places of one seed may
    have the same flights. A place whose render is not recorded is left out.

    Args:
        folder: folder of the track.
        track: description of the track.

    Raises:
        InputError: a record is damaged.
    """
    flights: dict[str, NDArray[np.float64]] = {}
    for place in track.places:
        record = render_path(folder, place.dataset)
        if os.path.lexists(record):
            flights |= _flights(place.dataset, read_render(record))
    return find_courses(flights)


def _flights(dataset: str, render: Render) -> dict[str, NDArray[np.float64]]:
    """Return the camera centres (N, 3) of each flight over a place, metres."""
    centres: dict[str, list[NDArray[np.float64]]] = {}
    for frame in render.frames:
        pose = np.array(frame.cam_from_world).reshape(3, 4)
        flight = f"{dataset}/{frame.name.partition('/')[0]}"
        centres.setdefault(flight, []).append(-pose[:, :3].T @ pose[:, 3])
    return {flight: np.stack(rows) for flight, rows in centres.items()}
