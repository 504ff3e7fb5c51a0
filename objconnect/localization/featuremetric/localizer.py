"""Localization by alignment: where the image looks like the map's points do in near photographs.

One pipeline for every network with features at several strides; a method is a network and a
configuration. After PixLoc (Sarlin et al., CVPR 2021). Differently from their code, features of the
photographs are kept from ``prepare`` on, photographs are seen north up and at one resolution,
steps that make the cost larger are not taken, and the pose has a covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from objconnect.learning.quantization import require_quantizable
from objconnect.localization.align.options import Options
from objconnect.localization.cache.map_cache import MapCache, open_cache
from objconnect.localization.coarse.finder import PlaceFinder
from objconnect.localization.featuremetric.acceptance import AcceptanceModel
from objconnect.localization.featuremetric.attempt import (
    Attempt,
    best_of,
    is_answered,
    is_believed,
    select_estimate,
)
from objconnect.localization.featuremetric.global_search import GlobalSearch, OtherFinder, is_answer
from objconnect.localization.featuremetric.maps import MapExtractor, Network
from objconnect.localization.featuremetric.matcher import create_matcher, matcher
from objconnect.localization.featuremetric.options import FeaturemetricConfig
from objconnect.localization.featuremetric.prepared import Preparation, Prepared
from objconnect.localization.featuremetric.priors import says_all, says_where, search_radius
from objconnect.localization.featuremetric.problem import LEAST_SIDE, Levelling, ProblemBuilder
from objconnect.localization.featuremetric.quantized import quantize_extractor
from objconnect.localization.featuremetric.references import ReferenceSource, references, write_part
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.featuremetric.tracking import Tracking
from objconnect.localization.matching.retrieval import OnDemand, References
from objconnect.localization.starts import start_of, starts
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import By, Estimate, MapPart, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.runtime.tuning import return_freed_above, spare_collector, trim_heap
from objconnect.scene.storage.lru_cache import MEGABYTE

# Steps per level that are tried: of queries that end well, nearly all take fewer.
_SOLVER: Final = Options(iterations=100)
# A query that begins with so much more memory (MB) than the map took gives back what the queries
# before it freed; a pass that takes it again is a tenth slower.
_RETURN_FREED_MB: Final = 290


class FeaturemetricLocalizer:
    """Localizes images by alignment. Implements ``objconnect.scene.localizer.Localizer``.

    Args:
        name: of the method.
        network: the trained network.
        weights_sha256: digest of its weights.
        config: options of the method.
        other: finds places too, before the search or after it.

    Raises:
        InputError: the network is to be quantized, and cannot be here; or a file of numbers beside
            the weights is damaged.
    """

    def __init__(
        self,
        name: str,
        network: Network,
        weights_sha256: str,
        config: FeaturemetricConfig,
        other: OtherFinder | None = None,
    ) -> None:
        if config.quantized:
            assert isinstance(network, nn.Module)
            require_quantizable(network)
        config = config.with_calibration()
        assert config.search.acceptance is not None
        self.name = name
        self.weights_sha256: str | None = weights_sha256
        self.config = config
        self._extract = MapExtractor(network, config.longest, config.precision)
        self._acceptance: AcceptanceModel = config.search.acceptance
        self._damping = [factors().detach() for factors in network.damping]
        self._other = other

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Compute the features of the map's points in its photographs, unless they are cached."""
        with open_cache(sparse_map, images, cache) as kept:
            self._prepare_matches(kept)
            self._preparation()

    @property
    def map_state(self) -> Prepared:
        """Return what alignment needs of the map, which is made now where it was left."""
        return self._preparation()

    def prepare_first(self, sparse_map: SparseMap, images: Path, cache: Path) -> None:
        """Prepare matches, and leave alignment; see ``objconnect.scene.localizer.PreparesLater``.

        Without matches nothing is left: then every query is aligned.
        """
        self._prepare_matches(MapCache.of(sparse_map, images, cache))

    def _prepare_matches(self, kept: MapCache) -> None:
        config, self._map = self.config, kept.sparse_map
        kept_mb = self._memory_left_mb(config.max_magnification)
        self._matches = None  # first: it takes more memory than the rest
        if config.multistart and config.matches is not None:
            least_mb = min(kept_mb, config.matches.memory_mb)
            of_matches = config.matches.model_copy(update={"memory_mb": least_mb})
            self._matches = matcher(of_matches, kept)
        self._preparation = Preparation(partial(self._prepare_rest, kept, kept_mb))
        if self._matches is None:
            self._preparation()
            return
        self._settle()

    def _prepare_rest(self, kept: MapCache, kept_mb: int) -> Prepared:
        """Prepare what alignment needs; ``kept_mb`` is the memory beside a pass of the network."""
        config, sparse_map = self.config, kept.sparse_map
        source = self._source(kept)
        other = self._other if config.multistart else None
        watch = None if other is None else other.watcher(source)
        observations = references(source, kept_mb, watch)
        extract = self._extract
        if config.quantized:
            extract = quantize_extractor(source)
        problems = ProblemBuilder(
            extract,
            observations,
            sparse_map.centres,
            self._damping,
            _SOLVER,
            Levelling.of(sparse_map, config.most_tilt_deg),
        )
        options = config.tracking
        tracking = None if options is None else Tracking(problems, config.search, options)
        # The coarsest features tell places apart: nothing else need be extracted to find similar
        # photographs.
        described = OnDemand(observations.coarse, len(observations))
        retrieval = References.build(sparse_map, described)
        refine = Refiner(
            config,
            extract,
            problems,
            retrieval,
            self._matches,
            self._memory_left_mb(1.0) * MEGABYTE,
            kept_mb * MEGABYTE,
        )
        places = None
        if config.multistart and config.place.candidates:
            places = PlaceFinder(self._extract, config.place)
            places.prepare(kept, source.extractor_key)
        if other is not None:
            other.prepare(source)
        self._settle()
        return Prepared(refine, GlobalSearch(refine, sparse_map, places, other), tracking)

    def _settle(self) -> None:
        """Give back what preparing took, and note what memory queries begin with."""
        spare_collector()
        trim_heap()
        self._most_bytes = resident_bytes() + _RETURN_FREED_MB * MEGABYTE

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Compute what the cache is to hold of a part; see ``PreparesParts``."""
        config = self.config
        if config.multistart and config.matches is not None:
            create_matcher(config.matches).prepare_part(sparse_map, images, cache, part)
        source = self._source(MapCache.of(sparse_map, images, cache, part))
        other = self._other if config.multistart else None
        write_part(source, None if other is None else other.watcher(source))

    def _source(self, kept: MapCache) -> ReferenceSource:
        """Return what references of a map are computed from."""
        config = self.config
        return ReferenceSource(
            kept,
            self._extract,
            f"{self.weights_sha256} {config.longest} {config.precision}",
            self.name,
            corners=config.corners,
        )

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Choose references and starts, align the image from each, and return the best pose."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._least_side(query)) < LEAST_SIDE:
            reason = f"the image is {side} pixels wide or high, {LEAST_SIDE} are needed"
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        if (followed := self._follow(query, clock)) is not None:
            return followed
        return_freed_above(self._most_bytes)
        if self._is_searched(query) and (found := self._search(query, clock)) is not None:
            return found
        refine = self._preparation.in_query(clock).refine
        with clock.stage("retrieval"):
            chosen = refine.photographs(query)
            if not len(chosen):
                return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
            begin = starts(query.prior, self._map, chosen, self.config.same_place_m)
        attempts = self._attempts(refine, query, chosen, begin, clock)
        return select_estimate(attempts, begin, start_of(query.prior), self.config.search, clock)

    def _is_searched(self, query: Query) -> bool:
        """Return whether the pose of an image is searched for, of which no prior says all."""
        return self.config.multistart and query.references is None and not says_all(query.prior)

    def _search(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose by matches where they are sure, else by a search; None where nothing says
        where to look."""
        matched = None
        if self._matches is not None:
            with clock.stage("matches"):
                matched = self._acceptance.rate(self._matches.localize(query))
            if is_answer(matched, self.config.search):
                return replace(matched, seconds=clock.seconds)
        return self._preparation.in_query(clock).search(query, matched, clock)

    def _follow(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose near the one that the images before predict; None if unconfirmed."""
        if self.config.tracking is None or not query.tracked or not says_all(query.prior):
            return None
        prepared = self._preparation.in_query(clock)
        assert prepared.tracking is not None
        attempt = prepared.tracking(query, prepared.refine.photographs(query), clock)
        if attempt is None:
            return None
        begin, options = [attempt.pose], self.config.search
        found = select_estimate([attempt], begin, By.TRACKING, options, clock)
        return replace(found, by=By.TRACKING)

    # More than six parameters: they are what every way to refine a start takes.
    def _attempts(
        self,
        refine: Refiner,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts; where no answer is believed, search once more and thoroughly.

        Around a known pose, that search begins at the same starts; else at the likeliest pose, if
        its probability is above the risk.
        """
        options = self.config.search
        attempts = self._try_starts(refine, query, chosen, begin, clock)
        enough = not self.config.multistart or options.again == 1
        if enough or is_answered(attempts, options):
            return attempts
        thorough = refine.wider(options.again)
        if says_all(query.prior):
            return attempts + self._try_starts(thorough, query, chosen, begin, clock)
        best, probability = best_of(attempts)
        if probability > options.risk:
            attempts.append(thorough.near(self._near_query(query), best.pose, clock))
        return attempts

    def _has_no_position(self, query: Query) -> bool:
        """Return whether a pose is searched for of which no position is known."""
        return self.config.multistart and not says_where(query.prior)

    def _near_query(self, query: Query) -> Query:
        """Return a query near a pose that was found: photographs it names gave but the start."""
        return replace(query, references=None) if self._has_no_position(query) else query

    def _try_starts(
        self,
        refine: Refiner,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts place by place, until one is believed.

        Where there were several starts, or no position is known, the image is then aligned once
        more from the best pose: seen from there it is turned and scaled better.
        """
        options, radius = self.config.search, search_radius(query.prior)
        attempts: list[Attempt] = []
        by_place = groupby(begin, lambda start: start.centre().round(decimals=6).tolist())
        with progress_within("starts aligned", len(begin)) as advance:
            for _, at_place in by_place:
                for start in at_place:
                    attempts.append(refine(query, chosen, start, clock, radius))
                    advance(len(attempts))
                if is_believed(attempts, options):
                    if len(begin) > 1 or self._has_no_position(query):
                        best, _ = best_of(attempts)
                        attempts.append(refine.near(self._near_query(query), best.pose, clock))
                    break
        return attempts

    def _memory_left_mb(self, magnification: float) -> int:
        """Return what is left of ``memory_mb`` beside a pass of images magnified so much."""
        cameras = (image.camera for image in self._map.images.values())
        return max(1, self.config.memory_mb - self._extract.pass_megabytes(cameras, magnification))

    def _least_side(self, query: Query) -> int:
        """Return the shorter side (px) of the image at the largest scale the network sees."""
        camera = query.camera
        return round(min(camera.width, camera.height) * self._extract.largest_scale(camera))
