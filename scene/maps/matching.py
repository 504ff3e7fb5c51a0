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
    best_b, distinct = _nearest(a, b, ratio)
    # Few pass: asking only them for their way back is cheaper than asking all of b.
    rows = distinct.nonzero()[:, 0]
    columns = best_b[rows]
    best_a, distinct = _nearest(b[columns], a, ratio)
    mutual = (best_a == rows) & distinct
    return torch.stack([rows[mutual], columns[mutual]], -1).numpy()


def _nearest(a: Tensor, b: Tensor, ratio: float) -> tuple[Tensor, Tensor]:
    """Nearest of b for every row of a, and whether it beats the second by the ratio."""
    values, columns = (a @ b.T).topk(2, dim=1)
    distance = (2 - 2 * values).clamp_min(0).sqrt()
    return columns[:, 0], distance[:, 0] < ratio * distance[:, 1]
