"""Which photographs to match a photograph with."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from dense.planes import planes_at_nearest
from scene.maps.sparse_map import SparseMap

# Two photographs look at the same side of things when they share so many points of the map.
_COMMON = 5
# The picture is covered point by point on a grid of so many a side.
_GRID = 12
# The angle (degrees) between rays that serves best: smaller ones leave depth vague (the Gaussian's
# width to that side), larger ones change what is seen (to the other side).
_BEST, _BELOW, _ABOVE = 12.0, 5.0, 15.0


def seeds_in(sparse_map: SparseMap, name: str) -> NDArray[np.float64]:
    """Map points in a photograph, (M, 3): x, y (pixels) and inverse depth (1/m).

    Those it observes, and those that no photograph observes: points that were not triangulated but
    added to the map by other means.
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
    sparse_map: SparseMap, name: str, seeds: NDArray[np.float64], count: int
) -> list[str]:
    """Up to ``count`` photographs that together see all of one at good angles, best first.

    Args:
        sparse_map: with undistorted cameras.
        name: of the photograph to be matched.
        seeds: in it, as ``seeds_in`` gives them.
        count: at most so many.
    """
    image = sparse_map.images[name]
    observed = image.point_rows[image.point_rows >= 0]
    width, height = image.camera.width, image.camera.height
    # Planes at the centres of a coarse grid stand for the surface everywhere in the picture.
    scale = np.array([_GRID / width, _GRID / height, 1.0])
    inverse = planes_at_nearest(seeds * scale, _GRID, _GRID)[0].double().reshape(-1, 1)
    steps = (torch.arange(_GRID, dtype=torch.float64) + 0.5) / _GRID
    xy = torch.cartesian_prod(steps * height, steps * width).flip(-1)
    rays, _ = image.camera.unproject(xy)
    surface = image.pose.inverse().transform(rays / inverse)
    weights = {}
    for other in sparse_map.images.values():
        if other.name == name or np.isin(other.point_rows, observed).sum() < _COMMON:
            continue
        seen = other.camera.project(other.pose.transform(surface))
        inside = (seen.valid & other.camera.contains(seen.xy)).numpy()
        weights[other.name] = inside * _angle_weight(surface.numpy(), image.centre, other.centre)
    chosen: list[str] = []
    covered = np.zeros(len(xy))
    while weights and len(chosen) < count:
        best = max(weights, key=lambda n: float((weights[n] / (1 + covered) ** 2).sum()))
        covered += weights.pop(best)
        chosen.append(best)
    return chosen


def _angle_weight(
    points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    to_a, to_b = points - a, points - b
    cosine = (to_a * to_b).sum(1) / np.linalg.norm(to_a, axis=1) / np.linalg.norm(to_b, axis=1)
    off = np.degrees(np.arccos(cosine.clip(-1, 1))) - _BEST
    return np.asarray(np.exp(-0.5 * (off / np.where(off < 0, _BELOW, _ABOVE)) ** 2))
