"""Descriptor matching."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def match(a: Tensor, b: Tensor, ratio: float) -> NDArray[np.int64]:
    """Mutual nearest neighbours that pass the ratio test in both directions.

    Args:
        a: (N, D) float descriptors of unit length.
        b: (M, D) the same.
        ratio: nearest distance over second nearest must be below it.

    Returns:
        (K, 2) rows of a and of b.
    """
    if min(len(a), len(b)) < 2:
        return np.zeros((0, 2), np.int64)
    similarity = a @ b.T
    best_b, b_distinct = _nearest(similarity, ratio)
    best_a, a_distinct = _nearest(similarity.T, ratio)
    rows = torch.arange(len(a))
    mutual = (best_a[best_b] == rows) & b_distinct & a_distinct[best_b]
    return torch.stack([rows[mutual], best_b[mutual]], -1).numpy()


def _nearest(similarity: Tensor, ratio: float) -> tuple[Tensor, Tensor]:
    """Best column of every row, and whether it beats the second by the ratio of distances."""
    values, columns = similarity.topk(2, dim=1)
    distance = (2 - 2 * values).clamp_min(0).sqrt()
    return columns[:, 0], distance[:, 0] < ratio * distance[:, 1]
