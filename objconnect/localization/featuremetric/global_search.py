"""Localization of an image with an incomplete or missing prior.

SIFT matches, objects of the map, the coarse search and the method of the option ``search.matcher``
give lists of candidates. The first candidate of each list is refined, then those whose rough
alignment has a high peak-to-sidelobe ratio, and last the few best of all others. The first probable
refined pose ends the search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

from objconnect.localization.align.options import SearchRadius
from objconnect.localization.coarse.finder import CoarseSearch
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.acceptance import (
    best_probability,
    is_same_pose,
    log_odds_of,
)
from objconnect.localization.featuremetric.attempt import (
    Attempt,
    Rivals,
    is_accepted,
    is_probable,
    select_estimate,
    select_likeliest,
)
from objconnect.localization.featuremetric.matched_finder import MatchedFinder
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.localization.featuremetric.priors import DEFAULT_RADIUS, has_position, is_near_prior
from objconnect.localization.featuremetric.references import FeatureObserver, ReferenceSource
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.featuremetric.screening import ScreenedCandidate, screen
from objconnect.localization.initial_poses import list_initial_poses, source_of_initial_poses
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, PoseSource, Query, Stopwatch
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_within

MATCHES_RADIUS: Final = SearchRadius(1.0, 1.0)
"""Search radius (metres, degrees) around a pose from SIFT matches."""
# A candidate is refined before the others are screened if its peak-to-sidelobe ratio is at least
# this many times ``search.least_peak``.
_CLEAR_PEAK: Final = 1.5
# The alignment of a candidate ends early below this many times ``search.least_peak``: at the full
# resolution of the image, peaks of right candidates are higher than after a rough alignment.
_SEARCHED_PEAK: Final = 1.15
# Maximum number of candidates without a clear peak that are refined. A right one is nearly always
# among them.
_MOST_UNCLEAR: Final = 3
# Errors of a candidate up to which its aligned pose is the answer: metres and degrees. They are
# those of a usual prior, from which an image is aligned once.
_NEAR: Final = SearchRadius(3.0, 5.0)
# Maximum number of poses of similar map photographs that are candidates.
_MOST_SIMILAR: Final = 16
_Find = Callable[[Query, Stopwatch], Iterator[list[Candidate]]]


def is_sure_match(matched: Estimate, options: SearchOptions) -> bool:
    """Return whether the pose from matches is the answer without an alignment."""
    has_many_inliers = matched.inliers >= options.matched_answer_inliers
    return has_many_inliers and (matched.probability or 0.0) >= 1 - options.risk


class CandidateFinder(Protocol):
    """Finds candidates of a query in a map in addition to the coarse search.

    Attributes:
        is_first: whether it is used before the coarse search, else after it. It is valid once
            ``prepare`` has run.
    """

    is_first: bool

    def observer(self, source: ReferenceSource) -> FeatureObserver | None:
        """Return a consumer of the map photographs' feature maps, which are computed one by one;
        None if the finder needs none."""
        ...

    def prepare(self, source: ReferenceSource) -> None:
        """Prepare for a map."""
        ...

    def find(self, query: Query) -> list[Candidate]:
        """Return candidates, best first."""
        ...


@dataclass(frozen=True)
class GlobalSearch:
    """Searches a map for the pose of an image.

    Attributes:
        refine: refines an initial pose.
        sparse_map: the map.
        coarse: the coarse search; if None, only matches and the two other finders give candidates,
            and the localizer starts from similar photographs if no candidate gives a probable pose.
        extra_finder: finds candidates in addition to the coarse search; None for none.
        matched_finder: finds candidates if no other gives a probable pose; None for none.
    """

    refine: Refiner
    sparse_map: SparseMap
    coarse: CoarseSearch | None
    extra_finder: CandidateFinder | None
    matched_finder: MatchedFinder | None = None

    def __call__(self, query: Query, matched: Estimate | None, clock: Stopwatch) -> Estimate | None:
        """Return the best estimate.

        It is None without a candidate, or if none gives a probable pose and there is no coarse
        search.

        Args:
            query: the image.
            matched: estimate by matches for which ``is_sure_match`` is false; None without matches.
            clock: sums the seconds of each stage.
        """
        attempts: list[Attempt] = []
        rivals: Rivals = []
        if matched is not None and matched.cam_from_world is not None:
            rivals = [(matched.cam_from_world, log_odds_of(matched.probability))]
            answer, attempts = self._align_near_matches(query, matched, rivals, clock)
            if answer is not None:
                return answer
        options = self.refine.config.search
        tried: list[Candidate] = []
        for candidate in self._select_promising(query, clock):
            attempts.append(self._align(query, candidate, clock))
            tried.append(candidate)
            if is_probable(attempts, options, rivals):
                best, _ = select_likeliest(attempts)
                if best is not attempts[-1] or not _is_near(candidate.pose, best.pose):
                    # Warped from the new pose, the image is rotated and scaled better.
                    attempts.append(self.refine.align_near(query, best.pose, clock))
                return self._select_best(attempts, candidate, clock, rivals)
        if self.coarse is None or not tried:
            return None
        return self._select_best(attempts, tried[0], clock, rivals)

    def _align(self, query: Query, candidate: Candidate, clock: Stopwatch) -> Attempt:
        """Refine a candidate, with a smaller search radius if it is a pose from matches."""
        radius = MATCHES_RADIUS if candidate.by is PoseSource.MATCHES else DEFAULT_RADIUS
        least_peak = _SEARCHED_PEAK * self.refine.config.search.least_peak
        return self.refine.align_near(query, candidate.pose, clock, radius, least_peak)

    def _select_promising(self, query: Query, clock: Stopwatch) -> Iterator[Candidate]:
        """Yield the candidates that are worth a full alignment.

        The first of each list is often right and is not screened. The others are screened in their
        order. One with a clear peak, or in a picture too small for screening, is yielded at once.
        Of the rest, those with the highest peaks of at least ``search.least_peak`` follow, the
        highest first. The candidate of the method ``search.matcher`` is the last, and is not
        screened.
        """
        least = self.refine.config.search.least_peak
        unclear: list[ScreenedCandidate] = []
        for candidates in self.find(query, clock):
            yield from candidates[:1]
            with progress_within("candidates", len(candidates)) as advance:
                for done, screened in enumerate(
                    screen(self.refine, query, candidates[1:], clock), 2
                ):
                    if math.isnan(screened.peak) or screened.peak >= _CLEAR_PEAK * least:
                        yield screened.candidate
                    elif screened.peak >= least:
                        unclear.append(screened)
                    advance(done)
        for each in sorted(unclear, key=lambda each: -each.peak)[:_MOST_UNCLEAR]:
            yield each.candidate
        if self.matched_finder is not None:
            yield from self._find_by_matcher(self.matched_finder, query, clock)

    def find(self, query: Query, clock: Stopwatch) -> Iterator[list[Candidate]]:
        """Yield the candidates of the coarse search and of the extra finder, in their order.

        The candidate of the method ``search.matcher`` is not among them.
        """
        finders: list[_Find] = [self._find_candidates]
        if self.extra_finder is not None:
            finders.insert(0 if self.extra_finder.is_first else 1, self._find_extra)
        for find in finders:
            yield from find(query, clock)

    def _select_best(
        self, attempts: Sequence[Attempt], fallback: Candidate, clock: Stopwatch, rivals: Rivals
    ) -> Estimate:
        options = self.refine.config.search
        return select_estimate(attempts, [fallback.pose], fallback.by, options, clock, rivals)

    def _align_near_matches(
        self, query: Query, matched: Estimate, rivals: Rivals, clock: Stopwatch
    ) -> tuple[Estimate | None, list[Attempt]]:
        """Refine the pose from matches, the first of ``rivals``.

        The aligned pose is the answer if it agrees with the matched pose or is likelier, and is
        accepted. Otherwise the matched pose is the answer if it agrees with the aligned pose or is
        likelier, and is probable.

        Returns:
            The answer and no attempt, or None and the attempt that gave no answer.
        """
        options = self.refine.config.search
        start, _ = rivals[0]
        attempt = self.refine.align_near(query, start, clock, MATCHES_RADIUS)
        best, probability = best_probability([(attempt.pose, attempt.log_odds), *rivals])
        same = is_same_pose(attempt.pose, start)
        if (same or best == 0) and is_accepted([attempt], options, rivals):
            return self._select_best(
                [attempt], Candidate(start, 0.0, PoseSource.MATCHES), clock, rivals
            ), []
        if (best == 0 and not same) or probability < 1 - options.risk:
            return None, [attempt]
        return replace(matched, seconds=clock.seconds, probability=probability), []

    def _find_extra(self, query: Query, clock: Stopwatch) -> Iterator[list[Candidate]]:
        """Yield the candidates of the extra finder that the prior allows."""
        assert self.extra_finder is not None
        with clock.stage("objects"):
            candidates = self.extra_finder.find(query)
        yield [each for each in candidates if is_near_prior(query.prior, each.pose)]

    @staticmethod
    def _find_by_matcher(finder: MatchedFinder, query: Query, clock: Stopwatch) -> list[Candidate]:
        """Return the candidate of the method ``search.matcher``, in a list."""
        with clock.stage("matcher"):
            return finder.find(query)

    def _find_candidates(self, query: Query, clock: Stopwatch) -> Iterator[list[Candidate]]:
        """Yield the candidates of the coarse search, list by list (``CoarseSearch.find``).

        If it finds none and the prior has no position, the poses of similar map photographs are
        yielded instead. If the coarse search is switched off, nothing is yielded.
        """
        if self.coarse is None:
            return
        lists, found = self.coarse.find(query), False
        while True:
            with clock.stage("place"):
                candidates = next(lists, None)
            if candidates is None:
                break
            found = found or bool(candidates)
            yield candidates
        if not found and not has_position(query.prior):
            yield self._find_similar(query, clock)

    def _find_similar(self, query: Query, clock: Stopwatch) -> list[Candidate]:
        """Return poses of similar map photographs, with the attitude of the prior if known."""
        config = self.refine.config
        with clock.stage("retrieval"):
            reference_rows = self.refine.choose_references(query)
            poses = list_initial_poses(
                query.prior, self.sparse_map, reference_rows, config.same_place_m
            )
        by = source_of_initial_poses(query.prior)
        return [Candidate(pose, 0.0, by) for pose in poses[:_MOST_SIMILAR]]


def _is_near(start: Pose, pose: Pose) -> bool:
    """Return whether an alignment moved a candidate so little that the image fits the new pose."""
    metres, degrees = start.error_to(pose)
    return bool(metres <= _NEAR.metres and degrees <= _NEAR.degrees)
