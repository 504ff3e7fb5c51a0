"""Localization by alignment: where the image looks like the map's points do in near photographs.

One pipeline for every network with features at several strides; a method is a network and a
configuration. After PixLoc (Sarlin et al., CVPR 2021). Differently from their code, features of the
photographs are kept from ``prepare`` on, photographs are seen north up and at one resolution,
steps that make the cost larger are not taken, and the pose has a covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.align.aligner import align
from baselines.align.hypotheses import align_from_many
from baselines.align.options import Options, SearchRadius
from baselines.featuremetric.attempt import (
    Attempt,
    Found,
    estimated,
    is_clear,
    judged,
    photograph_pose,
    stayed_near,
)
from baselines.featuremetric.maps import FeatureMap, MapExtractor, Network
from baselines.featuremetric.matcher import matcher
from baselines.featuremetric.options import FeaturemetricConfig
from baselines.featuremetric.priors import (
    default_radius,
    known_pose,
    says_all,
    says_where,
    search_radius,
)
from baselines.featuremetric.problem import LEAST_SIDE, Levelling, ProblemBuilder
from baselines.featuremetric.references import ReferenceSource, references
from baselines.featuremetric.tracking import Tracking
from baselines.place.finder import PlaceFinder
from baselines.place.search import Candidate
from baselines.retrieval import OnDemand, References
from baselines.sift import SiftLocalizer
from baselines.starts import starts
from scene.geometry.pose import Pose
from scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from scene.maps.sparse_map import SparseMap
from scene.runtime.memory import return_freed_above
from scene.storage.lru_cache import MEGABYTE
from scene.storage.scratch import scratch

_UNCLEAR: Final = "no place of the map fits the image clearly"


class OtherFinder(Protocol):
    """Finds places of a map where a query may be, in another way than the search.

    Attributes:
        is_first: once prepared, whether it is asked before the search, or where that fails.
    """

    is_first: bool

    def prepare(self, sparse_map: SparseMap, images: Path, key: str, cache: Path) -> None:
        """Prepare for a map; ``key`` identifies the network, ``cache`` keeps files."""
        ...

    def find(self, query: Query) -> list[Candidate]:
        """Return places, best first."""
        ...


class FeaturemetricLocalizer:
    """Localizes images by alignment. Implements ``scene.localizer.Localizer``.

    Args:
        name: of the method.
        network: the trained network.
        weights_sha256: digest of its weights.
        config: options of the method.
        other: finds places too, before the search or after it.
    """

    def __init__(
        self,
        name: str,
        network: Network,
        weights_sha256: str,
        config: FeaturemetricConfig,
        other: OtherFinder | None = None,
    ) -> None:
        self.name = name
        self.weights_sha256: str | None = weights_sha256
        self.config = config
        self._extract = MapExtractor(network, config.longest, config.precision)
        self._damping = [factors().detach() for factors in network.damping]
        self._other = other

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Compute the features of the map's points in its photographs, unless they are cached."""
        if cache is None:
            with scratch() as folder:  # files stay open
                self.prepare(sparse_map, images, folder)
            return
        config = self.config
        self._map = sparse_map
        cameras = [image.camera for image in sparse_map.images.values()]
        pass_mb = self._extract.pass_megabytes(cameras, config.max_magnification)
        self._kept_mb = max(1, config.memory_mb - pass_mb)
        self._matches: SiftLocalizer | None = None  # first: it takes more memory than the rest
        if config.multistart and config.matches is not None:
            least_mb = min(self._kept_mb, config.matches.memory_mb)
            of_matches = config.matches.model_copy(update={"memory_mb": least_mb})
            self._matches = matcher(of_matches, sparse_map, images, cache)
        source = ReferenceSource(
            sparse_map,
            images,
            self._extract,
            f"{self.weights_sha256} {config.longest} {config.precision}",
            self.name,
            config.points,
            config.corners,
            config.reference,
            config.corner,
        )
        self._observations = references(source, cache, self._kept_mb)
        solver = Options(**config.solver.model_dump(), iterations=config.iterations)
        self._problems = ProblemBuilder(
            self._extract,
            self._observations,
            self._damping,
            solver,
            config.reference,
            Levelling.of(sparse_map, config.most_tilt_deg),
        )
        options = config.tracking
        self._tracking = (
            None if options is None else Tracking(self._problems, config.search, options)
        )
        # The coarsest features tell places apart: nothing else need be extracted to find similar
        # photographs.
        described = OnDemand(self._observations.coarse, len(self._observations))
        self._retrieval = References.build(sparse_map, described, config.retrieval)
        if config.multistart and config.place.candidates:
            self._places = PlaceFinder(self._extract, config.place)
            self._places.prepare(sparse_map, images, source.extractor_key, cache)
        if config.multistart and self._other is not None:
            self._other.prepare(sparse_map, images, source.extractor_key, cache)

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Choose references and starts, align the image from each, and return the best pose."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._least_side(query)) < LEAST_SIDE:
            reason = f"the image is {side} pixels wide or high, {LEAST_SIDE} are needed"
            return Estimate(Status.FAILED, reason=reason)
        return_freed_above(self._kept_mb * MEGABYTE)
        clock = Stopwatch()
        if (followed := self._followed(query, clock)) is not None:
            return followed
        lost = self.config.multistart and query.references is None and not says_all(query.prior)
        matched = self._matched(query, clock) if lost else None
        attempts: list[Attempt] = []
        if matched is not None and matched.cam_from_world is not None:
            options, start = self.config.search, matched.cam_from_world
            if matched.inliers >= options.matched_answer_inliers:
                return replace(matched, seconds=clock.seconds)
            around = SearchRadius(options.matched_radius_m, options.matched_radius_deg)
            attempt = self._attempt_near(query, start, clock, around)
            if matched.inliers >= options.matched_accept_inliers:
                if attempt.reason or not stayed_near(attempt.pose, start, options):
                    return replace(matched, seconds=clock.seconds)
                return self._estimate([attempt], [start], clock)
            if attempt.fit < options.place_accept_fit:
                return self._estimate([attempt], [start], clock)
            attempts = [attempt]
        other = self._other if lost and not says_where(query.prior) else None
        if other is not None and other.is_first:
            tried, accepted = self._at_places_of(other, query, clock)
            if accepted:
                return self._estimate(tried, accepted, clock)
            attempts += tried
        places = self._found_places(query, clock) if lost else []
        if places:
            attempts = self._attempts_at_places(query, attempts, places, clock)
        if other is not None and not other.is_first and all(each.reason for each in attempts):
            tried, accepted = self._at_places_of(other, query, clock)
            if accepted:
                return self._estimate(tried, accepted, clock)
        if places:
            return self._estimate(attempts, [place.pose for place in places], clock)
        with clock.stage("retrieval"):
            chosen = self._chosen(query)
            if not len(chosen):
                return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
            begin = starts(query.prior, self._map, chosen, self.config.starts)
        return self._estimate(self._attempts(query, chosen, begin, clock), begin, clock)

    def _estimate(
        self, attempts: Sequence[Attempt], begin: Sequence[Pose], clock: Stopwatch
    ) -> Estimate:
        """Return the best of some attempts; where none is accepted, the first start."""
        return estimated(attempts, begin, self.config.search, clock)

    def _followed(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose near the one that the images before predict; None if unconfirmed."""
        if self._tracking is None or not query.tracked or not says_all(query.prior):
            return None
        attempt = self._tracking(query, self._chosen(query), clock)
        if attempt is None:
            return None
        return replace(self._estimate([attempt], [attempt.pose], clock), tracked=True)

    def _matched(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose that matches of local features give."""
        if self._matches is None:
            return None
        with clock.stage("matches"):
            return self._matches.localize(query)

    def _found_places(self, query: Query, clock: Stopwatch) -> list[Candidate]:
        """Return the starts of the place search, or of the photographs that look most like it."""
        count = self.config.place.candidates
        if not count:
            return []
        with clock.stage("place"):
            places = self._places.find(query)
        if places or says_where(query.prior):
            return places
        with clock.stage("retrieval"):
            begin = starts(query.prior, self._map, self._chosen(query), self.config.starts)
        return [Candidate(pose, 0.0) for pose in begin[:count]]

    def _at_places_of(
        self, finder: OtherFinder, query: Query, clock: Stopwatch
    ) -> tuple[list[Attempt], list[Pose]]:
        """Try the places of another finder until one fits well; return it, or none, last."""
        with clock.stage("objects"):
            places = finder.find(query)
        attempts: list[Attempt] = []
        for place in places:
            tried = self._at_place(query, place, self.config.search.place_accept_fit, clock)
            if len(tried) > 1:
                return tried, [place.pose]
            attempts += tried
        return attempts, []

    def _attempts_at_places(
        self,
        query: Query,
        before: Sequence[Attempt],
        places: Sequence[Candidate],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try the starts of the place search until the fit of one is good enough to stop.

        The image is then aligned once more from there: it is turned and scaled better. A fit that
        says less is accepted only where starts at two places lead to one pose, or where no other
        place fits nearly as well: among many places one fits better than by chance.
        """
        options = self.config.search
        attempts = list(before)
        enough = [options.place_accept_fit] * len(places)
        if not places[1:] or places[0].score - places[1].score > options.first_margin:
            enough[0] = options.first_accept_fit
        for place, least in zip(places, enough, strict=True):
            tried = self._at_place(query, place, least, clock)
            if len(tried) > 1:
                return tried
            attempts += tried
        clear = [is_clear(row, attempts, options) for row in range(len(attempts))]
        return [
            attempt if attempt.reason or fine else replace(attempt, reason=_UNCLEAR)
            for attempt, fine in zip(attempts, clear, strict=True)
        ]

    def _at_place(
        self, query: Query, place: Candidate, least: float, clock: Stopwatch
    ) -> list[Attempt]:
        """Align the image at a place, and where it fits better than ``least``, once more."""
        radius = default_radius(self.config.search)
        attempt = self._attempt_near(query, place.pose, clock, radius)
        if attempt.fit < least:
            return [attempt, self._attempt_near(query, attempt.pose, clock, radius)]
        return [attempt]

    def _attempts(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts place by place, until the fit of one is good enough to stop.

        Where there were several starts, the image is then aligned once more from the best pose:
        seen from there it is turned and scaled better.
        """
        options = self.config.search
        radius = search_radius(query.prior, options)
        attempts: list[Attempt] = []
        by_place = groupby(begin, lambda start: start.centre().round(decimals=6).tolist())
        for _, at_place in by_place:
            attempts += [self._attempt(query, chosen, start, clock, radius) for start in at_place]
            best = min(attempts, key=lambda attempt: attempt.fit)
            if best.fit < options.stop_fit:
                if len(begin) > 1:
                    near = default_radius(options)
                    attempts.append(self._attempt_near(query, best.pose, clock, near))
                break
        return attempts

    def _attempt_near(
        self, query: Query, start: Pose, clock: Stopwatch, radius: SearchRadius
    ) -> Attempt:
        """Align the image from a start that says more than the query's own prior."""
        near = replace(query, prior=known_pose(start))
        return self._attempt(near, self._chosen(near), start, clock, radius)

    def _attempt(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        start: Pose,
        clock: Stopwatch,
        radius: SearchRadius,
    ) -> Attempt:
        """Warp the image as if a start were right, and align it."""
        return_freed_above(self._kept_mb * MEGABYTE)
        options, points = self.config.search, self.config.points
        with clock.stage("features"):
            view, maps = self._problems.view(query, chosen, start)
        many = self.config.multistart
        count = min(options.compared_points, points) if many else points
        with clock.stage("points"):
            problem = self._problems.build(view, maps, chosen, start, count)
        with clock.stage("alignment"):
            if many:
                few = problem.at_levels(slice(options.compared_levels))
                found = Found(view, problem, align_from_many(few, radius, options.hypotheses))
            else:
                found = Found(view, problem, align(problem, with_covariance=False))
        if many and not found.alignment.failed[0]:
            found = self._realigned(query, maps, found, clock)
        with clock.stage("alignment"):
            return judged(found, options)

    def _realigned(
        self, query: Query, maps: list[FeatureMap], found: Found, clock: Stopwatch
    ) -> Found:
        """Align once more, to all points in view from the aligned pose.

        A start far off saw other points and photographs. Images coarser than these are magnified
        only now: a search reaches less far in a larger picture, and takes longer.
        """
        view, most = found.view, self.config.max_magnification
        pose = photograph_pose(view, found.alignment)
        chosen = self._chosen(replace(query, prior=known_pose(pose)))
        larger = self._problems.magnified(query, chosen, pose, view, most)
        if larger is not None:
            with clock.stage("features"):
                view, maps = larger, self._problems.features(larger)
        with clock.stage("alignment"):
            after = self._problems.build(view, maps, chosen, pose, self.config.points)
            # The coarsest level has no more to say of a pose that a finer one of it found.
            skipped = larger is None and len(after.levels) > 1
            final = align(after.finer() if skipped else after, with_covariance=False)
        if final.failed[0]:
            return found
        iterations = found.alignment.iterations + final.iterations
        return Found(view, after, replace(final, iterations=iterations))

    def _chosen(self, query: Query) -> NDArray[np.int64]:
        """Return the rows of the photographs to align a query to.

        SIFT features tell which look most like it: those of the network were learned from above.
        """
        if self._matches is not None and query.references is None and not says_where(query.prior):
            return self._matches.similar(query, self.config.references)
        return self._retrieval.choose(
            query, self.config.references, lambda: self._described(query), tilted=False
        )

    def _least_side(self, query: Query) -> int:
        """Return the shorter side (px) of the image at the largest scale the network sees."""
        camera = query.camera
        return round(min(camera.width, camera.height) * self._extract.largest_scale(camera))

    def _described(self, query: Query) -> NDArray[np.float32]:
        """Return unit features (n, C) of all coarse cells of the image as it was taken."""
        _, maps = self._extract(query.image, query.camera, levels=1)
        cells = maps[0].features[0].flatten(1).T.float()
        return torch.nn.functional.normalize(cells, dim=1).numpy()
