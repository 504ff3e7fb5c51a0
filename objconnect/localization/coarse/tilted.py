"""Search for a tilted camera on a mosaic of half the resolution, with refinement of the peaks.

A mosaic holds the features of every cell of the ground.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import torch

from objconnect.localization.coarse.mosaic import Mosaic
from objconnect.localization.coarse.refinement import CoarsePoses, ViewScorer
from objconnect.localization.coarse.search import (
    Candidate,
    Hypotheses,
    MosaicSearch,
    Peak,
    QueryView,
)

# Number of peaks of the rough search that are refined.
_NUM_REFINED: Final = 48


class TiltedSearch:
    """Finds the poses of a tilted camera at which a query correlates best with a mosaic.

    Tilts multiply the number of hypotheses. All of them are compared on a mosaic of half the
    resolution, and the best peaks are refined in six dimensions at full resolution.

    Args:
        mosaic: mosaic of the map.
    """

    def __init__(self, mosaic: Mosaic) -> None:
        self._mosaic = mosaic
        self._fine, self._rough = MosaicSearch(mosaic), MosaicSearch(mosaic.halve())

    @torch.inference_mode()
    def __call__(
        self, views: Sequence[QueryView], hypotheses: Hypotheses, count: int
    ) -> list[Candidate]:
        """Return the best candidates, best first; see ``MosaicSearch``."""
        rough = [
            list(self._rough.peaks(each._replace(level=each.level.halve()), hypotheses))
            for each in views
        ]
        best = self._rough.select([peak for peaks in rough for peak in peaks], _NUM_REFINED)
        refined = [
            peak
            for each, peaks in zip(views, rough, strict=True)
            for peak in self._refine(each, [p for p in peaks if any(p is b for b in best)])
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
