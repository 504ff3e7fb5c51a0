"""Graphs over the points of an object, and over the objects of a scene.

The points of an object are taken to be the cells of its region, not the cloud's points that the
current pose throws into it: features then follow from the picture alone, so that they can be kept,
and shared by any number of hypotheses about the pose.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from objconnect.objects import Occupancy, affinity, centres, small

_TINY = 1e-6


class PointConvolution(nn.Module):
    """G: a graph convolution over points that are joined to all points of their object.

    Of a point's own feature and of the mean of those it is joined to (Hamilton et al., "Inductive
    Representation Learning on Large Graphs", NIPS 2017), which is dense within an object at the
    cost of one mean.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.own = nn.Linear(size, size)
        self.others = nn.Linear(size, size, bias=False)

    def forward(self, points: Tensor, objects: Occupancy) -> Tensor:
        """Points (B, h w, C) -> the same, not negative."""
        around = self.others(objects.mean(points).to(points.dtype))
        joined: Tensor = (self.own(points) + objects.paint(around)).relu()
        return joined


class ObjectGraph(nn.Module):
    """Equations (4) and (5): which channels matter to an object, and points that hear of it."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.convolution = PointConvolution(size)
        self.out = small(nn.Linear(size, size))

    def forward(self, points: Tensor, objects: Occupancy) -> Tensor:
        """Points (B, h w, C) -> the same, with what the graph found added."""
        channels = self.weights(points, objects)
        message = self.convolution(points * objects.paint(channels).to(points.dtype), objects)
        # Cells of no object have nobody to hear from.
        inside = objects.paint(torch.ones_like(channels[..., :1])).to(points.dtype)
        added: Tensor = points + inside * self.out(message)
        return added

    def weights(self, points: Tensor, objects: Occupancy) -> Tensor:
        """Equation (4), f_c = GAP(G(F_P; zeta)) * f_c, from the affinities on: (B, N, C) float32.

        Both factors are brought to a mean square of one: products of features would grow without
        bound.
        """
        pooled = objects.mean(self.convolution(points, objects))
        return _unit(pooled) * _unit(affinity(objects, points))


class SceneGraph(nn.Module):
    """The graph over the objects: those alike and near are merged softly, what differs is kept.

    Edges are ``a_ij = softmax_j(alpha cos(f_i, f_j) - beta |c_i - c_j| / s)`` with s the side of
    a mean object. An object's vector becomes H(m_i (+) (f_i - m_i)), with m_i the sum of a_ij f_j:
    what it shares with others, and what tells it from them. It goes back into the object's cells.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.alpha = nn.Parameter(torch.tensor(4.0))
        self.beta = nn.Parameter(torch.tensor(1.0))
        self.join = nn.Linear(2 * size, size)
        self.out = small(nn.Linear(size, size))

    def forward(self, rows: Tensor, objects: Occupancy) -> Tensor:
        """Rows (B, h w, C) -> the same, with what the graph found added."""
        vectors = affinity(objects, rows)
        merged = self.edges(vectors, objects) @ vectors
        joined = self.join(torch.cat([merged, vectors - merged], -1)).relu()
        return rows + objects.paint(self.out(joined)).to(rows.dtype)

    def edges(self, vectors: Tensor, objects: Occupancy) -> Tensor:
        """(B, N, N) float32, rows of sum one; 0 to and from objects that are not there."""
        direction = functional.normalize(vectors.float(), dim=-1)
        alike = (direction @ direction.transpose(1, 2)).float()
        place = centres(objects)
        present = objects.present
        side = (objects.area.sum(1) / present.sum(1).clamp(min=1)).clamp(min=1).sqrt()
        apart = torch.cdist(place, place) / side[:, None, None]
        score = self.alpha * alike - self.beta * apart
        both = present[:, :, None] & present[:, None]
        # A finite value: rows without any object must not become NaN.
        return score.masked_fill(~both, -1e9).softmax(-1) * both


def _unit(vectors: Tensor) -> Tensor:
    """Vectors (..., C) of mean square one, or near zero where they are."""
    return vectors * (vectors.square().mean(-1, keepdim=True) + _TINY).rsqrt()
