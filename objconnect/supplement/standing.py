"""What stands on the ground: points a little above the plane that lies under them."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

# The ground under a point is a plane through so many points around it, seen from above ...
_AROUND: Final = 24
# ... that begins level at their median, and is fitted in rounds in each of which fewer are close.
_CLOSE_M: Final = (0.8, 0.4, 0.2, 0.1, 0.1, 0.1)
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
    off = around[..., 2] - np.median(around[..., 2], axis=1, keepdims=True)
    for close in _CLOSE_M:
        weight = 1 / (1 + np.square(off / close))
        weighted = design * weight[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, design) + 1e-6 * np.eye(3)
        right = np.einsum("nki,nk->ni", weighted, around[..., 2])
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        off = around[..., 2] - np.einsum("nki,ni->nk", design, plane)
    return np.asarray(xyz[:, 2] - plane[:, 2])


def nearest(
    query: NDArray[np.float64], cloud: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The points of a cloud (M, D) nearest to others (N, D): rows and distances, (N, count)."""
    middle = cloud.mean(0)
    tree = cv2.flann.Index((cloud - middle).astype(np.float32), _EXACT)
    rows, squares = tree.knnSearch((query - middle).astype(np.float32), count, params=_UNLIMITED)
    return rows.astype(np.int64), np.sqrt(squares.astype(np.float64))
