"""Localization of an image of which no prior says all: by matches, by objects, by its place.

Each way gives starts that are refined. The first pose that is believed ends the search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

from objconnect.localization.align.options import SearchRadius
from objconnect.localization.coarse.finder import PlaceFinder
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
from objconnect.localization.featuremetric.priors import may_be_at, says_where
from objconnect.localization.featuremetric.references import ReferenceSource, Watch
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.starts import start_of, starts
from objconnect.scene.localizer import By, Estimate, Query, Stopwatch
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_within

# Places of objects, and of the place search, that are tried before further places of either.
_FIRST_PLACES: Final = 4
# How far to look around a pose from matches.
_NEAR_MATCHES: Final = SearchRadius(1.0, 1.0)
_Find = Callable[[Query, Stopwatch], list[Candidate]]


def is_answer(matched: Estimate, options: SearchOptions) -> bool:
    """Return whether the pose of matches is the answer, without an alignment."""
    enough = matched.inliers >= options.matched_answer_inliers
    return enough and (matched.probability or 0.0) >= 1 - options.risk


class OtherFinder(Protocol):
    """Finds places of a map where a query may be, in another way than the place search.

    Attributes:
        is_first: once prepared, whether it is asked before the search, or where that fails.
    """

    is_first: bool

    def watcher(self, source: ReferenceSource) -> Watch | None:
        """Return what is to see the photographs of a map, or of a part of it, before ``prepare``;
        None where nothing."""
        ...

    def prepare(self, source: ReferenceSource) -> None:
        """Prepare for a map."""
        ...

    def find(self, query: Query) -> list[Candidate]:
        """Return places, best first."""
        ...


@dataclass(frozen=True)
class GlobalSearch:
    """Searches a map for the pose of an image.

    Attributes:
        refine: refines starts.
        sparse_map: the map.
        places: the place search; None for photographs that look alike instead.
        other: finds places too, before the place search or after it.
    """

    refine: Refiner
    sparse_map: SparseMap
    places: PlaceFinder | None
    other: OtherFinder | None

    def __call__(self, query: Query, matched: Estimate | None, clock: Stopwatch) -> Estimate | None:
        """Return the best pose that was found; None where nothing says where to look.

        Args:
            query: the image.
            matched: what matches say of it, which is no ``is_answer``; None without matches.
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
        for some in self._places(query, clock):
            with progress_within("places aligned", len(some)) as advance:
                for done, place in enumerate(some, 1):
                    attempts.append(self.refine.near(query, place.pose, clock))
                    begin.append(place)
                    if is_believed(attempts, options, rivals):
                        # Seen from there, the image is turned and scaled better.
                        best, _ = best_of(attempts)
                        attempts.append(self.refine.near(query, best.pose, clock))
                        return self._best(attempts, place, clock, rivals)
                    advance(done)
        if self.places is None or not begin:
            return None
        return self._best(attempts, begin[0], clock, rivals)

    def _places(self, query: Query, clock: Stopwatch) -> Iterator[list[Candidate]]:
        """Yield places where the query may be: the best ones of each finder before all others."""
        further: list[Candidate] = []
        for find in self._finders(query):
            places = find(query, clock)
            yield places[:_FIRST_PLACES]
            further += places[_FIRST_PLACES:]
        yield further

    def _finders(self, query: Query) -> Sequence[_Find]:
        """Return what finds places, the one that is asked first in front."""
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
        """Refine the pose of matches: return the answer if one is believed, and what was tried.

        At one place the aligned pose is the more exact one, and is answered if it is believed by
        itself. Of two places the likelier one is answered, if at all.

        Args:
            query: the image.
            matched: what matches say of it.
            rivals: the pose of that alone.
            clock: takes the time.
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
        """Return the places of the other finder that the prior allows."""
        assert self.other is not None
        with clock.stage("objects"):
            places = self.other.find(query)
        return [place for place in places if may_be_at(query.prior, place.pose)]

    def _find_candidates(self, query: Query, clock: Stopwatch) -> list[Candidate]:
        """Return the starts of the place search, or of the photographs that look most like it."""
        if self.places is None:
            return []
        config = self.refine.config
        with clock.stage("place"):
            places = self.places.find(query)
        if places or says_where(query.prior):
            return places
        with clock.stage("retrieval"):
            chosen = self.refine.photographs(query)
            begin = starts(query.prior, self.sparse_map, chosen, config.same_place_m)
        by = start_of(query.prior)
        return [Candidate(pose, 0.0, by) for pose in begin[: config.place.candidates]]
