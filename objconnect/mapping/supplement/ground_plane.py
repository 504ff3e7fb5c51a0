"""Estimate the ground under a point cloud, and heights above it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.maps.sparse_map import MapImage

# Number of horizontally nearest points to which the ground plane under a point is fitted.
_NEIGHBOURS: Final = 24
# Scales (m) of the Cauchy weights in the rounds of the fit. The plane starts level at the median
# height; the first, larger scales let it descend from roofs to the ground and follow slopes.
_CAUCHY_SCALES_M: Final = (0.8, 0.4, 0.2, 0.1, 0.1, 0.1)
# Side of the grid cells of the ground, and margin around the middle 99 % of the points (m).
_CELL_M: Final = 2.0
_MARGIN_M: Final = 15.0
# Iterations of the intersection of rays with the ground.
_RAY_STEPS: Final = 6
# FLANN's single k-d tree (4) with an exact search.
_FLANN_INDEX: Final = {"algorithm": 4, "leaf_max_size": 10}
_FLANN_SEARCH: Final = {"checks": -1}
# Number of cells that are computed at once.
_AT_ONCE: Final = 4096


@dataclass(frozen=True)
class Ground:
    """The ground under a point cloud, as heights on a grid.

    Attributes:
        corner: east and north (2,) of the first node, world metres.
        z: heights (R, C), world metres; rows run to the north.
    """

    corner: NDArray[np.float64]
    z: NDArray[np.float64]

    @staticmethod
    def of(cloud: NDArray[np.float64]) -> Ground:
        """Estimate the ground under points (M, 3); see ``heights_above_ground``."""
        low, high = np.percentile(cloud[:, :2], [0.5, 99.5], axis=0)
        corner = low - _MARGIN_M
        side = (high + _MARGIN_M - corner) / _CELL_M
        columns, rows = (np.ceil(side) + 1).astype(int)
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        nodes = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * _CELL_M
        nodes[:, :2] += corner
        parts = np.array_split(nodes, 1 + len(nodes) // _AT_ONCE)
        below = np.concatenate([heights_above_ground(part, cloud) for part in parts])
        return Ground(corner, -below.reshape(x.shape))

    def height_at(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights (N,) of the ground at positions (N, 2), interpolated between nodes."""
        size = np.array(self.z.shape[::-1])
        cells = ((xy - self.corner) / _CELL_M).clip(0, size - 1.001)
        column, row = cells.astype(int).T
        right, up = (cells % 1).T
        south = self.z[row, column] * (1 - right) + self.z[row, column + 1] * right
        north = self.z[row + 1, column] * (1 - right) + self.z[row + 1, column + 1] * right
        return np.asarray(south * (1 - up) + north * up)

    def intersect_rays(
        self, image: MapImage, xy: NDArray[np.float64], above: float
    ) -> NDArray[np.float64]:
        """Return the points (N, 3) on the rays of pixels (N, 2) at a height above the ground."""
        rays = image.camera.unproject(torch.from_numpy(xy))[0].numpy()
        rays = rays @ image.cam_from_world[:3, :3]
        z = np.full(len(xy), np.median(self.z))
        points = np.tile(image.centre, (len(xy), 1))
        for _ in range(_RAY_STEPS):
            along = (z + above - image.centre[2]) / np.minimum(rays[:, 2], -1e-6)
            points = image.centre + rays * along[:, None]
            z = self.height_at(points[:, :2])
        return points


def heights_above_ground(
    xyz: NDArray[np.float64], cloud: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return heights (N,) of points (N, 3) above a robust plane through the cloud around them.

    They are world metres, with z up, and infinite where the cloud (M, 3) has too few points.
    """
    if len(cloud) < _NEIGHBOURS or not len(xyz):
        return np.full(len(xyz), math.inf)
    neighbours, _ = find_nearest(xyz[:, :2], cloud[:, :2], _NEIGHBOURS)
    around = cloud[neighbours] - np.concatenate([xyz[:, :2], np.zeros((len(xyz), 1))], 1)[:, None]
    design = np.concatenate([around[..., :2], np.ones((*neighbours.shape, 1))], 2)
    residual = around[..., 2] - np.median(around[..., 2], axis=1, keepdims=True)
    for scale in _CAUCHY_SCALES_M:
        weight = 1 / (1 + np.square(residual / scale))
        weighted = design * weight[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, design) + 1e-6 * np.eye(3)
        right = np.einsum("nki,nk->ni", weighted, around[..., 2])
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        residual = around[..., 2] - np.einsum("nki,ni->nk", design, plane)
    return np.asarray(xyz[:, 2] - plane[:, 2])


def find_nearest(
    query: NDArray[np.float64], cloud: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Find the nearest points of a cloud (M, D) to queries (N, D): rows, distances (N, count)."""
    middle = cloud.mean(0)
    tree = cv2.flann.Index((cloud - middle).astype(np.float32), _FLANN_INDEX)
    rows, squares = tree.knnSearch((query - middle).astype(np.float32), count, params=_FLANN_SEARCH)
    return rows.astype(np.int64), np.sqrt(squares.astype(np.float64))
