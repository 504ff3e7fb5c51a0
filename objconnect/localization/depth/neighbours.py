"""Choice of neighbouring photographs for triangulation, and of the depth range.

Neighbours are photographs that share map points. If too few photographs do, as along a street with
metres between photographs, the poses decide: a neighbour then has in view a large share of the
3D points that lie on the photograph's rays at the depths of the map's points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from objconnect.scene.config import Config
from objconnect.scene.maps.sparse_map import SparseMap

# Number of pixels along each side of a photograph, and of depths of each pixel, whose points are
# projected into another photograph.
_PIXELS: Final = 8
_DEPTHS: Final = 5
# Least number of map points that neighbours share, because a few shared points may be wrong.
_MIN_SHARED_POINTS: Final = 20
# Best angle between the rays of two photographs to a point (degrees). A smaller angle gives inexact
# depths, a larger one different views.
_BEST_ANGLE_DEG: Final = 15.0
# Number of photographs of the best angles whose overlap is computed, which bounds time.
_MAX_TESTED: Final = 24
# The depth range exceeds the depths of the map's points by this share at either end.
_DEPTH_MARGIN: Final = 0.1
# Weight of a photograph whose baseline is parallel to the baseline of a chosen neighbour. A
# baseline at a right angle has a weight that is larger by 1.
_SAME_SIDE_WEIGHT: Final = 0.1


class NeighbourOptions(Config):
    """Options of the neighbours of a photograph and of the depth range."""

    neighbours: int = Field(
        4, ge=2, description="Maximum number of neighbours with which a photograph is compared."
    )
    min_shared_view: float = Field(
        0.2,
        gt=0,
        description="Least share of a photograph's scene that a neighbour has in view, if too few "
        "photographs share enough map points. A value above 1 excludes such neighbours.",
    )
    least_depths: int = Field(
        100,
        ge=1,
        description="Least number of depths of map points for the depth range; a photograph with "
        "fewer also uses the depths of the photographs nearest to it.",
    )
    nearest_depth: float = Field(
        0.3,
        gt=0,
        le=1,
        description="Upper bound of the near end of the depth range, as a share of the median "
        "depth. It applies if several photographs give the depths, because near things have few "
        "map points.",
    )


class Neighbours:
    """Chooses the neighbours and the depth range of each photograph of a map."""

    def __init__(self, sparse_map: SparseMap, options: NeighbourOptions) -> None:
        self._map = sparse_map
        self._options = options
        self._centres = sparse_map.centres
        self._rows = [
            np.unique(image.point_rows[image.point_rows >= 0])
            for image in (sparse_map.images[name] for name in sparse_map.names)
        ]
        self._row_of = {name: row for row, name in enumerate(sparse_map.names)}
        # The observers of all points, sorted by point, and the end of each point's part of them.
        rows = np.concatenate([np.empty(0, np.int64), *self._rows])
        photographs = np.repeat(np.arange(len(self._rows)), [len(r) for r in self._rows])
        ends = np.cumsum(np.bincount(rows, minlength=len(sparse_map.xyz)))
        self._observers = photographs[np.argsort(rows, kind="stable")], ends

    def __call__(self, name: str) -> list[str]:
        """Return the neighbours of a photograph.

        They see the photograph's scene at good angles and from different sides. Photographs with
        shared points come first, then those that only have the scene in view.
        """
        row = self._row_of[name]
        points = self._rows[row]
        shared = self._count_shared(points)
        shared[row] = 0
        candidates = np.flatnonzero(shared >= _MIN_SHARED_POINTS)
        middle = np.median(self._map.xyz[points], axis=0) if len(points) else self._centres[row]
        distance = float(np.linalg.norm(middle - self._centres[row]))
        scores = shared * self._rate_angles(row, distance)
        chosen = self._add_diverse(row, candidates, scores[candidates], [])
        if len(chosen) < self._options.neighbours:
            chosen = self._add_diverse(row, *self._find_in_view(row, chosen), chosen)
        return [self._map.names[other] for other in chosen]

    def depths(self, name: str) -> tuple[float, float]:
        """Return the depth range of a photograph, metres; both are infinite without map points."""
        options, row = self._options, self._row_of[name]
        order = [row]
        if few := len(self._rows[row]) < options.least_depths:
            distance = np.linalg.norm(self._centres - self._centres[row], axis=1)
            order = np.argsort(distance, kind="stable").tolist()
        found, count = [], 0
        for other in order:
            found.append(self._list_depths(other))
            count += len(found[-1])
            if count >= options.least_depths:
                break
        z = torch.cat(found)
        if not len(z):
            return math.inf, math.inf
        near, far = z.quantile(z.new_tensor([0.005, 0.995])).tolist()
        near, far = near * (1 - _DEPTH_MARGIN), far * (1 + _DEPTH_MARGIN)
        return min(near, options.nearest_depth * float(z.median())) if few else near, far

    def _list_depths(self, row: int) -> Tensor:
        """Return the positive depths (m) of the points that a photograph observes."""
        pose = self._map.images[self._map.names[row]].pose
        z = pose.transform(torch.from_numpy(self._map.xyz[self._rows[row]]))[:, 2]
        return z[z > 0]

    def _count_shared(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many of the points with these rows each photograph observes."""
        photographs, ends = self._observers
        first = np.concatenate([[0], ends])[points]
        counts = ends[points] - first
        before = np.cumsum(counts) - counts
        picked = np.repeat(first - before, counts) + np.arange(counts.sum())
        return np.bincount(photographs[picked], minlength=len(self._rows))

    def _rate_angles(self, row: int, distance: float) -> NDArray[np.float64]:
        """Return weights (N,) of all photographs by the angle between their rays and this one's.

        The weight is 1 at the best angle. The rays meet at ``distance``, metres.
        """
        baseline = np.linalg.norm(self._centres - self._centres[row], axis=1)
        angle = np.arctan2(baseline, max(distance, 1e-9)).clip(min=1e-6)
        best = math.radians(_BEST_ANGLE_DEG)
        return np.asarray(np.exp(-(np.log(angle / best) ** 2)))

    def _find_in_view(
        self, row: int, excluded: Sequence[int]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the photographs, except ``excluded``, that have a photograph's scene in view.

        Returns:
            Their rows (N,) and their scores (N,).
        """
        options, name = self._options, self._map.names[row]
        near, far = self.depths(name)
        if not math.isfinite(far):
            return np.empty(0, np.int64), np.empty(0)
        inverse = np.linspace(1 / far, 1 / near, _DEPTHS)
        weight = self._rate_angles(row, float(1 / np.median(inverse)))
        weight[[row, *excluded]] = 0
        tested = np.argsort(-weight, kind="stable")[:_MAX_TESTED]
        points = self._ray_points(name, inverse)
        share = np.array([self._share_in_view(points, self._map.names[other]) for other in tested])
        overlaps = (share >= options.min_shared_view) & (weight[tested] > 0)
        return tested[overlaps], (share * weight[tested])[overlaps]

    def _ray_points(self, name: str, inverse_depths: NDArray[np.float64]) -> Tensor:
        """Return points (N, 3) on a grid of rays of a photograph at depths, world metres."""
        image = self._map.images[name]
        across, down = (
            (torch.arange(_PIXELS, dtype=torch.float64) + 0.5) / _PIXELS * side
            for side in (image.camera.width, image.camera.height)
        )
        xy = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1).flatten(0, 1)
        rays, usable = image.camera.unproject(xy)
        points = rays[usable] / torch.from_numpy(inverse_depths)[:, None, None]
        return image.pose.inverse().transform(points.flatten(0, 1))

    def _share_in_view(self, points: Tensor, name: str) -> float:
        """Return the share of points (N, 3), world metres, that a photograph has in view."""
        image = self._map.images[name]
        projected = image.camera.project(image.pose.transform(points))
        seen = projected.valid & image.camera.contains(projected.xy)
        return float(seen.double().mean())

    def _add_diverse(
        self,
        row: int,
        others: NDArray[np.int64],
        scores: NDArray[np.float64],
        chosen: Sequence[int],
    ) -> list[int]:
        """Return the chosen neighbours of a photograph and the best of others, added one by one.

        A photograph has more weight if its baseline is at a large angle to the baselines of chosen
        neighbours.

        Args:
            row: row of the photograph.
            others: (N,) rows of the photographs to add.
            scores: (N,) their scores.
            chosen: rows of the photographs that are neighbours already.
        """
        baselines = self._centres - self._centres[row]
        directions = baselines / np.linalg.norm(baselines, axis=1, keepdims=True).clip(min=1e-9)
        rest, chosen = dict(zip(others.tolist(), scores.tolist(), strict=True)), list(chosen)
        while rest and len(chosen) < self._options.neighbours:
            cosine = {
                each: np.abs(directions[chosen] @ directions[each]).max(initial=0.0)
                for each in rest
            }
            best = max(rest, key=lambda each: rest[each] * (_SAME_SIDE_WEIGHT + 1 - cosine[each]))
            chosen.append(best)
            del rest[best]
        return chosen
