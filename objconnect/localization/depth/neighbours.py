"""Choice of neighbouring photographs for triangulation, and of the depth range.

Neighbours are photographs that share map points. Where these are few, as along a street with metres
between photographs, the poses decide: a neighbour has in view what lies along a photograph's rays
at the depths of the map's points.
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

# Pixels along each side of a photograph, and depths of each, that are projected into another one.
_PIXELS: Final = 8
_DEPTHS: Final = 5
# Least number of map points that neighbours share: a few may be wrong.
_MIN_SHARED_POINTS: Final = 20
# Best angle between the rays of neighbours (degrees): smaller ones give inexact depths, larger ones
# different views.
_BEST_ANGLE_DEG: Final = 15.0
# Photographs of the best angles whose overlap is computed, which bounds time.
_MAX_TESTED: Final = 24
# Share by which the depth range exceeds the depths of the map's points.
_DEPTH_MARGIN: Final = 0.1
# Weight of a photograph on the same side as a chosen one, relative to one at a right angle.
_SAME_SIDE_WEIGHT: Final = 0.1


class NeighbourOptions(Config):
    """Options of the neighbours of a photograph and of the depth range."""

    neighbours: int = Field(
        4, ge=2, description="Maximum number of neighbours that a photograph is compared with."
    )
    min_shared_view: float = Field(
        0.2,
        gt=0,
        description="Least share of a photograph that a neighbour has in view, if too few share "
        "enough map points; above 1 for no such neighbours.",
    )
    least_depths: int = Field(
        100,
        ge=1,
        description="Least number of depths of map points for the depth range; a photograph with "
        "fewer uses those of the photographs nearest to it, too.",
    )
    nearest_depth: float = Field(
        0.3,
        gt=0,
        le=1,
        description="Near end of the depth range as a share of the median, if several photographs "
        "give the depths: near things have few map points.",
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
        # Photographs that observe the points, sorted by point, and the end of each point's part.
        rows = np.concatenate([np.empty(0, np.int64), *self._rows])
        photographs = np.repeat(np.arange(len(self._rows)), [len(r) for r in self._rows])
        ends = np.cumsum(np.bincount(rows, minlength=len(sparse_map.xyz)))
        self._observers = photographs[np.argsort(rows, kind="stable")], ends

    def __call__(self, name: str) -> list[str]:
        """Return the neighbours of a photograph, which see its scene at good angles from different
        sides: those with shared points first, then those with it in view."""
        row = self._row_of[name]
        here = self._rows[row]
        shared = self._count_shared(here)
        shared[row] = 0
        enough = np.flatnonzero(shared >= _MIN_SHARED_POINTS)
        middle = np.median(self._map.xyz[here], axis=0) if len(here) else self._centres[row]
        distance = float(np.linalg.norm(middle - self._centres[row]))
        worth = shared * self._rate_angles(row, distance)
        chosen = self._spread(row, enough, worth[enough], [])
        if len(chosen) < self._options.neighbours:
            chosen = self._spread(row, *self._in_view(row, chosen), chosen)
        return [self._map.names[other] for other in chosen]

    def depths(self, name: str) -> tuple[float, float]:
        """Return the depth range of a photograph, metres; both are infinite without map points."""
        options, row = self._options, self._row_of[name]
        order = [row]
        if few := len(self._rows[row]) < options.least_depths:
            away = np.linalg.norm(self._centres - self._centres[row], axis=1)
            order = np.argsort(away, kind="stable").tolist()
        found, count = [], 0
        for other in order:
            found.append(self._observed_depths(other))
            count += len(found[-1])
            if count >= options.least_depths:
                break
        z = torch.cat(found)
        if not len(z):
            return math.inf, math.inf
        near, far = z.quantile(z.new_tensor([0.005, 0.995])).tolist()
        near, far = near * (1 - _DEPTH_MARGIN), far * (1 + _DEPTH_MARGIN)
        return min(near, options.nearest_depth * float(z.median())) if few else near, far

    def _observed_depths(self, row: int) -> Tensor:
        """Return the positive depths of the points that a photograph observes."""
        pose = self._map.images[self._map.names[row]].pose
        z = pose.transform(torch.from_numpy(self._map.xyz[self._rows[row]]))[:, 2]
        return z[z > 0]

    def _count_shared(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of given points that each photograph observes."""
        photographs, ends = self._observers
        first = np.concatenate([[0], ends])[points]
        counts = ends[points] - first
        before = np.cumsum(counts) - counts
        picked = np.repeat(first - before, counts) + np.arange(counts.sum())
        return np.bincount(photographs[picked], minlength=len(self._rows))

    def _rate_angles(self, row: int, distance: float) -> NDArray[np.float64]:
        """Return weights (N,) of photographs: 1 at the best angle between rays at a distance."""
        away = np.linalg.norm(self._centres - self._centres[row], axis=1)
        angle = np.arctan2(away, max(distance, 1e-9)).clip(min=1e-6)
        best = math.radians(_BEST_ANGLE_DEG)
        return np.asarray(np.exp(-(np.log(angle / best) ** 2)))

    def _in_view(
        self, row: int, but: Sequence[int]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the photographs, except some, that have this one's scene in view.

        Returns:
            Their rows (N,) and their scores (N,).
        """
        options, name = self._options, self._map.names[row]
        near, far = self.depths(name)
        if not math.isfinite(far):
            return np.empty(0, np.int64), np.empty(0)
        inverse = np.linspace(1 / far, 1 / near, _DEPTHS)
        angled = self._rate_angles(row, float(1 / np.median(inverse)))
        angled[[row, *but]] = 0
        tested = np.argsort(-angled, kind="stable")[:_MAX_TESTED]
        world = self._ray_points(name, inverse)
        share = np.array([self._share(world, self._map.names[other]) for other in tested])
        fine = (share >= options.min_shared_view) & (angled[tested] > 0)
        return tested[fine], (share * angled[tested])[fine]

    def _ray_points(self, name: str, inverse_depths: NDArray[np.float64]) -> Tensor:
        """Return points (N, 3) along a grid of rays of a photograph, world metres."""
        image = self._map.images[name]
        across, down = (
            (torch.arange(_PIXELS, dtype=torch.float64) + 0.5) / _PIXELS * side
            for side in (image.camera.width, image.camera.height)
        )
        xy = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1).flatten(0, 1)
        rays, usable = image.camera.unproject(xy)
        points = rays[usable] / torch.from_numpy(inverse_depths)[:, None, None]
        return image.pose.inverse().transform(points.flatten(0, 1))

    def _share(self, world: Tensor, name: str) -> float:
        """Return the share of points that a photograph has in view."""
        image = self._map.images[name]
        projected = image.camera.project(image.pose.transform(world))
        seen = projected.valid & image.camera.contains(projected.xy)
        return float(seen.double().mean())

    def _spread(
        self,
        row: int,
        others: NDArray[np.int64],
        worth: NDArray[np.float64],
        chosen: Sequence[int],
    ) -> list[int]:
        """Add the best photographs, one by one, to those chosen; new sides count more."""
        baselines = self._centres - self._centres[row]
        sides = baselines / np.linalg.norm(baselines, axis=1, keepdims=True).clip(min=1e-9)
        left, chosen = dict(zip(others.tolist(), worth.tolist(), strict=True)), list(chosen)
        while left and len(chosen) < self._options.neighbours:
            along = {each: np.abs(sides[chosen] @ sides[each]).max(initial=0.0) for each in left}
            best = max(left, key=lambda each: left[each] * (_SAME_SIDE_WEIGHT + 1 - along[each]))
            chosen.append(best)
            del left[best]
        return chosen
