"""Correlation of a query with a mosaic over headings, altitudes and, by FFT, all positions.

A mosaic holds the features of every cell of the ground; a cell is known if a photograph shows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.coarse.headings import NO_TILT
from objconnect.localization.coarse.mosaic import Mosaic
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import WarpedImage
from objconnect.scene.localizer import PoseSource
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.storage.lru_cache import MEGABYTE, LruCache

MAX_DISTANCE: Final = 2.0
"""Ground is used up to this horizontal distance, in heights of the camera above ground. Few pixels
show ground that is farther away."""
MIN_OVERLAP: Final = 0.3
"""A candidate needs at least this share of the query's confidence on known cells of the mosaic."""
UP: Final = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
# Number of peaks of the correlation that are kept for each pass of the network, tilt and altitude.
_PEAKS: Final = 3
# The height and width of a query projected to the ground are rounded up to multiples of this many
# cells.
_PATCH_MULTIPLE: Final = 16
# Memory for Fourier transforms of the mosaic, one for each size of a query projected to the ground.
_SPECTRA_MB: Final = 128
# Numerical guard: least sum of confidence over the cells of a query.
_MIN_WEIGHT: Final = 1e-3


@dataclass(frozen=True)
class Candidate:
    """A coarse pose of a query that may be near the truth.

    Attributes:
        pose: ``cam_from_world``.
        score: correlation with the mosaic, at most 1, in the coarse search; other finders
            define their own scores.
        by: source of the candidate.
    """

    pose: Pose
    score: float
    by: PoseSource = PoseSource.PLACE


@dataclass(frozen=True)
class Hypotheses:
    """Headings, altitudes, tilts and region to search.

    Attributes:
        passes: rotations ``cam_from_world`` (3, 3), one for each pass of the network.
        turns: rotations about the vertical, radians, that are tried with the features of each pass.
        altitudes: heights above ground, metres, that are tried with the features of each pass.
        region: centre (east, north) and radius of the region to search, metres; None for all.
        tilts: rotations (3, 3) of the camera in its own axes, tried with the features of each pass.
    """

    passes: Sequence[Tensor]
    turns: Sequence[float]
    altitudes: Sequence[float]
    region: tuple[float, float, float] | None = None
    tilts: Sequence[Tensor] = (NO_TILT,)


class _GroundPatch(NamedTuple):
    """A query projected to the ground under T headings.

    Attributes:
        features: (T, K, h, w) of unit length or 0.
        confidence: (T, h, w) weights of the cells.
        first: (2,) metres to the east and north, from the camera to the centre of the south-western
            cell.
    """

    features: Tensor
    confidence: Tensor
    first: NDArray[np.float64]


Extract = Callable[[Pose], tuple[WarpedImage, FeatureMap]]
"""Warps the query for a pose and computes its features of the coarsest level."""


class QueryView(NamedTuple):
    """A query that was warped for one pass of the network, with its features.

    Attributes:
        rotation: (3, 3) ``cam_from_world`` of the hypothesis that the query was warped for.
        view: the warped query.
        level: its coarsest features, reduced to the mosaic's channels.
    """

    rotation: Tensor
    view: WarpedImage
    level: FeatureMap


class Peak(NamedTuple):
    """A peak of the correlation under one hypothesis.

    Attributes:
        score: correlation, at most 1.
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
    """Finds the poses at which a query correlates best with a mosaic.

    Args:
        mosaic: mosaic of the map.
        separation: least horizontal distance between candidates, metres.
    """

    def __init__(self, mosaic: Mosaic, separation: float = 12.0) -> None:
        self._mosaic = mosaic
        self._separation = separation
        self._spectra = LruCache(self._spectrum, _SPECTRA_MB * MEGABYTE)

    @torch.inference_mode()
    def extract_views(self, extract: Extract, hypotheses: Hypotheses) -> list[QueryView]:
        """Return the warped query and its features for each pass of the network.

        Args:
            extract: warps the query north up for a pose, and computes the features of the coarsest
                level. Only height and rotation of the pose matter.
            hypotheses: headings and altitudes to search.
        """
        median_altitude = float(hypotheses.altitudes[len(hypotheses.altitudes) // 2])
        centre = torch.tensor([0.0, 0.0, median_altitude], dtype=torch.float64)
        views: list[QueryView] = []
        with progress_within("coarse search", len(hypotheses.passes)) as advance:
            for rotation in hypotheses.passes:
                view, level = extract(Pose(rotation, -rotation @ centre))
                reduced = self._mosaic.reduce_channels(level.features)
                level = FeatureMap(reduced, level.confidence, level.stride)
                views.append(QueryView(rotation, view, level))
                advance(len(views))
        return views

    def __call__(
        self, views: Sequence[QueryView], hypotheses: Hypotheses, count: int
    ) -> list[Candidate]:
        """Return the best candidates, best first, at most ``count``.

        Args:
            views: the query for each pass of the network, from ``extract_views``.
            hypotheses: headings, altitudes and region to search.
            count: maximum number of candidates.
        """
        peaks = [peak for each in views for peak in self.peaks(each, hypotheses)]
        return [self.candidate(peak) for peak in self.select(peaks, count)]

    @torch.inference_mode()
    def peaks(self, query: QueryView, hypotheses: Hypotheses) -> Iterator[Peak]:
        """Yield the peaks of one view of the query, for each tilt and altitude."""
        turns = torch.tensor(hypotheses.turns, dtype=torch.float64)
        for tilt in hypotheses.tilts:
            rotations = tilt @ query.rotation @ so3_exp(turns[:, None] * UP)
            footprint = self._footprint(query.view, rotations)
            for altitude in hypotheses.altitudes:
                patch = self._project_to_ground(
                    query.view, query.level, rotations, footprint, altitude
                )
                if patch is not None:
                    for score, x, y, turn in self._correlate(patch, hypotheses.region):
                        yield Peak(score, x, y, altitude, rotations[turn])

    def select(self, peaks: Sequence[Peak], count: int) -> list[Peak]:
        """Return the best peaks, best first, without those nearer than ``separation`` to a better
        one."""
        kept: list[Peak] = []
        for peak in sorted(peaks, key=lambda peak: -peak.score):
            if all(math.hypot(peak.x - a.x, peak.y - a.y) > self._separation for a in kept):
                kept.append(peak)
                if len(kept) == count:
                    break
        return kept

    def candidate(self, peak: Peak) -> Candidate:
        """Return a peak as a candidate."""
        z = self._mosaic.grid.height_at(peak.x, peak.y) + peak.altitude
        centre = torch.tensor([peak.x, peak.y, z], dtype=torch.float64)
        return Candidate(Pose(peak.rotation, -peak.rotation @ centre), peak.score)

    def _correlate(
        self, patch: _GroundPatch, region: tuple[float, float, float] | None
    ) -> Iterator[tuple[float, float, float, int]]:
        """Yield the peaks of the normalized correlation of a patch with the mosaic, best first.

        Each is its score, east and north (world metres), and the row of its heading in the patch.
        """
        grid, weight = self._mosaic.grid, patch.confidence
        rows, columns = grid.shape
        size = (_fast_size(rows + weight.shape[1]), _fast_size(columns + weight.shape[2]))
        spectra = self._spectra(size)
        layers = torch.cat([patch.features * weight[:, None], weight[:, None]], 1)
        spectrum = torch.fft.rfft2(layers, s=size).conj()
        products = [
            torch.einsum("khw,tkhw->thw", spectra[:-1], spectrum[:, :-1]),
            spectra[-1] * spectrum[:, -1],
        ]
        product = torch.stack(products)
        correlation, overlap = torch.fft.irfft2(product, s=size)
        total = weight.sum((1, 2)).clamp_min(_MIN_WEIGHT)[:, None, None]
        scores = correlation / (overlap.clamp_min(1e-6) * total).sqrt()
        scores[overlap < MIN_OVERLAP * total] = -1.0
        score, turn = scores.max(0)
        # Shifts beyond the grid are those to the south and west.
        north = torch.arange(size[0], device=score.device)
        east = torch.arange(size[1], device=score.device)
        y = grid.origin[1] + (north - size[0] * (north >= rows) + 0.5) * grid.cell - patch.first[1]
        x = grid.origin[0] + (east - size[1] * (east >= columns) + 0.5) * grid.cell - patch.first[0]
        if region is not None:
            distance = torch.hypot(x[None] - region[0], y[:, None] - region[1])
            score[distance > region[2]] = -1.0
        cells = max(1, round(self._separation / grid.cell))
        around = torch.arange(-cells, cells + 1, device=score.device)
        for _ in range(_PEAKS):
            row, column = divmod(int(score.argmax()), size[1])
            value = float(score[row, column])
            if value <= 0:
                return
            yield value, float(x[column]), float(y[row]), int(turn[row, column])
            score[(row + around)[:, None] % size[0], (column + around)[None] % size[1]] = -1.0

    def _spectrum(self, size: tuple[int, int]) -> Tensor:
        """Return the Fourier transforms of the mosaic's channels and, last, of its known cells."""
        layers = torch.cat([self._mosaic.features, self._mosaic.known[None]])
        spectrum: Tensor = torch.fft.rfft2(layers, s=size)
        return spectrum

    def _project_to_ground(
        self,
        view: WarpedImage,
        level: FeatureMap,
        rotations: Tensor,
        footprint: NDArray[np.float64],
        altitude: float,
    ) -> _GroundPatch | None:
        """Project the query's features to level ground; return None if the query shows no ground.

        The confidence of a cell on the ground is multiplied by the number of cells of the feature
        map that it covers, at most one, because a far cell covers only a few pixels.

        Args:
            view: the warped query.
            level: its features, reduced to the mosaic's channels.
            rotations: (T, 3, 3) ``cam_from_world`` of the photograph.
            footprint: (2, 2) corners from ``_footprint``.
            altitude: metres above the ground.
        """
        cell = self._mosaic.grid.cell
        low, high = footprint * altitude
        if not (np.isfinite(low).all() and (high > low).all()):
            return None
        first = np.floor(low / cell) * cell + cell / 2
        columns, rows = np.maximum(np.ceil((high - first) / cell), 1).astype(int).tolist()
        x, y = np.meshgrid(first[0] + np.arange(columns) * cell, first[1] + np.arange(rows) * cell)
        # Rounded up, so that transforms have few sizes.
        rows, columns = (
            _PATCH_MULTIPLE * math.ceil(side / _PATCH_MULTIPLE) for side in (rows, columns)
        )
        near = np.hypot(x, y) <= MAX_DISTANCE * altitude
        ground = torch.from_numpy(np.stack([x[near], y[near], np.full(near.sum(), -altitude)], -1))
        cell_index = torch.from_numpy(np.flatnonzero(np.pad(near, _padding(near, rows, columns))))
        view_from_camera = torch.from_numpy(view.view_from_camera)
        in_view = ground @ (view_from_camera @ rotations).mT
        projected = view.camera.project(in_view)
        xy = projected.xy
        inside = projected.valid & view.camera.contains(xy)
        inside &= torch.from_numpy(view.shows(xy.numpy()))
        if not bool(inside.any()):
            return None
        features, confidence = level.sample(xy[inside].float())
        focal = float(np.mean(view.camera.focal))
        area = (focal * cell) ** 2 * altitude / in_view[inside][:, 2] ** 3  # pixels of a cell
        device = features.device
        confidence = confidence * (area / level.stride**2).clamp(max=1.0).float().to(device)
        if not float(confidence.sum()) > _MIN_WEIGHT:
            return None
        turn, near_cell = torch.nonzero(inside, as_tuple=True)
        turn, cells = turn.to(device), cell_index[near_cell].to(device)
        patch = features.new_zeros(len(rotations), rows * columns, features.shape[1])
        weight = features.new_zeros(len(rotations), rows * columns)
        patch[turn, cells] = features
        weight[turn, cells] = confidence
        return _GroundPatch(
            patch.mT.reshape(len(rotations), -1, rows, columns),
            weight.reshape(-1, rows, columns),
            first,
        )

    def _footprint(self, view: WarpedImage, rotations: Tensor) -> NDArray[np.float64]:
        """Return the south-western and north-eastern corner (2, 2) of the ground in a view.

        The footprint covers all rotations (T, 3, 3) up to ``MAX_DISTANCE``. It is relative to the
        camera, in units of the camera's height above ground; NaN if no pixel can be
        unprojected.
        """
        camera = view.camera
        steps = np.linspace(0.0, 1.0, 9)
        u, v = np.meshgrid(steps * camera.width, steps * camera.height)
        edge = torch.from_numpy(np.stack([u, v], -1).reshape(-1, 2))
        rays, valid = camera.unproject(edge)
        if not bool(valid.any()):
            return np.full((2, 2), np.nan)
        view_from_world = torch.from_numpy(view.view_from_camera) @ rotations
        directions = (rays[valid].double() @ view_from_world).reshape(-1, 3).numpy()
        horizontal = np.hypot(directions[:, 0], directions[:, 1])
        down = -directions[:, 2]
        distance = np.where(down > 1e-6, horizontal / np.maximum(down, 1e-6), np.inf)
        distance = np.minimum(distance, MAX_DISTANCE)
        ground = directions[:, :2] / np.maximum(horizontal, 1e-9)[:, None] * distance[:, None]
        return np.stack([ground.min(0), ground.max(0)])


def _padding(cells: NDArray[np.bool_], rows: int, columns: int) -> list[tuple[int, int]]:
    """Return the widths for ``np.pad`` that extend cells (h, w) north and east to a size."""
    return [(0, rows - cells.shape[0]), (0, columns - cells.shape[1])]


def _fast_size(size: int) -> int:
    """Return the least number from ``size`` on with no prime factors but 2, 3 and 5."""
    while True:
        rest = size
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return size
        size += 1
