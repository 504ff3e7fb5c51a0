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
# Points per side of the grid in the picture on which coverage by sources is measured.
_GRID: Final = 12
# Best triangulation angle, and the widths of the Gaussian weight below and above it. Small angles
# make depth inexact, large ones change the appearance.
_BEST_ANGLE_DEG: Final = 12.0
_NARROWER_DEG: Final = 5.0
_WIDER_DEG: Final = 15.0


def find_seeds(sparse_map: SparseMap, name: str) -> NDArray[np.float64]:
    """Return the map points in a photograph, (M, 3): x, y (pixels) and inverse depth (1/m).

    They are the points that the photograph observes, and points without observations, which were
    not triangulated but added to the map.
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
        seeds: its map points, from ``find_seeds``.
        count: maximum number of sources.
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
        projected = other.camera.project(other.pose.transform(surface))
        inside = (projected.valid & other.camera.contains(projected.xy)).numpy()
        angle = _angle_deg(surface.numpy(), image.centre, other.centre)
        weights[other.name] = inside * _angle_weight(angle)
    chosen: list[str] = []
    covered = np.zeros(len(xy))
    while weights and len(chosen) < count:
        best = max(weights, key=lambda n: float((weights[n] / (1 + covered) ** 2).sum()))
        covered += weights.pop(best)
        chosen.append(best)
    return chosen


def choose_all(sparse_map: SparseMap, max_sources: int, min_sources: int) -> dict[str, list[str]]:
    """Choose the sources of every photograph that has enough of them.

    Args:
        sparse_map: map with undistorted cameras.
        max_sources: maximum number of sources of a photograph.
        min_sources: minimum number of sources; photographs with fewer are left out.
    """
    sources_of = {}
    for name in sparse_map.names:
        seeds = find_seeds(sparse_map, name)
        chosen = choose_sources(sparse_map, name, seeds, max_sources) if len(seeds) else []
        if len(chosen) >= min_sources:
            sources_of[name] = chosen
    # A source must itself have a depth map, and therefore enough sources.
    while True:
        kept = {name: [o for o in chosen if o in sources_of] for name, chosen in sources_of.items()}
        kept = {name: chosen for name, chosen in kept.items() if len(chosen) >= min_sources}
        if kept == sources_of:
            return sources_of
        sources_of = kept


def _angle_deg(
    points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angles (N,) between the rays from points (N, 3) to two centres (3,)."""
    to_a, to_b = points - a, points - b
    cosine = (to_a * to_b).sum(1) / np.linalg.norm(to_a, axis=1) / np.linalg.norm(to_b, axis=1)
    return np.asarray(np.degrees(np.arccos(cosine.clip(-1, 1))))


def _angle_weight(angle_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    difference = angle_deg - _BEST_ANGLE_DEG
    width = np.where(difference < 0, _NARROWER_DEG, _WIDER_DEG)
    return np.asarray(np.exp(-0.5 * (difference / width) ** 2))
