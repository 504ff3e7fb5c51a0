"""Search of a query in the mosaic: every heading and altitude, every place by Fourier transform."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.featuremetric.maps import FeatureMap
from baselines.place.mosaic import Mosaic
from baselines.views import View
from scene.geometry.pose import Pose, so3_exp

_UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


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
    """

    passes: Sequence[Tensor]
    turns: Sequence[float]
    altitudes: Sequence[float]


Look = Callable[[Pose], tuple[View, FeatureMap]]


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
                    for score, x, y in self._correlate(view, level, turned, altitude):
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
        self, view: View, level: FeatureMap, rotation: Tensor, altitude: float, most: int = 3
    ) -> Iterator[tuple[float, float, float]]:
        """Yield score, east and north of the best positions under one hypothesis."""
        laid = self._laid_out(view, level, rotation, altitude)
        if laid is None:
            return
        patch, weight, offset = laid
        rows, columns = self._mosaic.grid.shape
        size = (_fast(rows + patch.shape[1]), _fast(columns + patch.shape[2]))
        features, known = self._spectrum(size)
        spectrum = torch.fft.rfft2(torch.cat([patch * weight, weight[None]]), s=size)
        product = torch.stack(
            [(features * spectrum[:-1].conj()).sum(0), known * spectrum[-1].conj()]
        )
        correlation, overlap = torch.fft.irfft2(product, s=size)
        total = float(weight.sum())
        score = correlation / (overlap.clamp_min(1e-6) * total).sqrt()
        score[overlap < self._overlap * total] = -1.0
        for _ in range(most):
            best = int(score.argmax())
            row, column = divmod(best, size[1])
            value = float(score[row, column])
            if value <= 0:
                return
            # Shifts beyond the grid are those to the south and west.
            north = row - size[0] if row >= rows else row
            east = column - size[1] if column >= columns else column
            grid = self._mosaic.grid
            x = float(grid.origin[0]) + (east + 0.5) * grid.cell - offset[0]
            y = float(grid.origin[1]) + (north + 0.5) * grid.cell - offset[1]
            yield value, x, y
            reach = max(1, round(self._separation / grid.cell))
            rows_near = torch.arange(row - reach, row + reach + 1) % size[0]
            columns_near = torch.arange(column - reach, column + reach + 1) % size[1]
            score[rows_near[:, None], columns_near[None]] = -1.0

    def _spectrum(self, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
        if size not in self._spectra:
            mosaic = self._mosaic
            self._spectra[size] = (
                torch.fft.rfft2(mosaic.features, s=size),
                torch.fft.rfft2(mosaic.known, s=size),
            )
        return self._spectra[size]

    def _laid_out(
        self, view: View, level: FeatureMap, rotation: Tensor, altitude: float
    ) -> tuple[Tensor, Tensor, NDArray[np.float64]] | None:
        """Return the query's features (K, h, w) on the ground, their confidences (h, w), and the
        east and north (m) of its first cell from the camera; None where it shows no ground."""
        cell = self._mosaic.grid.cell
        low, high = self._footprint(view, rotation, altitude)
        if not (np.isfinite(low).all() and (high > low).all()):
            return None
        first = np.floor(low / cell) * cell + cell / 2
        columns, rows = np.maximum(np.ceil((high - first) / cell), 1).astype(int).tolist()
        x, y = np.meshgrid(
            first[0] + np.arange(columns) * cell, first[1] + np.arange(rows) * cell
        )
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
        return patch.T.reshape(-1, rows, columns), weight.reshape(rows, columns), first

    def _footprint(
        self, view: View, rotation: Tensor, altitude: float
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
