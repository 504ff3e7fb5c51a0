"""Refinement of one start: warp the image as if it were right, align, and judge the pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.align.aligner import align
from objconnect.localization.align.hypotheses import align_from_many
from objconnect.localization.align.options import WIDTH, SearchRadius, Width
from objconnect.localization.featuremetric.attempt import (
    Attempt,
    Found,
    evaluate_alignment,
    photograph_pose,
)
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.featuremetric.options import FeaturemetricConfig
from objconnect.localization.featuremetric.priors import AROUND, exact_prior, says_where
from objconnect.localization.featuremetric.problem import ProblemBuilder
from objconnect.localization.featuremetric.references import POINTS
from objconnect.localization.matching.retrieval import References
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Query, Stopwatch
from objconnect.scene.runtime.tuning import return_freed_above

# Levels, from the coarsest, on which starts are compared: the finest would take most of the time.
_COMPARED_LEVELS: Final = 2


@dataclass(frozen=True)
class Refiner:
    """Refines starts of queries in one map.

    Attributes:
        config: options of the method.
        extract: computes feature maps.
        problems: builds alignment problems.
        retrieval: chooses photographs of the map.
        matches: tells by SIFT which photographs look like an image; None where the map was not
            built from its features.
        kept_bytes: memory above which what was freed is given back before the network sees an
            image. To take it again costs time.
        kept_magnified_bytes: the same before it sees a magnified one.
        width: how many starts and points a search compares.
    """

    config: FeaturemetricConfig
    extract: MapExtractor
    problems: ProblemBuilder
    retrieval: References
    matches: StructureLocalizer | None
    kept_bytes: int
    kept_magnified_bytes: int
    width: Width = WIDTH

    def __call__(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        start: Pose,
        clock: Stopwatch,
        radius: SearchRadius,
    ) -> Attempt:
        """Refine a start.

        Args:
            query: the image.
            chosen: rows of the photographs of the map to align it to.
            start: ``cam_from_world``.
            clock: takes the time.
            radius: how far to look around the start.
        """
        return_freed_above(self.kept_bytes)
        with clock.stage("features"):
            view, maps = self.problems.view(query, chosen, start)
        many = self.config.multistart
        count = min(self.width.compared_points, POINTS) if many else POINTS
        with clock.stage("points"):
            problem = self.problems.build(view, maps, chosen, start, count)
        with clock.stage("alignment"):
            if many:
                few = problem.at_levels(slice(_COMPARED_LEVELS))
                found = Found(view, problem, align_from_many(few, radius, self.width))
            else:
                found = Found(view, problem, align(problem, with_covariance=False))
        if many and not found.alignment.has_failed[0]:
            found = self._realign(query, maps, found, clock)
        with clock.stage("alignment"):
            return evaluate_alignment(found, self.config.search)

    def wider(self, factor: int) -> Refiner:
        """Return a refiner whose searches compare so many times the starts and points."""
        return replace(self, width=self.width.times(factor))

    def near(
        self, query: Query, start: Pose, clock: Stopwatch, radius: SearchRadius | None = None
    ) -> Attempt:
        """Refine a start that says more than the query's own prior."""
        near = replace(query, prior=exact_prior(start))
        return self(near, self.photographs(near), start, clock, radius or AROUND)

    def photographs(self, query: Query) -> NDArray[np.int64]:
        """Return the rows of the photographs to align a query to.

        SIFT features tell which look most like it: those of the network were learned from above.
        """
        most = self.config.references
        if self.matches is not None and query.references is None and not says_where(query.prior):
            return self.matches.similar(query, most)
        return self.retrieval.choose(query, most, lambda: self.describe(query), tilted=False)

    def describe(self, query: Query) -> NDArray[np.float32]:
        """Return unit features (n, C) of all coarse cells of the image as it was taken."""
        _, maps = self.extract(query.image, query.camera, levels=1)
        cells = maps[0].features[0].flatten(1).T.float()
        return torch.nn.functional.normalize(cells, dim=1).cpu().numpy()

    def _realign(
        self, query: Query, maps: list[FeatureMap], found: Found, clock: Stopwatch
    ) -> Found:
        """Align once more, to all points in view from the aligned pose.

        A start far off saw other points and photographs. Images coarser than these are magnified
        only now: a search reaches less far in a larger picture, and takes longer.
        """
        view, most = found.view, self.config.max_magnification
        pose = photograph_pose(view, found.alignment)
        chosen = self.photographs(replace(query, prior=exact_prior(pose)))
        larger = self.problems.magnify(query, chosen, pose, view, most)
        if larger is not None:
            return_freed_above(self.kept_magnified_bytes)
            with clock.stage("features"):
                view, maps = larger, self.problems.features(larger)
        with clock.stage("alignment"):
            after = self.problems.build(view, maps, chosen, pose, POINTS)
            # The coarsest level has no more to say of a pose that a finer one of it found.
            skipped = larger is None and len(after.levels) > 1
            final = align(after.finer() if skipped else after, with_covariance=False)
        if final.has_failed[0]:
            return found
        iterations = found.alignment.iterations + final.iterations
        return Found(view, after, replace(final, iterations=iterations))
