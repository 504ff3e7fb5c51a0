"""Objects in a feature map: where they are, which channels are theirs, and features that know it.

Maps are rows of cells here, (B, h w, C): a convolution of size one is then a linear layer. An
occupancy is never written out as N x h w numbers; each cell knows its object, and sums over objects
are sums by index.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from objconnect.segmentation import NOTHING

# Initial weights of a layer that adds to features, over their usual ones; training changes them.
_SMALL = 0.1


@dataclass(frozen=True)
class Occupancy:
    """F_D of equation (1): which cells each of N objects occupies.

    Attributes:
        index: (B, h w) int64, the object of each cell; N for cells of none.
        area: (B, N) cells, float; 0 for objects that are not there.
        width: cells in a row of the map.
    """

    index: Tensor
    area: Tensor
    width: int

    @property
    def present(self) -> Tensor:
        """(B, N) which objects have a cell at all."""
        return self.area > 0

    def mean(self, rows: Tensor) -> Tensor:
        """Mean of rows (B, h w, C) over each object -> (B, N, C) float32; 0 for absent ones."""
        total = _summed(rows, self.index, self.area.shape[1])
        return total / self.area.clamp(min=1)[..., None]

    def paint(self, vectors: Tensor) -> Tensor:
        """Each object's vector (B, N, C) in all of its cells -> (B, h w, C); 0 outside objects."""
        batch, count, size = vectors.shape
        table = torch.cat([vectors, vectors.new_zeros(batch, 1, size)], 1).flatten(0, 1)
        picked = table.index_select(0, _flat(self.index, count))
        return picked.view(batch, -1, size)


def occupancy(labels: Tensor, count: int) -> Occupancy:
    """Equation (1), F_D = S(H(I_l); N): labels of a level's cells as occupancies.

    Args:
        labels: (B, h, w) int64; ``NOTHING``, and labels from ``count`` on, are no object.
        count: N.
    """
    index = labels.flatten(1)
    index = torch.where((index <= NOTHING) | (index >= count), count, index)
    ones = torch.ones(*index.shape, 1, device=labels.device)
    return Occupancy(index, _summed(ones, index, count)[..., 0], labels.shape[2])


def affinity(objects: Occupancy, rows: Tensor) -> Tensor:
    """Equation (2), F_A = F_D x H(I_l): how much of each channel an object has, (B, N, C).

    Divided by the object's area, so that it does not grow with size.
    """
    return objects.mean(rows)


class Attention(nn.Module):
    """Equation (3), O = H{(F_A x F_D) (+) H(I_l)}.

    Affinities go back to the cells of their object, beside the cells' own features, and a
    convolution makes one of both. What it finds is added to the features.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.join = nn.Linear(2 * size, size)
        self.out = small(nn.Linear(size, size))

    def forward(self, rows: Tensor, objects: Occupancy) -> Tensor:
        """Rows (B, h w, C) -> the same."""
        back = objects.paint(affinity(objects, rows)).to(rows.dtype)
        joined = self.join(torch.cat([back, rows], -1)).relu()
        added: Tensor = rows + self.out(joined)
        return added


def centres(objects: Occupancy) -> Tensor:
    """c_i, the first moments of F_D: where objects are, (B, N, 2) x y.

    In cells, the centre of the first being (0.5, 0.5); (0, 0) for objects that are not there.
    """
    cell = torch.arange(objects.index.shape[1], device=objects.index.device)
    xy = torch.stack([cell % objects.width, cell // objects.width], -1) + 0.5
    return objects.mean(xy.expand(len(objects.index), -1, -1))


class Objects(NamedTuple):
    """The set V of a picture: its objects as points.

    Attributes:
        centres: (B, N, 2) x y, pixels.
        vectors: (B, N, C) float32, the features O at the centres.
        confidence: (B, N) in 0..1, whether another picture would show the same object.
        present: (B, N) which of the N are there.
    """

    centres: Tensor
    vectors: Tensor
    confidence: Tensor
    present: Tensor


def small(layer: nn.Linear) -> nn.Linear:
    """The last layer of a block that adds to what it was given: untrained, it adds little."""
    with torch.no_grad():
        layer.weight *= _SMALL
        nn.init.zeros_(layer.bias)
    return layer


def _flat(index: Tensor, count: int) -> Tensor:
    """Objects of a batch numbered one after another, with a last one for cells of none."""
    first = torch.arange(len(index), device=index.device) * (count + 1)
    return (index + first[:, None]).flatten()


def _summed(rows: Tensor, index: Tensor, count: int) -> Tensor:
    """Sums of rows (B, h w, C) over each of ``count`` objects, (B, N, C) float32."""
    batch, _, size = rows.shape
    # Half precision cannot add up the cells of a large object.
    total = torch.zeros(batch * (count + 1), size, device=rows.device)
    total = total.index_add(0, _flat(index, count), rows.flatten(0, 1).float())
    return total.view(batch, count + 1, size)[:, :count]
