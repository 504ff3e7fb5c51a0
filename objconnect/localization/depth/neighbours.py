"""Photographs of a map that show the same as another one, from where depth can be told, and depths.

The map's own points tell best which photographs see the same. Where they are few, as along a street
whose photographs are metres apart, the poses tell it: what lies along a photograph's rays at the
depths of that place is in view of another one, or is not.
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

# Pixels along each side of a photograph, and depths of each, that are looked for in another one.
_PIXELS: Final = 8
_DEPTHS: Final = 5
# Neighbours share at least this many points of the map: few may be wrong ones.
_MIN_SHARED_POINTS: Final = 20
# Angle between rays at which neighbours are preferred (degrees): flatter ones say little of depth,
# steeper ones look different.
_BEST_ANGLE_DEG: Final = 15.0
# Photographs, of the best angles, of which it is found out how much they have in view; it bounds
# time.
_ASKED: Final = 24
# Depths are tried beyond those of the map's own points by this share.
_DEPTH_MARGIN: Final = 0.1
# What a photograph on the same side as one that was chosen is worth, of one across.
_ALONG: Final = 0.1


class NeighbourOptions(Config):
    """Which photographs each photograph is compared with, and in what range of depths."""

    neighbours: int = Field(
        4, ge=2, description="Most photographs that each photograph is compared with."
    )
    min_shared_view: float = Field(
        0.2,
        gt=0,
        description="Where fewer photographs share so many points, those are neighbours too that "
        "have at least this share of a photograph in view, at the depths of the place; above 1 for "
        "none.",
    )
    least_depths: int = Field(
        100,
        ge=1,
        description="A photograph that observes fewer map points also takes the depths of the "
        "photographs nearest to it, until there are so many.",
    )
    nearest_depth: float = Field(
        0.3,
        gt=0,
        le=1,
        description="Where they are taken from several photographs, depths are tried from this "
        "share of the median on at least: points are rare on what is near.",
    )


class Neighbours:
    """Tells of each photograph of a map which others show the same, and at what depths.

    Args:
        sparse_map: the map.
        options: which are chosen.
    """

    def __init__(self, sparse_map: SparseMap, options: NeighbourOptions) -> None:
        self._map = sparse_map
        self._options = options
        self._centres = sparse_map.centres
        self._rows = [
            np.unique(image.point_rows[image.point_rows >= 0])
            for image in (sparse_map.images[name] for name in sparse_map.names)
        ]
        self._row_of = {name: row for row, name in enumerate(sparse_map.names)}
        # Photographs that observe the points, in order of the points, and where each of these ends.
        rows = np.concatenate([np.empty(0, np.int64), *self._rows])
        photographs = np.repeat(np.arange(len(self._rows)), [len(r) for r in self._rows])
        ends = np.cumsum(np.bincount(rows, minlength=len(sparse_map.xyz)))
        self._observers = photographs[np.argsort(rows, kind="stable")], ends

    def __call__(self, name: str) -> list[str]:
        """Choose photographs of the same place whose rays cross this one's at a good angle, from
        different sides: those that share points, then those that have it in view."""
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
        """Return the nearest and the farthest depth to try in a photograph, metres.

        Both are infinite where no photograph observes a point.
        """
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
        """Return the depths of the points that a photograph observes in front of it."""
        pose = self._map.images[self._map.names[row]].pose
        z = pose.transform(torch.from_numpy(self._map.xyz[self._rows[row]]))[:, 2]
        return z[z > 0]

    def _count_shared(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many of some points each photograph observes, in the order of their names."""
        photographs, ends = self._observers
        first = np.concatenate([[0], ends])[points]
        counts = ends[points] - first
        before = np.cumsum(counts) - counts
        picked = np.repeat(first - before, counts) + np.arange(counts.sum())
        return np.bincount(photographs[picked], minlength=len(self._rows))

    def _rate_angles(self, row: int, distance: float) -> NDArray[np.float64]:
        """Return 1 for photographs (N,) whose rays cross this one's at the best angle at a
        distance, and less for others."""
        away = np.linalg.norm(self._centres - self._centres[row], axis=1)
        angle = np.arctan2(away, max(distance, 1e-9)).clip(min=1e-6)
        best = math.radians(_BEST_ANGLE_DEG)
        return np.asarray(np.exp(-(np.log(angle / best) ** 2)))

    def _in_view(
        self, row: int, but: Sequence[int]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Find photographs other than some that have what this one shows in view.

        Returns:
            Their rows (N,), and how much each is worth (N,).
        """
        options, name = self._options, self._map.names[row]
        near, far = self.depths(name)
        if not math.isfinite(far):
            return np.empty(0, np.int64), np.empty(0)
        inverse = np.linspace(1 / far, 1 / near, _DEPTHS)
        angled = self._rate_angles(row, float(1 / np.median(inverse)))
        angled[[row, *but]] = 0
        asked = np.argsort(-angled, kind="stable")[:_ASKED]
        world = self._places(name, inverse)
        share = np.array([self._share(world, self._map.names[other]) for other in asked])
        fine = (share >= options.min_shared_view) & (angled[asked] > 0)
        return asked[fine], (share * angled[asked])[fine]

    def _places(self, name: str, inverse_depths: NDArray[np.float64]) -> Tensor:
        """Return places (N, 3) along rays all over a photograph, world metres."""
        image = self._map.images[name]
        across, down = (
            (torch.arange(_PIXELS, dtype=torch.float64) + 0.5) / _PIXELS * side
            for side in (image.camera.width, image.camera.height)
        )
        xy = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1).flatten(0, 1)
        rays, usable = image.camera.unproject(xy)
        places = rays[usable] / torch.from_numpy(inverse_depths)[:, None, None]
        return image.pose.inverse().transform(places.flatten(0, 1))

    def _share(self, world: Tensor, name: str) -> float:
        """Return how many of some places a photograph has in view, as a share."""
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
        """Add the best of some photographs, one by one, to those chosen; those on sides from which
        nothing was chosen count more."""
        baselines = self._centres - self._centres[row]
        sides = baselines / np.linalg.norm(baselines, axis=1, keepdims=True).clip(min=1e-9)
        left, chosen = dict(zip(others.tolist(), worth.tolist(), strict=True)), list(chosen)
        while left and len(chosen) < self._options.neighbours:
            along = {each: np.abs(sides[chosen] @ sides[each]).max(initial=0.0) for each in left}
            best = max(left, key=lambda each: left[each] * (_ALONG + 1 - along[each]))
            chosen.append(best)
            del left[best]
        return chosen
