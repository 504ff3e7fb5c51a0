"""Choose source photographs for the depth map of a photograph."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.dense.planes import planes_at_nearest
from objconnect.scene.maps.sparse_map import SparseMap

# Minimum number of common map points of a photograph and its source; fewer may be outliers.
_MIN_COMMON: Final = 5
# Sources must cover a grid with this many points per side.
_GRID: Final = 12
# Best triangulation angle, and the widths of the Gaussian weight below and above it. Small angles
# make depth inexact, large ones change the appearance.
_BEST_ANGLE_DEG: Final = 12.0
_NARROWER_DEG: Final = 5.0
_WIDER_DEG: Final = 15.0


def seeds_in(sparse_map: SparseMap, name: str) -> NDArray[np.float64]:
    """Return the map points in a photograph, (M, 3): x, y (pixels) and inverse depth (1/m).

    They are the points that it observes, and points without observations, which were not
    triangulated but added to the map.
    """
    image = sparse_map.images[name]
    wanted = sparse_map.track_length == 0
    wanted[image.point_rows[image.point_rows >= 0]] = True
    points = sparse_map.xyz[wanted]
    local = image.pose.transform(torch.from_numpy(points))
    projected = image.camera.project(local)
    inside = projected.valid & image.camera.contains(projected.xy)
    return torch.cat([projected.xy, 1 / local[:, 2:]], -1)[inside].numpy()


def choose_sources(
    sparse_map: SparseMap,
    name: str,
    seeds: NDArray[np.float64],
    count: int,
) -> list[str]:
    """Choose photographs that together see all of a photograph at good angles, best first.

    Args:
        sparse_map: map with undistorted cameras.
        name: the photograph to be matched.
        seeds: its map points, as those of ``seeds_in``.
        count: largest number of sources.
    """
    image = sparse_map.images[name]
    observed = image.point_rows[image.point_rows >= 0]
    width, height = image.camera.width, image.camera.height
    # Planes at the centres of a coarse grid approximate the surface in the picture.
    scale = np.array([_GRID / width, _GRID / height, 1.0])
    inverse = planes_at_nearest(seeds * scale, _GRID, _GRID)[0].double().reshape(-1, 1)
    steps = (torch.arange(_GRID, dtype=torch.float64) + 0.5) / _GRID
    xy = torch.cartesian_prod(steps * height, steps * width).flip(-1)
    rays, _ = image.camera.unproject(xy)
    surface = image.pose.inverse().transform(rays / inverse)
    weights = {}
    for other in sparse_map.images.values():
        if other.name == name or np.isin(other.point_rows, observed).sum() < _MIN_COMMON:
            continue
        seen = other.camera.project(other.pose.transform(surface))
        inside = (seen.valid & other.camera.contains(seen.xy)).numpy()
        angle = _angle_deg(surface.numpy(), image.centre, other.centre)
        weights[other.name] = inside * _angle_weight(angle)
    chosen: list[str] = []
    covered = np.zeros(len(xy))
    while weights and len(chosen) < count:
        best = max(weights, key=lambda n: float((weights[n] / (1 + covered) ** 2).sum()))
        covered += weights.pop(best)
        chosen.append(best)
    return chosen


def choose_all(sparse_map: SparseMap, count: int, enough: int) -> dict[str, list[str]]:
    """Choose the sources of every photograph that has enough of them.

    Args:
        sparse_map: map with undistorted cameras.
        count: largest number of sources of a photograph.
        enough: least number of sources; photographs with fewer are left out.
    """
    pairs = {}
    for name in sparse_map.names:
        seeds = seeds_in(sparse_map, name)
        chosen = choose_sources(sparse_map, name, seeds, count) if len(seeds) else []
        if len(chosen) >= enough:
            pairs[name] = chosen
    # A source must have a map, and so sources, of its own.
    while True:
        kept = {name: [o for o in chosen if o in pairs] for name, chosen in pairs.items()}
        kept = {name: chosen for name, chosen in kept.items() if len(chosen) >= enough}
        if kept == pairs:
            return pairs
        pairs = kept


def _angle_deg(
    points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angles (N,) between the rays from points (N, 3) to two centres (3,)."""
    to_a, to_b = points - a, points - b
    cosine = (to_a * to_b).sum(1) / np.linalg.norm(to_a, axis=1) / np.linalg.norm(to_b, axis=1)
    return np.asarray(np.degrees(np.arccos(cosine.clip(-1, 1))))


def _angle_weight(angle_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    off = angle_deg - _BEST_ANGLE_DEG
    width = np.where(off < 0, _NARROWER_DEG, _WIDER_DEG)
    return np.asarray(np.exp(-0.5 * (off / width) ** 2))
