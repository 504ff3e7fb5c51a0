"""Search of a mosaic from coarse to fine: all hypotheses at half resolution, the best refined.

A mosaic holds the features of every cell of the ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import torch

from objconnect.localization.coarse.mosaic import Mosaic
from objconnect.localization.coarse.refinement import CoarsePoses, ViewScorer
from objconnect.localization.coarse.search import (
    Candidate,
    Extract,
    Hypotheses,
    MosaicSearch,
    Peak,
    QueryView,
)

# Number of peaks of the rough search that are refined.
_NUM_REFINED: Final = 48
# Number of principal components that the rough search compares. Of the values 6, 8, 12, 16 and 32,
# 8 gives most candidates near the truth (python -m experiments.candidates).
_ROUGH_CHANNELS: Final = 8


class CoarseToFineSearch:
    """Finds the poses at which a query correlates best with a mosaic.

    All hypotheses are compared on a mosaic of half the resolution and few channels. The best peaks
    are refined in six dimensions at full resolution.

    Args:
        mosaic: mosaic of the map.
        separation: least horizontal distance between candidates, metres.
    """

    def __init__(self, mosaic: Mosaic, separation: float = 12.0) -> None:
        self._mosaic = mosaic
        self._fine = MosaicSearch(mosaic, separation)
        self._rough = MosaicSearch(mosaic.halve().first_channels(_ROUGH_CHANNELS), separation)

    def extract_views(self, extract: Extract, hypotheses: Hypotheses) -> list[QueryView]:
        """Return the warped query and its features; see ``MosaicSearch.extract_views``."""
        return self._fine.extract_views(extract, hypotheses)

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
        rough = [list(self._rough.peaks(_make_rough(each), hypotheses)) for each in views]
        best = self._rough.select([peak for peaks in rough for peak in peaks], _NUM_REFINED)
        refined = [
            peak
            for each, peaks in zip(views, rough, strict=True)
            for peak in self._refine(each, [p for p in peaks if any(p is b for b in best)])
            if _is_inside(peak, hypotheses.region)
        ]
        return [self._fine.candidate(peak) for peak in self._fine.select(refined, count)]

    def _refine(self, query: QueryView, peaks: Sequence[Peak]) -> Iterator[Peak]:
        """Yield the peaks of one view of the query, refined at full resolution."""
        if not peaks:
            return
        scorer = ViewScorer(self._mosaic, query.view, query.level)
        rotation = torch.stack([peak.rotation for peak in peaks])
        altitude = torch.tensor([peak.altitude for peak in peaks], dtype=torch.float64)
        centre = torch.tensor([[peak.x, peak.y] for peak in peaks], dtype=torch.float64)
        middle = centre + scorer.middle_of(rotation, altitude)
        poses, centres, scores = scorer.refine(CoarsePoses(rotation, altitude, middle))
        for k, (x, y) in enumerate(centres.tolist()):
            yield Peak(float(scores[k]), x, y, float(poses.altitude[k]), poses.rotation[k])


def _make_rough(view: QueryView) -> QueryView:
    """Return a view with features of half the resolution and few channels."""
    return view._replace(level=view.level.halve().first_channels(_ROUGH_CHANNELS))


def _is_inside(peak: Peak, region: tuple[float, float, float] | None) -> bool:
    """Return whether a peak lies in the region to search, which refinement may leave."""
    if region is None:
        return True
    east, north, radius = region
    return math.hypot(peak.x - east, peak.y - north) <= radius
