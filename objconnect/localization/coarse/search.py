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

from objconnect.localization.coarse.mosaic import Mosaic
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import WarpedImage
from objconnect.scene.localizer import By
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.storage.lru_cache import MEGABYTE, LruCache

UP: Final = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
# Places kept of each look and altitude.
_PEAKS: Final = 3
# Cells by which the side of a query on the ground grows.
_PATCH: Final = 16
# Share of a query, by confidence, that must lie on known ground.
_LEAST_OVERLAP: Final = 0.3
# Ground farther away than so many heights above it is left out: it is seen in few pixels.
_FARTHEST: Final = 2.0
# Memory for transforms of the mosaic, one for each size of a query on the ground.
_SPECTRA_MB: Final = 128
# Numerical guard: a query of less confidence, summed over cells, shows nothing.
_LEAST_WEIGHT: Final = 1e-3


@dataclass(frozen=True)
class Candidate:
    """A pose at which a query may be.

    Attributes:
        pose: ``cam_from_world``.
        score: of the correlation with the mosaic, 1 at most.
        by: what gave it.
    """

    pose: Pose
    score: float
    by: By = By.PLACE


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
    """A query on the ground, under several turns.

    Attributes:
        features: (T, K, h, w) of cells, of unit length or 0.
        confidence: (T, h, w).
        first: (2,) metres from the camera to the south-western cell, to the east and north.
    """

    features: Tensor
    confidence: Tensor
    first: NDArray[np.float64]


Look = Callable[[Pose], tuple[WarpedImage, FeatureMap]]


class _Peak(NamedTuple):
    """A place under one hypothesis.

    Attributes:
        score: of the correlation.
        x: world metres, east.
        y: world metres, north.
        altitude: height above ground, metres.
        rotation: (3, 3) ``cam_from_world``.
    """

    score: float
    x: float
    y: float
    altitude: float
    rotation: Tensor


class MosaicSearch:
    """Finds the places of a mosaic that look most like a query.

    Args:
        mosaic: of the map.
        separation: metres between candidates.
    """

    def __init__(self, mosaic: Mosaic, separation: float = 12.0) -> None:
        self._mosaic = mosaic
        self._separation = separation
        self._spectra = LruCache(self._spectrum, _SPECTRA_MB * MEGABYTE)

    @torch.inference_mode()
    def __call__(self, look: Look, hypotheses: Hypotheses, count: int) -> list[Candidate]:
        """Return the best candidates, best first, at most ``count``.

        Args:
            look: the query as seen from a pose (the position but for its height is of no meaning):
                its view turned north up, with the features of the coarsest level.
            hypotheses: to try.
            count: of the candidates.
        """
        peaks: list[_Peak] = []
        with progress_within("coarse search", len(hypotheses.passes)) as advance:
            for done, rotation in enumerate(hypotheses.passes, 1):
                peaks += self._peaks(look, rotation, hypotheses)
                advance(done)
        return [self._candidate(peak) for peak in self._distinct(peaks, count)]

    def _peaks(self, look: Look, rotation: Tensor, hypotheses: Hypotheses) -> Iterator[_Peak]:
        """Yield places at which the query may be, seen at one heading of the network."""
        middle = float(hypotheses.altitudes[len(hypotheses.altitudes) // 2])
        turns = torch.tensor(hypotheses.turns, dtype=torch.float64)
        centre = torch.tensor([0.0, 0.0, middle], dtype=torch.float64)
        view, level = look(Pose(rotation, -rotation @ centre))
        reduced = FeatureMap(
            self._mosaic.reduce_channels(level.features), level.confidence, level.stride
        )
        turned = rotation @ so3_exp(turns[:, None] * UP)
        footprint = self._footprint(view, turned)
        for altitude in hypotheses.altitudes:
            laid = self._lay_out(view, reduced, turned, footprint, altitude)
            if laid is not None:
                for score, x, y, turn in self._correlate(laid, hypotheses.within):
                    yield _Peak(score, x, y, altitude, turned[turn])

    def _distinct(self, peaks: Sequence[_Peak], count: int) -> list[_Peak]:
        """Return the best of peaks that are apart, best first."""
        kept: list[_Peak] = []
        for peak in sorted(peaks, key=lambda peak: -peak.score):
            if all(math.hypot(peak.x - a.x, peak.y - a.y) > self._separation for a in kept):
                kept.append(peak)
                if len(kept) == count:
                    break
        return kept

    def _candidate(self, peak: _Peak) -> Candidate:
        z = self._mosaic.grid.height_at(peak.x, peak.y) + peak.altitude
        centre = torch.tensor([peak.x, peak.y, z], dtype=torch.float64)
        return Candidate(Pose(peak.rotation, -peak.rotation @ centre), peak.score)

    def _correlate(
        self, laid: _LaidOut, within: tuple[float, float, float] | None
    ) -> Iterator[tuple[float, float, float, int]]:
        """Yield score, east, north and turn of the best positions at one altitude."""
        grid, weight = self._mosaic.grid, laid.confidence
        rows, columns = grid.shape
        size = (_fast(rows + weight.shape[1]), _fast(columns + weight.shape[2]))
        spectra = self._spectra(size)
        layers = torch.cat([laid.features * weight[:, None], weight[:, None]], 1)
        spectrum = torch.fft.rfft2(layers, s=size).conj()
        products = [
            torch.einsum("khw,tkhw->thw", spectra[:-1], spectrum[:, :-1]),
            spectra[-1] * spectrum[:, -1],
        ]
        product = torch.stack(products)
        correlation, overlap = torch.fft.irfft2(product, s=size)
        total = weight.sum((1, 2)).clamp_min(_LEAST_WEIGHT)[:, None, None]
        scores = correlation / (overlap.clamp_min(1e-6) * total).sqrt()
        scores[overlap < _LEAST_OVERLAP * total] = -1.0
        score, turn = scores.max(0)
        # Shifts beyond the grid are those to the south and west.
        north = torch.arange(size[0], device=score.device)
        east = torch.arange(size[1], device=score.device)
        y = grid.origin[1] + (north - size[0] * (north >= rows) + 0.5) * grid.cell - laid.first[1]
        x = grid.origin[0] + (east - size[1] * (east >= columns) + 0.5) * grid.cell - laid.first[0]
        if within is not None:
            away = torch.hypot(x[None] - within[0], y[:, None] - within[1])
            score[away > within[2]] = -1.0
        near = max(1, round(self._separation / grid.cell))
        around = torch.arange(-near, near + 1, device=score.device)
        for _ in range(_PEAKS):
            row, column = divmod(int(score.argmax()), size[1])
            value = float(score[row, column])
            if value <= 0:
                return
            yield value, float(x[column]), float(y[row]), int(turn[row, column])
            score[(row + around)[:, None] % size[0], (column + around)[None] % size[1]] = -1.0

    def _spectrum(self, size: tuple[int, int]) -> Tensor:
        """Return the transforms of the mosaic's channels and, last, of what is known."""
        layers = torch.cat([self._mosaic.features, self._mosaic.known[None]])
        spectrum: Tensor = torch.fft.rfft2(layers, s=size)
        return spectrum

    def _lay_out(
        self,
        view: WarpedImage,
        level: FeatureMap,
        rotations: Tensor,
        footprint: NDArray[np.float64],
        altitude: float,
    ) -> _LaidOut | None:
        """Lay the query's features out on level ground; None where it shows none.

        A cell counts as many cells of the feature map as it covers, one at most: what is far away
        is seen in few pixels, however much ground it is.

        Args:
            view: of the query.
            level: its features, reduced.
            rotations: (T, 3, 3) ``cam_from_world`` of the photograph.
            footprint: (2, 2) of ``_footprint``.
            altitude: metres above the ground.
        """
        cell = self._mosaic.grid.cell
        low, high = footprint * altitude
        if not (np.isfinite(low).all() and (high > low).all()):
            return None
        first = np.floor(low / cell) * cell + cell / 2
        columns, rows = np.maximum(np.ceil((high - first) / cell), 1).astype(int).tolist()
        x, y = np.meshgrid(first[0] + np.arange(columns) * cell, first[1] + np.arange(rows) * cell)
        # To the next multiple, so that few sizes of the transform occur.
        rows, columns = (_PATCH * math.ceil(side / _PATCH) for side in (rows, columns))
        near = np.hypot(x, y) <= _FARTHEST * altitude
        ground = torch.from_numpy(np.stack([x[near], y[near], np.full(near.sum(), -altitude)], -1))
        place = torch.from_numpy(np.flatnonzero(np.pad(near, _padding(near, rows, columns))))
        turn = torch.from_numpy(view.view_from_camera)
        seen = ground @ (turn @ rotations).mT
        projected = view.camera.project(seen)
        xy = projected.xy
        inside = projected.valid & view.camera.contains(xy)
        inside &= torch.from_numpy(view.shows(xy.numpy()))
        if not bool(inside.any()):
            return None
        features, confidence = level.sample(xy[inside].float())
        focal = float(np.mean(view.camera.focal))
        area = (focal * cell) ** 2 * altitude / seen[inside][:, 2] ** 3
        device = features.device
        confidence = confidence * (area / level.stride**2).clamp(max=1.0).float().to(device)
        if not float(confidence.sum()) > _LEAST_WEIGHT:
            return None
        of_turn, of_place = torch.nonzero(inside, as_tuple=True)
        of_turn, cells = of_turn.to(device), place[of_place].to(device)
        patch = features.new_zeros(len(rotations), rows * columns, features.shape[1])
        weight = features.new_zeros(len(rotations), rows * columns)
        patch[of_turn, cells] = features
        weight[of_turn, cells] = confidence
        return _LaidOut(
            patch.mT.reshape(len(rotations), -1, rows, columns),
            weight.reshape(-1, rows, columns),
            first,
        )

    def _footprint(self, view: WarpedImage, rotations: Tensor) -> NDArray[np.float64]:
        """Return the south-western and north-eastern corner (2, 2) of the ground that a view shows
        under any of some attitudes (T, 3, 3), from the camera, no farther away than is looked.

        Lengths are in heights above the ground; NaN where no ray is of any use.
        """
        camera = view.camera
        steps = np.linspace(0.0, 1.0, 9)
        u, v = np.meshgrid(steps * camera.width, steps * camera.height)
        edge = torch.from_numpy(np.stack([u, v], -1).reshape(-1, 2))
        rays, valid = camera.unproject(edge)
        if not bool(valid.any()):
            return np.full((2, 2), np.nan)
        turns = torch.from_numpy(view.view_from_camera) @ rotations
        directions = (rays[valid].double() @ turns).reshape(-1, 3).numpy()
        flat = np.hypot(directions[:, 0], directions[:, 1])
        down = -directions[:, 2]
        length = np.where(down > 1e-6, flat / np.maximum(down, 1e-6), np.inf)
        length = np.minimum(length, _FARTHEST)
        ground = directions[:, :2] / np.maximum(flat, 1e-9)[:, None] * length[:, None]
        return np.stack([ground.min(0), ground.max(0)])


def _padding(cells: NDArray[np.bool_], rows: int, columns: int) -> list[tuple[int, int]]:
    """Return what ``np.pad`` adds to the north and east of cells (h, w)."""
    return [(0, rows - cells.shape[0]), (0, columns - cells.shape[1])]


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
