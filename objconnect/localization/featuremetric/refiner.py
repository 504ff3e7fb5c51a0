"""Refinement of one initial pose: warp the image for it, align, and rate the pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.align.aligner import align
from objconnect.localization.align.hypotheses import align_from_many
from objconnect.localization.align.options import SEARCH_WIDTH, SearchRadius, SearchWidth
from objconnect.localization.featuremetric.attempt import (
    AlignedView,
    Attempt,
    evaluate_alignment,
    photograph_pose,
)
from objconnect.localization.featuremetric.evidence import peak_to_sidelobe
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.featuremetric.options import FeaturemetricConfig
from objconnect.localization.featuremetric.priors import DEFAULT_RADIUS, exact_prior, has_position
from objconnect.localization.featuremetric.problem import ProblemBuilder
from objconnect.localization.featuremetric.references import MAX_POINTS
from objconnect.localization.matching.retrieval import References
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Query, Stopwatch
from objconnect.scene.runtime.tuning import trim_heap_above

# Number of levels, from the coarsest, on which hypotheses are compared. The finest level is left
# out because it takes most of the time.
_COMPARED_LEVELS: Final = 2


@dataclass(frozen=True)
class Refiner:
    """Refines initial poses of queries in one map.

    Attributes:
        config: options of the localizer.
        extract: computes feature maps.
        problems: builds alignment problems.
        retrieval: finds reference images.
        matches: finds reference images by SIFT; None without ``config.matches``, or if the map was
            not built from SIFT.
        trim_above_bytes: resident memory above which the heap is trimmed before a pass of the
            network. Trimming costs time.
        trim_above_magnified_bytes: the same before a pass on a magnified image.
        search_width: numbers of hypotheses and points that a search compares.
    """

    config: FeaturemetricConfig
    extract: MapExtractor
    problems: ProblemBuilder
    retrieval: References
    matches: StructureLocalizer | None
    trim_above_bytes: int
    trim_above_magnified_bytes: int
    search_width: SearchWidth = SEARCH_WIDTH

    def __call__(
        self,
        query: Query,
        reference_rows: NDArray[np.int64],
        start: Pose,
        clock: Stopwatch,
        radius: SearchRadius,
        least_peak: float = 0.0,
    ) -> Attempt:
        """Refine a start.

        Args:
            query: the image.
            reference_rows: rows of the reference images.
            start: ``cam_from_world``.
            clock: sums the seconds of each stage.
            radius: search radius around the start, for ``config.multistart``.
            least_peak: least peak-to-sidelobe ratio after the search around the start; a pose with
                a lower ratio is not aligned on the finest level, and is no answer.
        """
        trim_heap_above(self.trim_above_bytes)
        with clock.stage("features"):
            view, maps = self.problems.view(query, reference_rows, start)
        multistart = self.config.multistart
        count = min(self.search_width.compared_points, MAX_POINTS) if multistart else MAX_POINTS
        with clock.stage("points"):
            problem = self.problems.build(view, maps, reference_rows, start, count)
        with clock.stage("alignment"):
            if multistart:
                coarse = problem.select_levels(slice(_COMPARED_LEVELS))
                aligned = AlignedView(
                    view, problem, align_from_many(coarse, radius, self.search_width)
                )
            else:
                aligned = AlignedView(view, problem, align(problem, with_covariance=False))
        if multistart and not aligned.alignment.has_failed[0]:
            with clock.stage("alignment"):
                if least_peak and peak_to_sidelobe(problem, aligned.alignment.pose) < least_peak:
                    return Attempt.without_evidence(aligned)
            aligned = self._realign(query, maps, aligned, clock)
        with clock.stage("alignment"):
            return evaluate_alignment(aligned, self.config.search)

    def widen(self, factor: int) -> Refiner:
        """Return a refiner whose searches compare ``factor`` times the hypotheses and points."""
        return replace(self, search_width=self.search_width.multiply(factor))

    def align_near(
        self,
        query: Query,
        start: Pose,
        clock: Stopwatch,
        radius: SearchRadius = DEFAULT_RADIUS,
        least_peak: float = 0.0,
    ) -> Attempt:
        """Refine a start that replaces the query's prior; see ``__call__``."""
        query = replace(query, prior=exact_prior(start))
        return self(query, self.choose_references(query), start, clock, radius, least_peak)

    def choose_references(self, query: Query) -> NDArray[np.int64]:
        """Return the rows of a query's reference images.

        Without a position, SIFT retrieves them if it can: the network is trained on views from
        above only, and the query may be oblique.
        """
        count = self.config.references
        if self.matches is not None and query.references is None and not has_position(query.prior):
            return self.matches.find_similar(query, count)
        return self.retrieval.choose(
            query, count, lambda: self.describe(query), tilt_invariant=False
        )

    def describe(self, query: Query) -> NDArray[np.float32]:
        """Return unit features (n, C) of all coarse cells of the unrotated image."""
        _, maps = self.extract(query.image, query.camera, levels=1)
        cells = maps[0].features[0].flatten(1).T.float()
        return torch.nn.functional.normalize(cells, dim=1).cpu().numpy()

    def _realign(
        self, query: Query, maps: list[FeatureMap], aligned: AlignedView, clock: Stopwatch
    ) -> AlignedView:
        """Align once more, from the aligned pose and to the points in view from there.

        A start that was far off had other points and reference images in view. An image coarser
        than the map is magnified only now, because in a larger picture a search covers a smaller
        range of poses and takes longer.
        """
        view, max_magnification = aligned.view, self.config.max_magnification
        pose = photograph_pose(view, aligned.alignment)
        reference_rows = self.choose_references(replace(query, prior=exact_prior(pose)))
        larger = self.problems.magnify(query, reference_rows, pose, view, max_magnification)
        if larger is not None:
            trim_heap_above(self.trim_above_magnified_bytes)
            with clock.stage("features"):
                view, maps = larger, self.problems.features(larger)
        with clock.stage("alignment"):
            problem = self.problems.build(view, maps, reference_rows, pose, MAX_POINTS)
            # The coarsest level cannot improve a pose that the next finer level gave.
            skips_coarsest = larger is None and len(problem.levels) > 1
            final = align(problem.finer() if skips_coarsest else problem, with_covariance=False)
        if final.has_failed[0]:
            return aligned
        iterations = aligned.alignment.iterations + final.iterations
        return AlignedView(view, problem, replace(final, iterations=iterations))
