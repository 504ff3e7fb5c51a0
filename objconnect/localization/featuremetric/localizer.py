"""Localization by featuremetric alignment, after PixLoc (Sarlin et al., CVPR 2021).

It is one pipeline for every network with features at several strides; a method is a network and a
configuration. Unlike in the authors' code, features of the map's photographs are computed once in
``prepare``, photographs are warped north up and to one resolution, steps that raise the cost are
rejected, and the pose has a covariance.
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
from objconnect.localization.coarse.finder import CoarseSearch
from objconnect.localization.featuremetric.acceptance import AcceptanceModel
from objconnect.localization.featuremetric.attempt import (
    Attempt,
    best_of,
    is_answered,
    is_believed,
    select_estimate,
)
from objconnect.localization.featuremetric.global_search import (
    CandidateFinder,
    GlobalSearch,
    is_answer,
)
from objconnect.localization.featuremetric.maps import MapExtractor, Network
from objconnect.localization.featuremetric.matcher import create_matcher, prepare_matcher
from objconnect.localization.featuremetric.options import FeaturemetricConfig
from objconnect.localization.featuremetric.prepared import MapState, Preparation
from objconnect.localization.featuremetric.priors import has_pose, has_position, search_radius
from objconnect.localization.featuremetric.problem import LEAST_SIDE, Levelling, ProblemBuilder
from objconnect.localization.featuremetric.quantized import quantize_extractor
from objconnect.localization.featuremetric.references import (
    ReferenceSource,
    load_references,
    write_part,
)
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

# Maximum number of steps per level; nearly all successful queries take fewer.
_SOLVER: Final = Options(iterations=100)
# Trim the heap before a query if resident memory exceeds that of the prepared map by so much (MB).
# Trimming makes the next pass of the network a tenth slower.
_RETURN_FREED_MB: Final = 290


class FeaturemetricLocalizer:
    """Localizes images by alignment. Implements ``objconnect.scene.localizer.Localizer``.

    Args:
        name: name of the method.
        network: the trained network.
        weights_sha256: digest of its weights.
        config: options of the method.
        other: a finder of candidates beside the coarse search; None for none.

    Raises:
        InputError: this processor cannot run the network quantized, or a calibration file beside
            the weights is damaged.
    """

    def __init__(
        self,
        name: str,
        network: Network,
        weights_sha256: str,
        config: FeaturemetricConfig,
        other: CandidateFinder | None = None,
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
    def map_state(self) -> MapState:
        """Return the parts of the map that alignment needs; prepare them if that was deferred."""
        return self._preparation()

    def prepare_first(self, sparse_map: SparseMap, images: Path, cache: Path) -> None:
        """Prepare matches and defer alignment; see ``objconnect.scene.localizer.PreparesLater``.

        Without matches nothing is deferred, because every query needs the alignment.
        """
        self._prepare_matches(MapCache.of(sparse_map, images, cache))

    def _prepare_matches(self, kept: MapCache) -> None:
        config, self._map = self.config, kept.sparse_map
        kept_mb = self._memory_left_mb(config.max_magnification)
        self._matches = None  # first: it takes more memory than the rest
        if config.multistart and config.matches is not None:
            least_mb = min(kept_mb, config.matches.memory_mb)
            of_matches = config.matches.model_copy(update={"memory_mb": least_mb})
            self._matches = prepare_matcher(of_matches, kept)
        self._preparation = Preparation(partial(self._prepare_rest, kept, kept_mb))
        if self._matches is None:
            self._preparation()
            return
        self._settle()

    def _prepare_rest(self, kept: MapCache, kept_mb: int) -> MapState:
        """Prepare alignment; ``kept_mb`` is the memory left beside a pass of the network."""
        config, sparse_map = self.config, kept.sparse_map
        source = self._source(kept)
        other = self._other if config.multistart else None
        watch = None if other is None else other.observer(source)
        observations = load_references(source, kept_mb, watch)
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
        # The coarsest features serve for retrieval, too: no other network runs.
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
        coarse = None
        if config.multistart and config.place.candidates:
            coarse = CoarseSearch(self._extract, config.place)
            coarse.prepare(kept, source.extractor_key)
        if other is not None:
            other.prepare(source)
        self._settle()
        return MapState(refine, GlobalSearch(refine, sparse_map, coarse, other), tracking)

    def _settle(self) -> None:
        """Release memory that preparing freed, and record the memory that queries start with."""
        spare_collector()
        trim_heap()
        self._most_bytes = resident_bytes() + _RETURN_FREED_MB * MEGABYTE

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Fill the cache for a part of the photographs; see ``PreparesParts``."""
        config = self.config
        if config.multistart and config.matches is not None:
            create_matcher(config.matches).prepare_part(sparse_map, images, cache, part)
        source = self._source(MapCache.of(sparse_map, images, cache, part))
        other = self._other if config.multistart else None
        write_part(source, None if other is None else other.observer(source))

    def _source(self, kept: MapCache) -> ReferenceSource:
        """Return the inputs of the reference features of a map."""
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
        """Choose reference images and starts, align the image from each, and return the best."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._least_side(query)) < LEAST_SIDE:
            reason = f"the image has a side of {side} pixels; at least {LEAST_SIDE} are needed"
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
        """Return whether the prior is incomplete, so that the map is searched."""
        return self.config.multistart and query.references is None and not has_pose(query.prior)

    def _search(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose by matches if they are sure, else by a global search; None without a
        candidate."""
        matched = None
        if self._matches is not None:
            with clock.stage("matches"):
                matched = self._acceptance.rate(self._matches.localize(query))
            if is_answer(matched, self.config.search):
                return replace(matched, seconds=clock.seconds)
        return self._preparation.in_query(clock).search(query, matched, clock)

    def _follow(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose near the predicted one of a sequence; None if it is not believed."""
        if self.config.tracking is None or not query.tracked or not has_pose(query.prior):
            return None
        prepared = self._preparation.in_query(clock)
        assert prepared.tracking is not None
        attempt = prepared.tracking(query, prepared.refine.photographs(query), clock)
        if attempt is None:
            return None
        begin, options = [attempt.pose], self.config.search
        found = select_estimate([attempt], begin, By.TRACKING, options, clock)
        return replace(found, by=By.TRACKING)

    # More than six parameters: every refinement of a start needs them.
    def _attempts(
        self,
        refine: Refiner,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts; if none gives an answer, try once more with more starts and points.

        With a complete prior, the second search begins at the same starts; else at the likeliest
        pose, if its probability exceeds the risk.
        """
        options = self.config.search
        attempts = self._try_starts(refine, query, chosen, begin, clock)
        enough = not self.config.multistart or options.again == 1
        if enough or is_answered(attempts, options):
            return attempts
        thorough = refine.wider(options.again)
        if has_pose(query.prior):
            return attempts + self._try_starts(thorough, query, chosen, begin, clock)
        best, probability = best_of(attempts)
        if probability > options.risk:
            attempts.append(thorough.near(self._near_query(query), best.pose, clock))
        return attempts

    def _has_no_position(self, query: Query) -> bool:
        """Return whether the method searches for a query without a position."""
        return self.config.multistart and not has_position(query.prior)

    def _near_query(self, query: Query) -> Query:
        """Return the query without the reference images it names if these only gave the start."""
        return replace(query, references=None) if self._has_no_position(query) else query

    def _try_starts(
        self,
        refine: Refiner,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts position by position, until one is believed.

        If there were several starts or no known position, the image is aligned once more from the
        best pose: warped from there, it is rotated and scaled better.
        """
        options, radius = self.config.search, search_radius(query.prior)
        attempts: list[Attempt] = []
        by_position = groupby(begin, lambda start: start.centre().round(decimals=6).tolist())
        with progress_within("starts aligned", len(begin)) as advance:
            for _, at_position in by_position:
                for start in at_position:
                    attempts.append(refine(query, chosen, start, clock, radius))
                    advance(len(attempts))
                if is_believed(attempts, options):
                    if len(begin) > 1 or self._has_no_position(query):
                        best, _ = best_of(attempts)
                        attempts.append(refine.near(self._near_query(query), best.pose, clock))
                    break
        return attempts

    def _memory_left_mb(self, magnification: float) -> int:
        """Return the rest of ``memory_mb`` beside a pass of the network with a magnification."""
        cameras = (image.camera for image in self._map.images.values())
        return max(1, self.config.memory_mb - self._extract.pass_megabytes(cameras, magnification))

    def _least_side(self, query: Query) -> int:
        """Return the shorter side (px) of the image at the largest scale the network uses."""
        camera = query.camera
        return round(min(camera.width, camera.height) * self._extract.largest_scale(camera))
