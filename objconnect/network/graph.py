"""Graphs over the points of an object, and over the objects of a scene.

In the object-connect paper, the points of an object are the map points that the current pose
projects into its region. Here they are the cells of the region in the feature map, so that the
features depend on the image alone, and any number of pose hypotheses share them.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from objconnect.network.objects import Occupancy, affinity, centres, init_small

# Numerical guard of a division by a mean square.
_TINY = 1e-6


class PointConvolution(nn.Module):
    """The graph convolution G over points, each of which is connected to all points of its object.

    It combines a point's own feature with the mean of its neighbours' features (Hamilton et al.,
    "Inductive Representation Learning on Large Graphs", NIPS 2017). The graph is complete within an
    object, so one mean for each object suffices.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.own = nn.Linear(size, size)
        self.others = nn.Linear(size, size, bias=False)

    def forward(self, points: Tensor, objects: Occupancy) -> Tensor:
        """Convolve points (B, h w, C); the result has the same shape and is not negative."""
        means = self.others(objects.mean(points).to(points.dtype))
        convolved: Tensor = (self.own(points) + objects.paint(means)).relu()
        return convolved


class ObjectGraph(nn.Module):
    """Equations (4) and (5): channel weights of each object, and the graph over its points."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.convolution = PointConvolution(size)
        self.out = init_small(nn.Linear(size, size))

    def forward(self, points: Tensor, objects: Occupancy) -> Tensor:
        """Return points (B, h w, C) with the output of the graph added."""
        weights = self.weights(points, objects)
        message = self.convolution(points * objects.paint(weights).to(points.dtype), objects)
        # Points without an object stay unchanged.
        inside = objects.paint(torch.ones_like(weights[..., :1])).to(points.dtype)
        result: Tensor = points + inside * self.out(message)
        return result

    def weights(self, points: Tensor, objects: Occupancy) -> Tensor:
        """Return f_c (B, N, C) float32 by equation (4), f_c = GAP(G(F_P; zeta)) * f_c.

        The initial f_c are the affinities. Both factors are scaled to a mean square of one, because
        products of features would grow without bound.
        """
        pooled = objects.mean(self.convolution(points, objects))
        return _unit(pooled) * _unit(affinity(objects, points))


class SceneGraph(nn.Module):
    """The graph over the objects. It averages similar nearby objects and keeps their differences.

    The edges are ``a_ij = softmax_j(alpha cos(f_i, f_j) - beta |c_i - c_j| / s)``, where s is the
    square root of the mean area of the objects. The vector of an object becomes H(m_i (+) (f_i -
    m_i)), where (+) is concatenation and m_i is the sum of a_ij f_j. m_i is what the object shares
    with others, and f_i - m_i is the difference. The vector is added to the object's cells.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.alpha = nn.Parameter(torch.tensor(4.0))
        self.beta = nn.Parameter(torch.tensor(1.0))
        self.join = nn.Linear(2 * size, size)
        self.out = init_small(nn.Linear(size, size))

    def forward(self, cells: Tensor, objects: Occupancy) -> Tensor:
        """Return the features of cells (B, h w, C) with the output of the graph added."""
        vectors = affinity(objects, cells)
        merged = self.edges(vectors, objects) @ vectors
        joined = self.join(torch.cat([merged, vectors - merged], -1)).relu()
        return cells + objects.paint(self.out(joined)).to(cells.dtype)

    def edges(self, vectors: Tensor, objects: Occupancy) -> Tensor:
        """Return the edges (B, N, N) float32. Rows sum to one; edges of absent objects are 0."""
        direction = functional.normalize(vectors.float(), dim=-1)
        cosine = (direction @ direction.transpose(1, 2)).float()
        xy = centres(objects)
        present = objects.present
        side = (objects.area.sum(1) / present.sum(1).clamp(min=1)).clamp(min=1).sqrt()
        distance = torch.cdist(xy, xy) / side[:, None, None]
        score = self.alpha * cosine - self.beta * distance
        both_present = present[:, :, None] & present[:, None]
        # Minus infinity would give NaN in the rows of absent objects.
        return score.masked_fill(~both_present, -1e9).softmax(-1) * both_present


def _unit(vectors: Tensor) -> Tensor:
    """Scale vectors (..., C) to a mean square of one; vectors near zero stay near zero."""
    return vectors * (vectors.square().mean(-1, keepdim=True) + _TINY).rsqrt()
