"""A graph network over the objects of a scene, which describes an object among its neighbours.

A node is an object with its centre and vector. Edges to its nearest neighbours encode their offsets
in metres. The same network describes the objects of a photograph, laid out on the ground under an
assumed heading and height, and the objects of a map, so that the two can be compared.

The names of the layers are the keys in files of weights.
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
# Number of nodes whose neighbours are computed at once, which bounds memory.
_BATCH_NODES: Final = 512
# Number of channels of an edge.
_EDGE_SIZE: Final = 12


class _Layer(nn.Module):
    """One round of messages, each the ReLU of node, neighbour and edge features.

    The parts ``own``, ``other`` and ``where`` compute these, the last from the neighbour's offset.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.own = nn.Linear(size, size)
        self.other = nn.Linear(size, size, bias=False)
        self.where = nn.Sequential(nn.Linear(_EDGE_SIZE, size), nn.ReLU(), nn.Linear(size, size))
        self.weight = nn.Linear(size, 1)
        self.join = nn.Sequential(nn.Linear(2 * size, size), nn.ReLU(), nn.Linear(size, size))

    def forward(
        self, nodes: Tensor, neighbour_rows: Tensor, edges: Tensor, exists: Tensor
    ) -> Tensor:
        neighbours = self.other(nodes)[:, neighbour_rows]
        message = (self.own(nodes)[:, :, None] + neighbours + self.where(edges)).relu()
        weight = torch.sigmoid(self.weight(message)) * exists[..., None]
        mean = (weight * message).sum(2) / weight.sum(2).clamp_min(1.0)
        result: Tensor = nodes + self.join(torch.cat([nodes, mean], -1))
        return result


class ConstellationGraph(nn.Module):
    """Graph network whose output describes each object among its neighbours by a vector.

    Attributes:
        sharpness: logarithm of the logit scale, the factor on cosines of output vectors in a
            softmax.
    """

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
        """Return an array as a tensor in single precision on the graph's device."""
        return torch.from_numpy(numbers).to(self.sharpness.device).float()

    def neighbours(self, xy: Tensor) -> tuple[Tensor, Tensor]:
        """Return rows (N, k) of the nearest neighbours of positions (N, 2), and which exist (N, k).

        Fewer than k neighbours exist if N is at most k.
        """
        count = min(self.config.neighbours, len(xy) - 1)
        shape, device = (len(xy), self.config.neighbours), xy.device
        near = torch.zeros(shape, dtype=torch.long, device=device)
        exists = torch.zeros(shape, device=device)
        if count > 0:
            # Rows are computed in parts, because all distances of a large map do not fit into
            # memory.
            for first in range(0, len(xy), _BATCH_NODES):
                last = min(first + _BATCH_NODES, len(xy))
                rows = torch.arange(first, last, device=device)
                distance = torch.cdist(xy[None, rows], xy[None])[0]
                distance[rows - first, rows] = math.inf
                near[rows, :count] = distance.topk(count, largest=False).indices
            exists[:, :count] = 1
        return near, exists

    def forward(
        self,
        vectors: Tensor,
        xy: Tensor,
        height: Tensor,
        side: Tensor,
        neighbour_rows: Tensor,
        exists: Tensor,
    ) -> Tensor:
        """Return unit vectors (H, N, out) of N objects under H hypotheses.

        Args:
            vectors: (N, V) vectors of the objects.
            xy: (H, N, 2) positions to the east and north, metres.
            height: (H, N) heights of the centres above the ground, metres.
            side: (H, N) side lengths of squares with the objects' areas, metres.
            neighbour_rows: (N, k) rows of the neighbours.
            exists: (N, k) 1 if the neighbour exists, else 0.
        """
        extent = torch.stack([side.clamp_min(0.1).log(), height.clamp(-5, 50) / 5], -1)
        per_hypothesis = vectors.expand(len(xy), -1, -1)
        nodes = self.node(torch.cat([per_hypothesis, extent], -1))
        if len(self.layers):
            edges = _edges(xy, neighbour_rows)
            for layer in self.layers:
                nodes = layer(nodes, neighbour_rows, edges, exists)
        return functional.normalize(self.out(nodes), dim=-1)


def _edges(xy: Tensor, neighbour_rows: Tensor) -> Tensor:
    """Return the encoded offsets from nodes to their neighbours, (H, N, k, _EDGE_SIZE)."""
    offset = (xy[:, neighbour_rows] - xy[:, :, None]) / _UNIT_M
    length = offset.norm(dim=-1, keepdim=True)
    bounded = offset / (1 + length)
    waves = [wave(offset * scale) for scale in (0.8, 2.5) for wave in (torch.sin, torch.cos)]
    return torch.cat([bounded, length / (1 + length), (1 / (1 + length)), *waves], -1)
