"""A graph network over the objects of a scene, which describes an object among its neighbours.

Nodes are centres with vectors. Edges to the nearest neighbours encode their metric offsets. The
same graph describes the objects of a photograph, laid out on the ground under an assumed heading
and height, and those of a map, so that the two can be compared.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from objconnect.network.config import ConstellationConfig

# Unit of the offsets between neighbours, metres.
_UNIT_M: Final = 10.0
# Number of nodes whose neighbours are computed at once.
_AT_ONCE: Final = 512
# Number of channels of an edge.
_EDGE: Final = 12


class _Layer(nn.Module):
    """One round of messages, each the ReLU of node, neighbour and edge features."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.own = nn.Linear(size, size)
        self.other = nn.Linear(size, size, bias=False)
        self.where = nn.Sequential(nn.Linear(_EDGE, size), nn.ReLU(), nn.Linear(size, size))
        self.weight = nn.Linear(size, 1)
        self.join = nn.Sequential(nn.Linear(2 * size, size), nn.ReLU(), nn.Linear(size, size))

    def forward(self, nodes: Tensor, near: Tensor, edges: Tensor, there: Tensor) -> Tensor:
        around = self.other(nodes)[:, near]
        message = (self.own(nodes)[:, :, None] + around + self.where(edges)).relu()
        heard = torch.sigmoid(self.weight(message)) * there[..., None]
        total = (heard * message).sum(2) / heard.sum(2).clamp_min(1.0)
        result: Tensor = nodes + self.join(torch.cat([nodes, total], -1))
        return result


class ConstellationGraph(nn.Module):
    """Vectors of objects among their neighbours."""

    def __init__(self, config: ConstellationConfig) -> None:
        super().__init__()
        self.config = config
        self.node = nn.Sequential(
            nn.Linear(config.vector + 2, config.size),
            nn.ReLU(),
            nn.Linear(config.size, config.size),
        )
        self.layers = nn.ModuleList(_Layer(config.size) for _ in range(config.layers))
        self.out = nn.Linear(config.size, config.out)
        self.sharpness = nn.Parameter(torch.tensor(math.log(10.0)))

    def to_tensor(self, numbers: NDArray[np.float32] | NDArray[np.float64]) -> Tensor:
        """Return numbers as a tensor in single precision on the graph's device."""
        return torch.from_numpy(numbers).to(self.sharpness.device).float()

    def neighbours(self, where: Tensor) -> tuple[Tensor, Tensor]:
        """Return rows (N, k) of the nearest neighbours of positions (N, 2), and which exist."""
        count = min(self.config.neighbours, len(where) - 1)
        shape, device = (len(where), self.config.neighbours), where.device
        near = torch.zeros(shape, dtype=torch.long, device=device)
        there = torch.zeros(shape, device=device)
        if count > 0:
            # In parts, because all distances of a large map do not fit into memory.
            for first in range(0, len(where), _AT_ONCE):
                last = min(first + _AT_ONCE, len(where))
                rows = torch.arange(first, last, device=device)
                away = torch.cdist(where[None, rows], where[None])[0]
                away[rows - first, rows] = math.inf
                near[rows, :count] = away.topk(count, largest=False).indices
            there[:, :count] = 1
        return near, there

    def forward(
        self,
        vectors: Tensor,
        where: Tensor,
        rise: Tensor,
        side: Tensor,
        near: Tensor,
        there: Tensor,
    ) -> Tensor:
        """Return unit vectors (H, N, out) of N objects under H hypotheses.

        Args:
            vectors: (N, V) vectors of the objects.
            where: (H, N, 2) positions to the east and north, metres.
            rise: (H, N) height of the centres above the ground, metres.
            side: (H, N) sides of the objects, metres.
            near: (N, k) rows of the neighbours.
            there: (N, k) 1 if the neighbour exists, else 0.
        """
        extent = torch.stack([side.clamp_min(0.1).log(), rise.clamp(-5, 50) / 5], -1)
        own = vectors.expand(len(where), -1, -1)
        nodes = self.node(torch.cat([own, extent], -1))
        if len(self.layers):
            edges = _edges(where, near)
            for layer in self.layers:
                nodes = layer(nodes, near, edges, there)
        return functional.normalize(self.out(nodes), dim=-1)


def _edges(where: Tensor, near: Tensor) -> Tensor:
    """Return the encoded offsets of neighbours, (H, N, k, _EDGE)."""
    offset = (where[:, near] - where[:, :, None]) / _UNIT_M
    length = offset.norm(dim=-1, keepdim=True)
    bounded = offset / (1 + length)
    waves = [wave(offset * scale) for scale in (0.8, 2.5) for wave in (torch.sin, torch.cos)]
    return torch.cat([bounded, length / (1 + length), (1 / (1 + length)), *waves], -1)
