"""Objects in a feature map: occupancies, affinities, attention and centres.

A feature map is a list of its cells here, (B, h w, C), so that a 1x1 convolution is a linear layer.
An occupancy stores the index of each cell's object instead of N x h w numbers; sums over objects
are sums by index.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from objconnect.network.segmentation import NOTHING

# Factor on the initial weights of a layer that adds to features.
_SMALL = 0.1


@dataclass(frozen=True)
class Occupancy:
    """F_D of equation (1): which cells each of N objects occupies.

    Attributes:
        index: object (B, h w) of each cell, int64; N for cells without an object.
        area: number (B, N) of cells of each object, float; 0 for absent objects.
        width: number of cells in a row of the map.
    """

    index: Tensor
    area: Tensor
    width: int

    @property
    def present(self) -> Tensor:
        """Return whether objects (B, N) have a cell."""
        return self.area > 0

    def mean(self, cells: Tensor) -> Tensor:
        """Average cells (B, h w, C) over each object, (B, N, C) float32; 0 for absent objects."""
        total = _sum_by_object(cells, self.index, self.area.shape[1])
        return total / self.area.clamp(min=1)[..., None]

    def paint(self, vectors: Tensor) -> Tensor:
        """Copy each object's vector (B, N, C) to its cells, (B, h w, C); 0 outside objects."""
        batch, count, size = vectors.shape
        table = torch.cat([vectors, vectors.new_zeros(batch, 1, size)], 1).flatten(0, 1)
        picked = table.index_select(0, _flatten_index(self.index, count))
        return picked.view(batch, -1, size)


def occupancy(labels: Tensor, count: int) -> Occupancy:
    """Return F_D = S(H(I_l); N) of equation (1): the occupancies of a level's labels.

    Args:
        labels: labels (B, h, w) int64; ``NOTHING`` and labels of ``count`` or more mean no object.
        count: number N of objects.
    """
    index = labels.flatten(1)
    index = torch.where((index <= NOTHING) | (index >= count), count, index)
    ones = torch.ones(*index.shape, 1, device=labels.device)
    return Occupancy(index, _sum_by_object(ones, index, count)[..., 0], labels.shape[2])


def affinity(objects: Occupancy, cells: Tensor) -> Tensor:
    """Return F_A = F_D x H(I_l) of equation (2): the mean of each channel over each object.

    F_A (B, N, C) is divided by the object's area, so that it does not grow with size.

    Args:
        objects: F_D.
        cells: H(I_l), (B, h w, C).
    """
    return objects.mean(cells)


class Attention(nn.Module):
    """Equation (3), O = H{(F_A x F_D) (+) H(I_l)}.

    The affinities of an object are copied to its cells and concatenated with the cells' own
    features. The output of a convolution over both is added to the features.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.join = nn.Linear(2 * size, size)
        self.out = init_small(nn.Linear(size, size))

    def forward(self, cells: Tensor, objects: Occupancy) -> Tensor:
        """Return the features of cells (B, h w, C) with the output added."""
        affinities = objects.paint(affinity(objects, cells)).to(cells.dtype)
        joined = self.join(torch.cat([affinities, cells], -1)).relu()
        result: Tensor = cells + self.out(joined)
        return result


def centres(objects: Occupancy) -> Tensor:
    """Return the centres c_i of objects, the first moments of F_D, (B, N, 2) x y.

    They are in cells, and the centre of the first cell is (0.5, 0.5). Absent objects have (0, 0).
    """
    cell = torch.arange(objects.index.shape[1], device=objects.index.device)
    xy = torch.stack([cell % objects.width, cell // objects.width], -1) + 0.5
    return objects.mean(xy.expand(len(objects.index), -1, -1))


class Objects(NamedTuple):
    """The set V of an image: its objects as points.

    Attributes:
        centres: centres (B, N, 2) x y, pixels.
        vectors: features O at the centres, (B, N, C) float32.
        confidence: probability (B, N) that another image would show the same object.
        present: (B, N) bool, which of the N objects exist.
    """

    centres: Tensor
    vectors: Tensor
    confidence: Tensor
    present: Tensor


def init_small(layer: nn.Linear) -> nn.Linear:
    """Initialise the last layer of a residual block so that the untrained block adds little."""
    with torch.no_grad():
        layer.weight *= _SMALL
        nn.init.zeros_(layer.bias)
    return layer


def _flatten_index(index: Tensor, count: int) -> Tensor:
    """Return the row (B h w,) of each cell's object in a table of all objects of the batch.

    Each image has one more row, for cells without an object.
    """
    first = torch.arange(len(index), device=index.device) * (count + 1)
    return (index + first[:, None]).flatten()


def _sum_by_object(cells: Tensor, index: Tensor, count: int) -> Tensor:
    """Sum cells (B, h w, C) over each of ``count`` objects, (B, N, C) float32."""
    batch, _, size = cells.shape
    # Half precision is too inexact for sums over the cells of a large object.
    total = torch.zeros(batch * (count + 1), size, device=cells.device)
    total = total.index_add(0, _flatten_index(index, count), cells.flatten(0, 1).float())
    return total.view(batch, count + 1, size)[:, :count]
