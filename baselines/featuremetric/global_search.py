"""Localization of an image of which no prior says all: by matches, by objects, by its place.

Each way gives starts that are refined. The first pose that is sure ends the search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

from baselines.align.options import SearchRadius
from baselines.featuremetric.attempt import Attempt, estimated, is_clear, stayed_near
from baselines.featuremetric.priors import says_where
from baselines.featuremetric.references import ReferenceSource, Watch
from baselines.featuremetric.refiner import Refiner
from baselines.place.finder import PlaceFinder
from baselines.place.search import Candidate
from baselines.starts import starts
from scene.geometry.pose import Pose
from scene.localizer import Estimate, MapPart, Query, Stopwatch
from scene.maps.sparse_map import SparseMap

_UNCLEAR: Final = "no place of the map fits the image clearly"


class OtherFinder(Protocol):
    """Finds places of a map where a query may be, in another way than the place search.

    Attributes:
        is_first: once prepared, whether it is asked before the search, or where that fails.
    """

    is_first: bool

    def watcher(
        self, source: ReferenceSource, cache: Path, part: MapPart | None = None
    ) -> Watch | None:
        """Return what is to see the photographs of a map, or of a part of it, before ``prepare``;
        None where nothing."""
        ...

    def prepare(self, source: ReferenceSource, cache: Path) -> None:
        """Prepare for a map; ``cache`` keeps files."""
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

    def __call__(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the best pose that was found; None where nothing says where to look."""
        attempts: list[Attempt] = []
        matched = self._matched(query, clock)
        if matched is not None and matched.cam_from_world is not None:
            answer, attempts = self._near_matches(query, matched, matched.cam_from_world, clock)
            if answer is not None:
                return answer
        other = None if says_where(query.prior) else self.other
        if other is not None and other.is_first:
            answer, tried = self._at_places_of(other, query, clock)
            if answer is not None:
                return answer
            attempts += tried
        places = self._found_places(query, clock)
        if places:
            attempts = self._at_places(query, attempts, places, clock)
        if other is not None and not other.is_first and all(each.reason for each in attempts):
            answer, _ = self._at_places_of(other, query, clock)
            if answer is not None:
                return answer
        return self._best(attempts, [place.pose for place in places], clock) if places else None

    def _best(
        self, attempts: Sequence[Attempt], begin: Sequence[Pose], clock: Stopwatch
    ) -> Estimate:
        return estimated(attempts, begin, self.refine.config.search, clock)

    def _matched(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose that matches of local features give."""
        if self.refine.matches is None:
            return None
        with clock.stage("matches"):
            return self.refine.matches.localize(query)

    def _near_matches(
        self, query: Query, matched: Estimate, start: Pose, clock: Stopwatch
    ) -> tuple[Estimate | None, list[Attempt]]:
        """Refine the pose of matches: return the answer where it is sure, and what was tried."""
        options = self.refine.config.search
        if matched.inliers >= options.matched_answer_inliers:
            return replace(matched, seconds=clock.seconds), []
        around = SearchRadius(options.matched_radius_m, options.matched_radius_deg)
        attempt = self.refine.near(query, start, clock, around)
        if matched.inliers >= options.matched_accept_inliers:
            if attempt.reason or not stayed_near(attempt.pose, start, options):
                return replace(matched, seconds=clock.seconds), []
            return self._best([attempt], [start], clock), []
        if attempt.fit < options.place_accept_fit:
            return self._best([attempt], [start], clock), []
        return None, [attempt]

    def _at_places_of(
        self, finder: OtherFinder, query: Query, clock: Stopwatch
    ) -> tuple[Estimate | None, list[Attempt]]:
        """Try the places of another finder until one fits well: the answer, and what was tried."""
        least = self.refine.config.search.place_accept_fit
        with clock.stage("objects"):
            places = finder.find(query)
        attempts: list[Attempt] = []
        for place in places:
            tried = self.refine.twice(query, place.pose, least, clock)
            if len(tried) > 1:
                return self._best(tried, [place.pose], clock), tried
            attempts += tried
        return None, attempts

    def _found_places(self, query: Query, clock: Stopwatch) -> list[Candidate]:
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
            begin = starts(query.prior, self.sparse_map, chosen, config.starts)
        return [Candidate(pose, 0.0) for pose in begin[: config.place.candidates]]

    def _at_places(
        self,
        query: Query,
        before: Sequence[Attempt],
        places: Sequence[Candidate],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try the starts of the place search until the fit of one is good enough to stop.

        A fit that says less is accepted only where starts at two places lead to one pose, or where
        no other place fits nearly as well: among many places one fits better than by chance.
        """
        options = self.refine.config.search
        attempts = list(before)
        enough = [options.place_accept_fit] * len(places)
        if not places[1:] or places[0].score - places[1].score > options.first_margin:
            enough[0] = options.first_accept_fit
        for place, least in zip(places, enough, strict=True):
            tried = self.refine.twice(query, place.pose, least, clock)
            if len(tried) > 1:
                return tried
            attempts += tried
        clear = [is_clear(row, attempts, options) for row in range(len(attempts))]
        return [
            attempt if attempt.reason or fine else replace(attempt, reason=_UNCLEAR)
            for attempt, fine in zip(attempts, clear, strict=True)
        ]
