"""Descriptor matching by mutual nearest neighbours."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# Rows compared at a time. A matrix of all similarities takes 144 MB for 6000 descriptors, and
# allocating it takes a third of the time.
_BLOCK_ROWS = 512


def match(a: Tensor, b: Tensor, ratio: float) -> NDArray[np.int64]:
    """Return the mutual nearest neighbours that pass the ratio test in both directions.

    Args:
        a: descriptors of one image, (N, D) float of unit length.
        b: descriptors of the other image, (M, D) float of unit length.
        ratio: largest ratio of the distances to the nearest and the second nearest descriptor.

    Returns:
        (K, 2) row in ``a`` and row in ``b`` of each match.

    Examples:
        >>> a = torch.eye(3)
        >>> match(a, a[[2, 0, 1]], ratio=0.8).tolist()
        [[0, 1], [1, 2], [2, 0]]
    """
    if min(len(a), len(b)) < 2:
        return np.zeros((0, 2), np.int64)
    best_b, distinct = _nearest(a, b, ratio)
    # Few rows pass, so the reverse search needs only their matches.
    rows = distinct.nonzero()[:, 0]
    columns = best_b[rows]
    best_a, distinct = _nearest(b[columns], a, ratio)
    mutual = (best_a == rows) & distinct
    return torch.stack([rows[mutual], columns[mutual]], -1).numpy()


def _nearest(a: Tensor, b: Tensor, ratio: float) -> tuple[Tensor, Tensor]:
    """Return the nearest row of b for every row of a, and whether it passes the ratio test."""
    nearest = [(block @ b.T).topk(2, dim=1) for block in torch.split(a, _BLOCK_ROWS)]
    values, columns = (torch.cat(parts) for parts in zip(*nearest, strict=True))
    distance = (2 - 2 * values).clamp_min(0).sqrt()
    return columns[:, 0], distance[:, 0] < ratio * distance[:, 1]
