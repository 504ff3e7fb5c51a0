"""Search of a query in the mosaic: every heading and altitude, every place by Fourier transform."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.featuremetric.maps import FeatureMap
from baselines.place.mosaic import Mosaic
from baselines.views import WarpedImage
from scene.geometry.pose import Pose, so3_exp

_UP: Final = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
# Places kept of each hypothesis.
_PEAKS: Final = 3
# Numerical guard: a query of less confidence, summed over cells, shows nothing.
_LEAST_WEIGHT: Final = 1e-3


@dataclass(frozen=True)
class Candidate:
    """A pose at which a query may be.

    Attributes:
        pose: ``cam_from_world``.
        score: of the correlation with the mosaic, 1 at most.
    """

    pose: Pose
    score: float


@dataclass(frozen=True)
class Hypotheses:
    """Headings and altitudes to try.

    Attributes:
        passes: rotations ``cam_from_world`` (3, 3) at which the network looks at the query.
        turns: radians about the vertical, tried with each pass.
        altitudes: heights above ground, metres, tried with each pass.
        within: east and north of a place and metres around it to look in; None for everywhere.
    """

    passes: Sequence[Tensor]
    turns: Sequence[float]
    altitudes: Sequence[float]
    within: tuple[float, float, float] | None = None


class _LaidOut(NamedTuple):
    """A query on the ground.

    Attributes:
        features: (K, h, w) of cells, of unit length or 0.
        confidence: (h, w).
        first: (2,) metres from the camera to the south-western cell, to the east and north.
    """

    features: Tensor
    confidence: Tensor
    first: NDArray[np.float64]


Look = Callable[[Pose], tuple[WarpedImage, FeatureMap]]


class PlaceSearch:
    """Finds the places of a mosaic that look most like a query.

    Args:
        mosaic: of the map.
        least_overlap: share of the query, by confidence, that must lie on known ground.
        farthest: cells farther away than so many heights above ground are left out.
        separation: metres between candidates.
    """

    def __init__(
        self,
        mosaic: Mosaic,
        least_overlap: float = 0.3,
        farthest: float = 3.0,
        separation: float = 12.0,
    ) -> None:
        self._mosaic = mosaic
        self._overlap = least_overlap
        self._farthest = farthest
        self._separation = separation
        self._spectra: dict[tuple[int, int], tuple[Tensor, Tensor]] = {}

    @torch.inference_mode()
    def __call__(self, look: Look, hypotheses: Hypotheses, count: int) -> list[Candidate]:
        """Return the best candidates, best first, at most ``count``.

        Args:
            look: the query as seen from a pose (the position but for its height is of no meaning):
                its view turned north up, with the features of the coarsest level.
            hypotheses: to try.
            count: of the candidates.
        """
        peaks: list[tuple[float, float, float, float, Tensor]] = []
        middle = float(hypotheses.altitudes[len(hypotheses.altitudes) // 2])
        for rotation in hypotheses.passes:
            centre = torch.tensor([0.0, 0.0, middle], dtype=torch.float64)
            view, level = look(Pose(rotation, -rotation @ centre))
            for turn in hypotheses.turns:
                turned = rotation @ so3_exp(turn * _UP)
                for altitude in hypotheses.altitudes:
                    laid = self._laid_out(view, level, turned, altitude)
                    if laid is None:
                        continue
                    for score, x, y in self._correlate(laid, hypotheses.within):
                        peaks.append((score, x, y, altitude, turned))
        peaks.sort(key=lambda peak: -peak[0])
        return self._distinct(peaks, count)

    def _distinct(
        self, peaks: Sequence[tuple[float, float, float, float, Tensor]], count: int
    ) -> list[Candidate]:
        kept: list[Candidate] = []
        places: list[tuple[float, float]] = []
        for score, x, y, altitude, rotation in peaks:
            if all(math.hypot(x - a, y - b) > self._separation for a, b in places):
                places.append((x, y))
                z = self._mosaic.grid.height_at(x, y) + altitude
                centre = torch.tensor([x, y, z], dtype=torch.float64)
                kept.append(Candidate(Pose(rotation, -rotation @ centre), score))
                if len(kept) == count:
                    break
        return kept

    def _correlate(
        self, laid: _LaidOut, within: tuple[float, float, float] | None
    ) -> Iterator[tuple[float, float, float]]:
        """Yield score, east and north of the best positions under one hypothesis."""
        grid, weight = self._mosaic.grid, laid.confidence
        rows, columns = grid.shape
        size = (_fast(rows + weight.shape[0]), _fast(columns + weight.shape[1]))
        features, known = self._spectrum(size)
        layers = torch.cat([laid.features * weight, weight[None]])
        spectrum = torch.fft.rfft2(layers, s=size).conj()
        product = torch.stack([(features * spectrum[:-1]).sum(0), known * spectrum[-1]])
        correlation, overlap = torch.fft.irfft2(product, s=size)
        total = float(weight.sum())
        score = correlation / (overlap.clamp_min(1e-6) * total).sqrt()
        score[overlap < self._overlap * total] = -1.0
        # Shifts beyond the grid are those to the south and west.
        north = torch.arange(size[0])
        east = torch.arange(size[1])
        y = grid.origin[1] + (north - size[0] * (north >= rows) + 0.5) * grid.cell - laid.first[1]
        x = grid.origin[0] + (east - size[1] * (east >= columns) + 0.5) * grid.cell - laid.first[0]
        if within is not None:
            away = torch.hypot(x[None] - within[0], y[:, None] - within[1])
            score[away > within[2]] = -1.0
        near = max(1, round(self._separation / grid.cell))
        for _ in range(_PEAKS):
            row, column = divmod(int(score.argmax()), size[1])
            value = float(score[row, column])
            if value <= 0:
                return
            yield value, float(x[column]), float(y[row])
            around = torch.arange(-near, near + 1)
            score[(row + around)[:, None] % size[0], (column + around)[None] % size[1]] = -1.0

    def _spectrum(self, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
        if size not in self._spectra:
            mosaic = self._mosaic
            self._spectra[size] = (
                torch.fft.rfft2(mosaic.features, s=size),
                torch.fft.rfft2(mosaic.known, s=size),
            )
        return self._spectra[size]

    def _laid_out(
        self, view: WarpedImage, level: FeatureMap, rotation: Tensor, altitude: float
    ) -> _LaidOut | None:
        """Lay the query's features out on level ground; None where it shows none."""
        cell = self._mosaic.grid.cell
        low, high = self._footprint(view, rotation, altitude)
        if not (np.isfinite(low).all() and (high > low).all()):
            return None
        first = np.floor(low / cell) * cell + cell / 2
        columns, rows = np.maximum(np.ceil((high - first) / cell), 1).astype(int).tolist()
        x, y = np.meshgrid(first[0] + np.arange(columns) * cell, first[1] + np.arange(rows) * cell)
        ground = np.stack([x, y, np.full_like(x, -altitude)], -1).reshape(-1, 3)
        from_world = view.pose(Pose(rotation, torch.zeros(3, dtype=torch.float64)))
        projected = view.camera.project(from_world.transform(torch.from_numpy(ground)))
        xy = projected.xy.numpy()
        inside = (projected.valid & view.camera.contains(projected.xy)).numpy() & view.shows(xy)
        near = np.hypot(ground[:, 0], ground[:, 1]) <= self._farthest * altitude
        seen = np.flatnonzero(inside & near)
        if not len(seen):
            return None
        features, confidence = level.sample(torch.from_numpy(xy[seen]).float())
        patch = torch.zeros(rows * columns, self._mosaic.components.shape[1])
        weight = torch.zeros(rows * columns)
        patch[seen] = self._mosaic.reduced(features)
        weight[seen] = confidence
        if not float(confidence.sum()) > _LEAST_WEIGHT:
            return None
        return _LaidOut(patch.T.reshape(-1, rows, columns), weight.reshape(rows, columns), first)

    def _footprint(
        self, view: WarpedImage, rotation: Tensor, altitude: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the south-west and north-east corners (m, from the camera) of the ground that a
        view shows, no farther away than is looked."""
        camera = view.camera
        steps = np.linspace(0.0, 1.0, 9)
        u, v = np.meshgrid(steps * camera.width, steps * camera.height)
        edge = torch.from_numpy(np.stack([u, v], -1).reshape(-1, 2))
        rays, valid = camera.unproject(edge)
        turn = view.pose(Pose(rotation, torch.zeros(3, dtype=torch.float64))).rotation
        directions = (rays.double() @ turn).numpy()[valid.numpy()]
        reach = self._farthest * altitude
        flat = np.hypot(directions[:, 0], directions[:, 1])
        down = -directions[:, 2]
        length = np.where(down > 1e-6, altitude * flat / np.maximum(down, 1e-6), np.inf)
        length = np.minimum(length, reach)
        ground = directions[:, :2] / np.maximum(flat, 1e-9)[:, None] * length[:, None]
        if not len(ground):
            return np.full(2, np.nan), np.full(2, np.nan)
        return ground.min(0), ground.max(0)


def _fast(size: int) -> int:
    """Return the least size from ``size`` on whose only factors are 2, 3 and 5."""
    while True:
        left = size
        for factor in (2, 3, 5):
            while left % factor == 0:
                left //= factor
        if left == 1:
            return size
        size += 1
