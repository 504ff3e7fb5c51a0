"""What stands on the ground: points a little above the plane that lies under them."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

# The ground under a point is a plane through so many points around it, seen from above ...
_AROUND: Final = 24
# ... that is fitted in so many rounds, those far from it counting less and less.
_ROUNDS: Final = 6
_CLOSE_M: Final = 0.1
# FLANN's single tree (4), searched to the end.
_EXACT: Final = {"algorithm": 4, "leaf_max_size": 10}
_UNLIMITED: Final = {"checks": -1}


def heights(xyz: NDArray[np.float64], cloud: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of points (N, 3) above the plane that most of the cloud (M, 3) around them lies in, (N,).

    World metres, up is z; infinite where the cloud has too few points.
    """
    if len(cloud) < _AROUND or not len(xyz):
        return np.full(len(xyz), math.inf)
    found, _ = nearest(xyz[:, :2], cloud[:, :2], _AROUND)
    around = cloud[found] - np.concatenate([xyz[:, :2], np.zeros((len(xyz), 1))], 1)[:, None]
    design = np.concatenate([around[..., :2], np.ones((*found.shape, 1))], 2)
    weight = np.ones(found.shape)
    for _ in range(_ROUNDS):
        weighted = design * weight[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, design) + 1e-6 * np.eye(3)
        right = np.einsum("nki,nk->ni", weighted, around[..., 2])
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        off = around[..., 2] - np.einsum("nki,ni->nk", design, plane)
        weight = 1 / (1 + np.square(off / _CLOSE_M))
    return np.asarray(xyz[:, 2] - plane[:, 2])


def nearest(
    query: NDArray[np.float64], cloud: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The points of a cloud (M, D) nearest to others (N, D): rows and distances, (N, count)."""
    middle = cloud.mean(0)
    tree = cv2.flann.Index((cloud - middle).astype(np.float32), _EXACT)
    rows, squares = tree.knnSearch((query - middle).astype(np.float32), count, params=_UNLIMITED)
    return rows.astype(np.int64), np.sqrt(squares.astype(np.float64))
