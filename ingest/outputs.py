"""The files of an ingested scene that hold its frames, its split and its covisibility."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ingest.adjustment import Adjusted
from ingest.attitude import attitudes
from ingest.options import IngestOptions
from ingest.photographs import SESSION, FlightImage
from ingest.report import residuals
from scene.bundle.covisibility import Covisibility, visible_share, write_covisibility
from scene.bundle.frames import Frames, write_frames
from scene.bundle.manifest import Objects, Splits, write_json
from scene.bundle.scene import COVISIBILITY
from scene.maps.sparse_map import SparseMap


def write_measurements(
    out: Path,
    adjusted: Adjusted,
    images: Sequence[FlightImage],
    fixes: Mapping[str, NDArray[np.float64]],
    queries: set[str],
    options: IngestOptions,
) -> dict[str, float]:
    """Write the poses of the model and the measurements of its photographs.

    The sigmas are measured on the photographs of the map.

    Returns:
        By file, the error in degrees of each attitude that was not used.
    """
    model, placed = adjusted.model, adjusted.placed
    names = tuple(image.name for image in images)
    poses = np.stack([model.images[name].cam_from_world for name in names])
    measured = [name for name in names if name in fixes and name not in placed.blunders]
    mapped = [name for name in measured if name not in queries] or measured
    off = residuals(model, fixes, mapped)
    spread = np.sqrt((off**2).mean(0)) if mapped else np.zeros(3)
    sigma = np.maximum(spread, options.placement.min_sigma_m)
    nothing = np.full(3, np.nan)
    attitude, attitude_sigma, wrong = attitudes(images, poses, queries, options)
    times = [image.exif.time.timestamp() if image.exif.time else np.nan for image in images]
    frames = Frames(
        names=names,
        cameras=tuple(model.images[name].camera for name in names),
        cam_from_world=poses,
        time=np.array(times),
        gps_prior=np.array([fixes[n] if n in measured else nothing for n in names]),
        gps_sigma=np.array([sigma if n in measured else nothing for n in names]),
        attitude_prior=attitude,
        attitude_sigma_deg=attitude_sigma,
    )
    write_frames(out / "sessions" / SESSION / "frames.h5", frames, (), iter([{}] * len(names)))
    return wrong


def write_lists(
    out: Path,
    model: SparseMap,
    images: Sequence[FlightImage],
    queries: set[str],
    covisibility_points: int,
) -> None:
    """Write the split, an empty list of objects and the covisibility of the photographs.

    Covisibility is measured on at most ``covisibility_points`` points of each photograph.
    """
    names = tuple(image.name for image in images)
    asked = tuple(name for name in names if name in queries)
    splits = Splits(
        map=tuple(name for name in names if name not in queries),
        queries={SESSION: asked} if asked else {},
    )
    write_json(out / "splits.json", splits)
    write_json(out / "objects.json", Objects(classes={}, objects=()))
    write_covisibility(out / COVISIBILITY, _covisibility(model, names, covisibility_points))


def _covisibility(model: SparseMap, names: tuple[str, ...], sampled: int) -> Covisibility:
    """Measure covisibility on points in view; without depth, hidden points count as seen."""
    points = np.full((len(names), sampled, 3), np.nan)
    for k, name in enumerate(names):
        rows = model.images[name].point_rows
        seen = model.xyz[rows[rows >= 0]]
        chosen = seen[np.linspace(0, len(seen) - 1, min(sampled, len(seen))).astype(int)]
        points[k, : len(chosen)] = chosen
    images = [model.images[name] for name in names]
    poses = np.stack([image.cam_from_world for image in images])
    return Covisibility(names, visible_share([image.camera for image in images], poses, points))
