"""Difficulty of each query of a scene: overlap, scale, view angle and days of the year.

The figures compare a query with the map photograph that sees most of the same surface. RUBIK bins
pairs of images in the same way (Loiseau and Bourmaud, "RUBIK: A Structured Benchmark for Image
Matching across Geometric Challenges", CVPR 2025).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.dataset import Dataset
from objconnect.scene.bundle.covisibility import surface_points, visible_points
from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import write_text

# Points per side of the grid that samples the surface in a query.
_PER_SIDE: Final = 16
# Shares of the surface that differ by less count as equal, because the grid is coarse. Among map
# photographs with equal shares, the query is compared with the one of most similar view direction.
_SAME_SHARE: Final = 0.02
_YEAR_DAYS: Final = 365


class Difficulty(NamedTuple):
    """The comparison of a query with the map photograph that sees most of its surface.

    Attributes:
        overlap: share of the query's pixels whose surface the map photograph sees too, 0 to 1.
        scale: ground size of a pixel of the query divided by that of the map photograph, median
            over the surface that both see; None if they share nothing.
        angle_deg: angle between the lines of sight of query and map photograph, degrees, median
            over the surface that both see; None if they share nothing.
        days: days of the year between query and map photograph, 0 to 182; None if they share
            nothing or a time is unknown.
    """

    overlap: float
    scale: float | None
    angle_deg: float | None
    days: int | None


class QueryRow(NamedTuple):
    """A row of ``queries/<dataset>.csv``: a query and its difficulty.

    ``part`` is the kind of surroundings, such as a park.
    """

    name: str
    condition: str
    flight: str
    part: str
    difficulty: Difficulty


@dataclass(frozen=True)
class View:
    """The camera, pose (4, 4) and time of a frame (seconds since 1970, or NaN)."""

    camera: Camera
    cam_from_world: NDArray[np.float64]
    time: float


def compare(
    query: View, photograph: View, points: NDArray[np.float64], depth: NDArray[np.float32]
) -> tuple[float, float] | None:
    """Return scale and angle (degrees) between a query and a map photograph.

    Args:
        query: query.
        photograph: map photograph.
        points: (S, 3) surface that the query sees, world metres; NaN where there is none.
        depth: (H, W) planar depth of the photograph, metres.

    Returns:
        Medians over the points that both see, as in ``Difficulty``; None if there is no such point.
    """
    world = torch.from_numpy(points)
    shared = visible_points(photograph.camera, photograph.cam_from_world, world, depth).numpy()
    shared_points = points[shared]
    if not len(shared_points):
        return None
    query_m, query_rays = _ground_size_and_direction(query, shared_points)
    photograph_m, photograph_rays = _ground_size_and_direction(photograph, shared_points)
    cosine = np.clip((query_rays * photograph_rays).sum(-1), -1, 1)
    return float(np.median(query_m / photograph_m)), float(np.median(np.degrees(np.arccos(cosine))))


def days_between(one: float, other: float) -> int | None:
    """Return the days of the year between two times (s since 1970), 0 to 182; None for NaN."""
    if not np.isfinite([one, other]).all():
        return None
    first, second = (datetime.fromtimestamp(t, UTC).timetuple().tm_yday for t in (one, other))
    days = abs(first - second)
    return min(days, abs(_YEAR_DAYS - days))


def measure(scene: Scene) -> list[QueryRow]:
    """Return every query of a scene with its difficulty, in the order of the scene's lists.

    Raises:
        InputError: a list or a depth image of the scene is missing or damaged.
    """
    frames = {session: scene.frames(session) for session in scene.sessions}
    views = {
        name: view for session_frames in frames.values() for name, view in _views(session_frames)
    }
    queries = [name for names in scene.splits.queries.values() for name in names]
    if unknown := [name for name in (*queries, *scene.splits.map) if name not in views]:
        raise InputError(
            f"scene {scene.path}: {unknown[0]} in splits.json is not a frame: remove it from there"
        )
    with progress_bar("difficulty", len(queries) + len(scene.splits.map)) as advance:
        points = {}
        for name, depth in _depths(scene, frames, set(queries)):
            view = views[name]
            points[name] = surface_points(view.camera, view.cam_from_world, depth, _PER_SIDE)
            advance(len(points))
        shares = _best_photographs(scene, queries)
        # Scale and angle by query and map photograph.
        measured: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in queries}
        compared = {photograph for best in shares.values() for photograph in best}
        for k, (name, depth) in enumerate(_depths(scene, frames, compared), 1):
            for query in queries:
                if name in shares[query]:
                    figures = compare(views[query], views[name], points[query], depth)
                    if figures is not None:
                        measured[query][name] = figures
            advance(len(points) + k)
    parts = _parts(scene, [views[name] for name in queries])
    return [
        QueryRow(
            name,
            scene.sessions[session].condition,
            session,
            part,
            _difficulty(views, name, shares[name], measured[name], points[name]),
        )
        for part, (session, name) in zip(parts, _iterate_queries(scene), strict=True)
    ]


def measure_flight(dataset: Dataset) -> list[QueryRow]:
    """Return every query of a flight data set with its difficulty.

    Flights have no depth, so the ground is a level plane at the median height of the map's points.

    Raises:
        InputError: the map is damaged.
    """
    sparse_map = dataset.load_map()
    ground = float(np.median(sparse_map.xyz[:, 2]))
    views = {
        name: View(image.camera, image.cam_from_world, math.nan)
        for name, image in sparse_map.images.items()
    }
    depths = {name: ground_plane_depth(view, ground) for name, view in views.items()}
    rows = []
    for query in dataset.queries:
        view = View(query.camera, query.reference.matrix().numpy(), math.nan)
        difficulty = _flight_difficulty(view, ground, views, depths)
        rows.append(QueryRow(query.name, query.condition, query.group, dataset.name, difficulty))
    return rows


def ground_plane_depth(view: View, ground: float) -> NDArray[np.float32]:
    """Return the depth (H, W) of a level ground plane, metres; 0 where rays do not meet it.

    Args:
        view: camera and pose.
        ground: height of the ground, world metres.
    """
    rotation, translation = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3]
    rays, _ = view.camera.unproject(view.camera.pixel_grid())
    rise = rays.numpy() @ rotation[:, 2]  # upward component of each ray, per metre of depth
    ground_from_camera = ground + float(rotation[:, 2] @ translation)
    with np.errstate(divide="ignore"):
        depth = ground_from_camera / rise
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)


def _flight_difficulty(
    query: View,
    ground: float,
    photographs: Mapping[str, View],
    depths: Mapping[str, NDArray[np.float32]],
) -> Difficulty:
    """Return the difficulty of a query, given the photographs of the map and their depths."""
    points = surface_points(
        query.camera, query.cam_from_world, ground_plane_depth(query, ground), _PER_SIDE
    )
    world = torch.from_numpy(points)
    shares = {
        name: float(visible_points(view.camera, view.cam_from_world, world).float().mean())
        for name, view in photographs.items()
    }
    best = max(shares.values(), default=0.0)
    compared = [
        compare(query, photographs[name], points, depths[name])
        for name, share in shares.items()
        if share > 0 and share >= best - _SAME_SHARE
    ]
    scales_and_angles = [figures for figures in compared if figures is not None]
    if not scales_and_angles:
        return Difficulty(0.0, None, None, None)
    return Difficulty(best, *min(scales_and_angles, key=lambda figures: figures[1]), None)


def write_queries(path: Path, rows: Iterable[QueryRow]) -> None:
    """Write ``queries/<dataset>.csv`` atomically, with empty cells for unknown values.

    Raises:
        InputError: the file cannot be written.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow((*QueryRow._fields[:-1], *Difficulty._fields))
    for row in rows:
        difficulty = row.difficulty
        scale = None if difficulty.scale is None else f"{difficulty.scale:.3f}"
        angle = None if difficulty.angle_deg is None else f"{difficulty.angle_deg:.1f}"
        table.writerow((*row[:-1], f"{difficulty.overlap:.3f}", scale, angle, difficulty.days))
    write_text(path, text.getvalue())


def _ground_size_and_direction(
    view: View, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ground size of a pixel at each point (S,), metres, and the view directions
    (S, 3), unit vectors in the world."""
    rotation, translation = view.cam_from_world[:3, :3], view.cam_from_world[:3, 3]
    in_camera = points @ rotation.T + translation
    distance = np.linalg.norm(in_camera, axis=-1, keepdims=True)
    return in_camera[:, 2] / view.camera.focal[0], in_camera @ rotation / distance


def _views(frames: Frames) -> Iterator[tuple[str, View]]:
    for k, name in enumerate(frames.names):
        yield name, View(frames.cameras[k], frames.cam_from_world[k], float(frames.time[k]))


def _iterate_queries(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield session and name of every query."""
    for session, names in scene.splits.queries.items():
        yield from ((session, name) for name in names)


def _depths(
    scene: Scene, frames: Mapping[str, Frames], names: set[str]
) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Yield the depth images of the frames with these names."""
    for session, session_frames in frames.items():
        with scene.layers(session) as layers:
            for k, name in enumerate(session_frames.names):
                if name in names:
                    yield name, layers.read("depth", k)


def _best_photographs(scene: Scene, queries: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return the map photographs that see most of each query, with their shares of its surface."""
    map_names = scene.splits.map
    overlap = scene.covisibility.select([*queries, *map_names]).overlap[
        : len(queries), len(queries) :
    ]
    shares = {}
    for name, row in zip(queries, overlap.tolist(), strict=True):
        min_share = max(row, default=0.0) - _SAME_SHARE
        shares[name] = {
            photograph: share
            for photograph, share in zip(map_names, row, strict=True)
            if share > 0 and share >= min_share
        }
    return shares


def _difficulty(
    views: Mapping[str, View],
    query: str,
    shares: Mapping[str, float],
    measured: Mapping[str, tuple[float, float]],
    points: NDArray[np.float64],
) -> Difficulty:
    """Return the difficulty of a query from the scale and angle to its best map photographs."""
    if not measured:
        return Difficulty(0.0, None, None, None)
    name, (scale, angle) = min(measured.items(), key=lambda item: item[1][1])
    surface = float(np.isfinite(points).all(-1).mean())
    days = days_between(views[query].time, views[name].time)
    return Difficulty(surface * max(shares.values()), scale, angle, days)


def _parts(scene: Scene, views: Sequence[View]) -> list[str]:
    """Return the part of the place that each camera is in, or else the kind of the place."""
    kind = scene.manifest.preset or ""
    if not scene.objects.surroundings:
        return [kind] * len(views)
    poses = np.stack([view.cam_from_world for view in views])
    centres = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return [part or kind for part in scene.objects.surroundings_at(centres)]
