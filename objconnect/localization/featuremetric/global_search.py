"""Localization of an image with an incomplete or missing prior.

Matches, objects and the coarse search give starts that are refined. The first pose that is believed
ends the search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

from objconnect.localization.align.options import SearchRadius
from objconnect.localization.coarse.finder import CoarseSearch
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.acceptance import best_probability, is_same, log_odds_of
from objconnect.localization.featuremetric.attempt import (
    Attempt,
    Rivals,
    best_of,
    is_answered,
    is_believed,
    select_estimate,
)
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.localization.featuremetric.priors import has_position, is_near_prior
from objconnect.localization.featuremetric.references import FeatureObserver, ReferenceSource
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.starts import start_of, starts
from objconnect.scene.localizer import By, Estimate, Query, Stopwatch
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_within

# Candidates of each finder that are tried before the remaining ones of all finders.
_FIRST_CANDIDATES: Final = 4
# Search radius around a pose from matches.
_NEAR_MATCHES: Final = SearchRadius(1.0, 1.0)
_Find = Callable[[Query, Stopwatch], list[Candidate]]


def is_answer(matched: Estimate, options: SearchOptions) -> bool:
    """Return whether the pose by matches is the answer without an alignment."""
    enough = matched.inliers >= options.matched_answer_inliers
    return enough and (matched.probability or 0.0) >= 1 - options.risk


class CandidateFinder(Protocol):
    """Finds candidates of a query in a map in addition to the coarse search.

    Attributes:
        is_first: once prepared, whether it comes before the coarse search or after it.
    """

    is_first: bool

    def observer(self, source: ReferenceSource) -> FeatureObserver | None:
        """Return an observer of the feature maps of a map's photographs, or of a part of them,
        while these are computed; None if none is needed."""
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
        coarse: the coarse search; None uses the most similar photographs instead.
        other: a further finder of candidates; None for none.
    """

    refine: Refiner
    sparse_map: SparseMap
    coarse: CoarseSearch | None
    other: CandidateFinder | None

    def __call__(self, query: Query, matched: Estimate | None, clock: Stopwatch) -> Estimate | None:
        """Return the best estimate; None if there is no candidate, or no coarse search.

        Args:
            query: the image.
            matched: estimate by matches for which ``is_answer`` is false; None without matches.
            clock: takes the time.
        """
        attempts: list[Attempt] = []
        rivals: Rivals = []
        if matched is not None and matched.cam_from_world is not None:
            rivals = [(matched.cam_from_world, log_odds_of(matched.probability))]
            answer, attempts = self._near_matches(query, matched, rivals, clock)
            if answer is not None:
                return answer
        options = self.refine.config.search
        begin: list[Candidate] = []
        for candidates in self._candidates(query, clock):
            with progress_within("candidates aligned", len(candidates)) as advance:
                for done, candidate in enumerate(candidates, 1):
                    attempts.append(self.refine.near(query, candidate.pose, clock))
                    begin.append(candidate)
                    if is_believed(attempts, options, rivals):
                        # Warped from the new pose, the image is rotated and scaled better.
                        best, _ = best_of(attempts)
                        attempts.append(self.refine.near(query, best.pose, clock))
                        return self._best(attempts, candidate, clock, rivals)
                    advance(done)
        if self.coarse is None or not begin:
            return None
        return self._best(attempts, begin[0], clock, rivals)

    def _candidates(self, query: Query, clock: Stopwatch) -> Iterator[list[Candidate]]:
        """Yield the best candidates of each finder, then all others."""
        further: list[Candidate] = []
        for find in self._finders():
            candidates = find(query, clock)
            yield candidates[:_FIRST_CANDIDATES]
            further += candidates[_FIRST_CANDIDATES:]
        yield further

    def _finders(self) -> Sequence[_Find]:
        """Return the finders of candidates in the order in which they are used."""
        if self.other is None:
            return [self._find_candidates]
        finders = [self._of_other, self._find_candidates]
        return finders if self.other.is_first else finders[::-1]

    def _best(
        self, attempts: Sequence[Attempt], begin: Candidate, clock: Stopwatch, rivals: Rivals
    ) -> Estimate:
        options = self.refine.config.search
        return select_estimate(attempts, [begin.pose], begin.by, options, clock, rivals)

    def _near_matches(
        self, query: Query, matched: Estimate, rivals: Rivals, clock: Stopwatch
    ) -> tuple[Estimate | None, list[Attempt]]:
        """Refine the pose by matches.

        If both poses agree, the aligned one is more exact and is the answer if it is believed. If
        they differ, the likelier one is the answer if it is believed.

        Returns:
            The answer, or None with the attempt.
        """
        options = self.refine.config.search
        start, _ = rivals[0]
        attempt = self.refine.near(query, start, clock, _NEAR_MATCHES)
        best, probability = best_probability([(attempt.pose, attempt.log_odds), *rivals])
        same = is_same(attempt.pose, start)
        if (same or best == 0) and is_answered([attempt], options, rivals):
            return self._best([attempt], Candidate(start, 0.0, By.MATCHES), clock, rivals), []
        if (best == 0 and not same) or probability < 1 - options.risk:
            return None, [attempt]
        return replace(matched, seconds=clock.seconds, probability=probability), []

    def _of_other(self, query: Query, clock: Stopwatch) -> list[Candidate]:
        """Return the candidates of the other finder that the prior allows."""
        assert self.other is not None
        with clock.stage("objects"):
            candidates = self.other.find(query)
        return [each for each in candidates if is_near_prior(query.prior, each.pose)]

    def _find_candidates(self, query: Query, clock: Stopwatch) -> list[Candidate]:
        """Return the candidates of the coarse search, else the poses of similar photographs."""
        if self.coarse is None:
            return []
        config = self.refine.config
        with clock.stage("place"):
            candidates = self.coarse.find(query)
        if candidates or has_position(query.prior):
            return candidates
        with clock.stage("retrieval"):
            chosen = self.refine.photographs(query)
            begin = starts(query.prior, self.sparse_map, chosen, config.same_place_m)
        by = start_of(query.prior)
        return [Candidate(pose, 0.0, by) for pose in begin[: config.place.candidates]]
