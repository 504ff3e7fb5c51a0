"""Correlation of a query with a mosaic over headings, altitudes, tilts and all positions.

A mosaic holds the features of every cell of the ground; a cell is known if a photograph shows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor

from objconnect.localization.coarse.correlation import MosaicSampler, sum_shifted
from objconnect.localization.coarse.grid import GroundGrid
from objconnect.localization.coarse.headings import NO_TILT
from objconnect.localization.coarse.mosaic import Mosaic
from objconnect.localization.coarse.refinement import MIN_OVERLAP, CoarsePoses, ViewScorer, middle
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import WarpedImage
from objconnect.scene.localizer import PoseSource
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.runtime.threads import count_network_threads, map_in_threads

UP: Final = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
# Number of peaks of the correlation that are kept for each pass of the network, tilt and altitude.
_PEAKS: Final = 3
# Number of peaks that are refined, times one plus the number of times that the mosaic is halved.
_NUM_REFINED: Final = 48
# A mosaic of more cells is searched at half its resolution, repeatedly. It bounds time and memory.
_MOST_CELLS: Final = 128**2
# The share of the query on known ground is computed from every n-th of its cells.
_KNOWN_EVERY: Final = 4
# Numerical guard: least sum of confidence over the cells of a query.
_MIN_WEIGHT: Final = 1e-3


@dataclass(frozen=True)
class Candidate:
    """A coarse pose of a query that may be near the truth.

    Attributes:
        pose: ``cam_from_world``.
        score: ``Peak.score`` in the coarse search; other finders define their own scores.
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


Extract = Callable[[Pose], tuple[WarpedImage, FeatureMap]]
"""Warps the query for a pose and computes its features of the coarsest level."""


class QueryView(NamedTuple):
    """A query that was warped for one pass of the network, with its features.

    Attributes:
        rotation: (3, 3) ``cam_from_world`` of the hypothesis that the query was warped for.
        scorer: scores poses on the mosaic.
        rough_scorer: scores poses on the mosaic at the resolution that is searched.
    """

    rotation: Tensor
    scorer: ViewScorer
    rough_scorer: ViewScorer


class Peak(NamedTuple):
    """A peak of the correlation under one hypothesis.

    Attributes:
        score: correlation, divided by ``noise``.
        x: world metres, east.
        y: world metres, north.
        altitude: height above ground, metres.
        rotation: (3, 3) ``cam_from_world``.
        noise: root mean square of the correlations at this tilt and altitude, over all headings and
            positions. It is larger where the query covers little ground, so that wrong poses
            correlate more by chance.
    """

    score: float
    x: float
    y: float
    altitude: float
    rotation: Tensor
    noise: float


class RoughPeaks(NamedTuple):
    """The peaks of one view at one tilt and altitude, over all turns.

    Attributes:
        peaks: the peaks; their noise is 1.
        squares: sum of the squared correlations over all turns and positions.
        number: number of these correlations.
    """

    peaks: list[Peak]
    squares: float
    number: int


class MosaicSearch:
    """Finds the poses at which a query correlates best with a mosaic.

    All hypotheses are compared at the positions of the mosaic's cells, in a large mosaic at a lower
    resolution. Correlations are divided by their noise. The best peaks are refined in six
    dimensions at full resolution.

    Args:
        mosaic: mosaic of the map.
        separation: least horizontal distance between candidates, metres.
    """

    def __init__(self, mosaic: Mosaic, separation: float = 12.0) -> None:
        self._mosaic, self._sampler = mosaic, MosaicSampler(mosaic)
        self._separation = separation
        # Mosaics from full resolution to that which is searched.
        self._halved = [mosaic]
        while self._halved[-1].known.numel() > _MOST_CELLS:
            self._halved.append(self._halved[-1].halve())
        is_whole = len(self._halved) == 1
        self._rough_sampler = self._sampler if is_whole else MosaicSampler(self._halved[-1])

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

        def extract_view(rotation: Tensor) -> QueryView:
            view, level = extract(Pose(rotation, -rotation @ centre))
            reduced = self._mosaic.reduce_channels(level.features)
            level = FeatureMap(reduced, level.confidence, level.stride)
            scorer = rough_scorer = ViewScorer(self._sampler, view, level)
            if self._rough_sampler is not self._sampler:
                for _ in self._halved[1:]:
                    level = level.halve()
                rough_scorer = ViewScorer(self._rough_sampler, view, level)
            return QueryView(rotation, scorer, rough_scorer)

        views: list[QueryView] = []
        threads = count_network_threads()
        with progress_within("coarse search", len(hypotheses.passes)) as advance:
            for view in map_in_threads(extract_view, hypotheses.passes, threads):
                views.append(view)
                advance(len(views))
        return views

    @torch.inference_mode()
    def __call__(
        self, views: Sequence[QueryView], hypotheses: Hypotheses, count: int
    ) -> list[Candidate]:
        """Return the best candidates, best first, at most ``count``.

        Args:
            views: the query for each pass of the network, from ``extract_views``.
            hypotheses: headings, altitudes, tilts and region to search.
            count: maximum number of candidates.
        """
        searched = map_in_threads(lambda each: list(self._peaks(each, hypotheses)), views)
        rough = _divide_by_noise([*searched])
        number = _NUM_REFINED * len(self._halved)
        best = self._select([peak for peaks in rough for peak in peaks], number)
        chosen = {id(peak) for peak in best}

        def refine(peaks_of_view: tuple[QueryView, Sequence[Peak]]) -> list[Peak]:
            view, peaks = peaks_of_view
            return self._refine(view.scorer, [each for each in peaks if id(each) in chosen])

        refined = [
            peak
            for peaks in map_in_threads(refine, zip(views, rough, strict=True))
            for peak in peaks
            if _is_inside(peak, hypotheses.region)
        ]
        return [self._candidate(peak) for peak in self._select(refined, count)]

    def _peaks(self, query: QueryView, hypotheses: Hypotheses) -> Iterator[RoughPeaks]:
        """Yield the peaks of one view of the query at each tilt and altitude."""
        scorer = query.rough_scorer
        mosaic = self._halved[-1]
        grid, known = mosaic.grid, mosaic.known
        planes = (scorer.features @ mosaic.features.flatten(1)).view(-1, *grid.shape)
        turns = so3_exp(torch.tensor(hypotheses.turns, dtype=torch.float64)[:, None] * UP)
        altitude = torch.tensor(hypotheses.altitudes, dtype=torch.float64)
        altitudes = altitude.repeat_interleave(len(turns))
        for tilt in hypotheses.tilts:
            rotations = (tilt @ query.rotation @ turns).repeat(len(altitude), 1, 1)
            ground, weight = scorer.project_to_ground(rotations, altitudes)
            to_middle = middle(ground, weight)
            shifts = ((ground - to_middle[:, None]) / grid.cell).round().int().to(known.device)
            weights = weight.float().to(known.device)
            sums, overlaps = sum_shifted(planes, known, shifts, weights, _KNOWN_EVERY)
            total = weights.sum(1).clamp_min(_MIN_WEIGHT)[:, None, None]
            compared = weights[:, ::_KNOWN_EVERY].sum(1).clamp_min(_MIN_WEIGHT)[:, None, None]
            share = overlaps / compared
            is_known = share >= MIN_OVERLAP
            scores = (sums / (share.sqrt() * total)).where(is_known, 0.0).cpu()
            squares = scores.square().view(len(altitude), -1).sum(1).tolist()
            number = is_known.view(len(altitude), -1).sum(1).cpu().tolist()
            first = torch.from_numpy(grid.origin) + grid.cell / 2 - to_middle
            if hypotheses.region is not None:
                scores[_distance_from(hypotheses.region, first, grid) > hypotheses.region[2]] = 0.0
            peaks = self._find_peaks(scores, first, rotations, hypotheses.altitudes)
            yield from map(RoughPeaks, peaks, squares, number)

    def _find_peaks(
        self, scores: Tensor, first: Tensor, rotations: Tensor, altitudes: Sequence[float]
    ) -> Iterator[list[Peak]]:
        """Yield the highest peaks at each altitude, over all turns.

        Args:
            scores: (A * T, H, W) for A altitudes and T turns; at most 0 where there is no peak.
            first: (A * T, 2) position of the camera for the south-western cell, world metres.
            rotations: (A * T, 3, 3) ``cam_from_world``.
            altitudes: A heights above ground, metres.
        """
        grid, count = self._halved[-1].grid, len(altitudes)
        rows, columns = grid.shape
        best = scores.view(count, -1, rows, columns).max(1)
        score, turn = best.values.numpy(), best.indices.numpy()
        cells = max(1, round(self._separation / grid.cell))
        for k, altitude in enumerate(altitudes):
            peaks: list[Peak] = []
            for _ in range(_PEAKS):
                row, column = divmod(int(score[k].argmax()), columns)
                value = float(score[k, row, column])
                if value <= 0:
                    break
                hypothesis = k * (len(scores) // count) + int(turn[k, row, column])
                x, y = (first[hypothesis] + grid.cell * torch.tensor([column, row])).tolist()
                peaks.append(Peak(value, x, y, altitude, rotations[hypothesis], 1.0))
                south, west = max(0, row - cells), max(0, column - cells)
                score[k, south : row + cells + 1, west : column + cells + 1] = 0.0
            yield peaks

    def _refine(self, scorer: ViewScorer, peaks: Sequence[Peak]) -> list[Peak]:
        """Return the peaks of one view of the query, refined."""
        if not peaks:
            return []
        rotation = torch.stack([peak.rotation for peak in peaks])
        altitude = torch.tensor([peak.altitude for peak in peaks], dtype=torch.float64)
        centre = torch.tensor([[peak.x, peak.y] for peak in peaks], dtype=torch.float64)
        to_middle = middle(*scorer.project_to_ground(rotation, altitude))
        poses, centres, scores = scorer.refine(CoarsePoses(rotation, altitude, centre + to_middle))
        return [
            peak._replace(
                score=float(scores[k]) / peak.noise,
                x=x,
                y=y,
                altitude=float(poses.altitude[k]),
                rotation=poses.rotation[k],
            )
            for k, (peak, (x, y)) in enumerate(zip(peaks, centres.tolist(), strict=True))
        ]

    def _select(self, peaks: Sequence[Peak], count: int) -> list[Peak]:
        """Return the best peaks, best first, without those nearer than ``separation`` to a better
        one."""
        kept: list[Peak] = []
        for peak in sorted(peaks, key=lambda peak: -peak.score):
            if all(math.hypot(peak.x - a.x, peak.y - a.y) > self._separation for a in kept):
                kept.append(peak)
                if len(kept) == count:
                    break
        return kept

    def _candidate(self, peak: Peak) -> Candidate:
        """Return a peak as a candidate."""
        z = self._mosaic.grid.height_at(peak.x, peak.y) + peak.altitude
        centre = torch.tensor([peak.x, peak.y, z], dtype=torch.float64)
        return Candidate(Pose(peak.rotation, -peak.rotation @ centre), peak.score)


def _divide_by_noise(rough: Sequence[Sequence[RoughPeaks]]) -> list[list[Peak]]:
    """Return the peaks of each view, with scores divided by the noise.

    Args:
        rough: peaks of each view, in the same order of tilts and altitudes for all views.
    """
    noises = [
        math.sqrt(sum(each.squares for each in group) / max(1, sum(each.number for each in group)))
        for group in zip(*rough, strict=True)
    ]
    return [
        [
            peak._replace(score=peak.score / noise, noise=noise)
            for found, noise in zip(view, noises, strict=True)
            for peak in found.peaks
        ]
        for view in rough
    ]


def _distance_from(region: tuple[float, float, float], first: Tensor, grid: GroundGrid) -> Tensor:
    """Return the distances (T, H, W) of cameras from the centre of a region, metres.

    Args:
        region: centre (east, north) and radius, metres.
        first: (T, 2) positions of the cameras for the south-western cell, world metres.
        grid: the cells.
    """
    rows, columns = grid.shape
    x = first[:, :1] + grid.cell * torch.arange(columns) - region[0]
    y = first[:, 1:] + grid.cell * torch.arange(rows) - region[1]
    return torch.hypot(x[:, None], y[:, :, None])


def _is_inside(peak: Peak, region: tuple[float, float, float] | None) -> bool:
    """Return whether a peak lies in the region to search, which refinement may leave."""
    return region is None or math.hypot(peak.x - region[0], peak.y - region[1]) <= region[2]
