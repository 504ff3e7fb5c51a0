"""Localization by featuremetric alignment, after PixLoc (Sarlin et al., CVPR 2021).

It is one pipeline for every network with features at several strides; a method is a network and a
configuration. Unlike PixLoc's code, it computes features of the map's photographs once in
``prepare``, warps photographs north up and to one resolution, rejects steps that raise the cost,
and gives the pose a covariance.
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
    is_accepted,
    is_probable,
    select_estimate,
    select_likeliest,
)
from objconnect.localization.featuremetric.global_search import (
    MATCHES_RADIUS,
    CandidateFinder,
    GlobalSearch,
    is_sure_match,
)
from objconnect.localization.featuremetric.maps import MapExtractor, Network
from objconnect.localization.featuremetric.matched_finder import MatchedFinder
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
from objconnect.localization.initial_poses import list_initial_poses, source_of_initial_poses
from objconnect.localization.matching.retrieval import NO_REFERENCE, LazyDescriptors, References
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import (
    Estimate,
    MapPart,
    PoseSource,
    Query,
    Status,
    Stopwatch,
    query_error,
)
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.progress import progress_within
from objconnect.scene.runtime.tuning import freeze_objects, trim_heap, trim_heap_above
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.lru_cache import MEGABYTE

# Maximum number of steps per level; nearly all successful queries take fewer.
_SOLVER: Final = Options(iterations=100)
# The heap is trimmed before a query if resident memory has grown since the preparation by more than
# this (MB). Trimming makes the next pass of the network a tenth slower.
_RETURN_FREED_MB: Final = 290


class FeaturemetricLocalizer:
    """Localizes images by alignment. Implements ``objconnect.scene.localizer.Localizer``.

    Args:
        name: name of the method.
        network: the trained network.
        weights_sha256: digest of its weights.
        config: options of the method.
        extra_finder: finds candidates in addition to the coarse search; None for none.

    Attributes:
        matched_finder: finds initial poses by the method of the option ``search.matcher``.
            ``objconnect.methods.create`` sets it, because this package imports no other methods.

    Raises:
        InputError: this processor cannot run the network quantized, an option has no effect with
            the other options, or a calibration file beside the weights is damaged.
    """

    def __init__(
        self,
        name: str,
        network: Network,
        weights_sha256: str,
        config: FeaturemetricConfig,
        extra_finder: CandidateFinder | None = None,
    ) -> None:
        if config.quantized:
            assert isinstance(network, nn.Module)
            require_quantizable(network)
        config = config.drop_ineffective().with_calibration()
        assert config.search.acceptance is not None
        self.name = name
        self._network_sha256 = weights_sha256
        self.matched_finder: MatchedFinder | None = None
        self.config = config
        self._extract = MapExtractor(network, config.longest, config.precision)
        self._acceptance: AcceptanceModel = config.search.acceptance
        self._damping = [factors().detach() for factors in network.damping]
        self._extra_finder = extra_finder

    @property
    def weights_sha256(self) -> str | None:
        """Return the digest of the network's weights, together with that of ``search.matcher``."""
        if self.matched_finder is None:
            return self._network_sha256
        return sha256(self._network_sha256, self.matched_finder.weights_sha256 or "")

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Compute the features of the map's points in its photographs, unless they are cached."""
        with open_cache(sparse_map, images, cache) as map_cache:
            self._prepare_matches(map_cache)
            self._preparation()

    @property
    def map_state(self) -> MapState:
        """Return the map's data for alignment; prepare them now if that was deferred."""
        return self._preparation()

    def prepare_lazily(self, sparse_map: SparseMap, images: Path, cache: Path) -> None:
        """Prepare matches and defer alignment; see ``objconnect.scene.localizer.PreparesLazily``.

        Without matches nothing is deferred, because every query needs the alignment.
        """
        self._prepare_matches(MapCache.of(sparse_map, images, cache))

    def _prepare_matches(self, map_cache: MapCache) -> None:
        """Prepare matches; prepare alignment too if there are no matches, else defer it."""
        config, self._map = self.config, map_cache.sparse_map
        available_mb = self._memory_left_mb(config.max_magnification)
        # Matches are prepared first, because they take more memory than the rest.
        self._matches = None
        if config.multistart and config.matches is not None:
            memory_mb = min(available_mb, config.matches.memory_mb)
            matches_config = config.matches.model_copy(update={"memory_mb": memory_mb})
            self._matches = prepare_matcher(matches_config, map_cache)
        self._preparation = Preparation(partial(self._prepare_alignment, map_cache, available_mb))
        if self._matches is None:
            self._preparation()
            return
        self._release_freed_memory()

    def _prepare_alignment(self, map_cache: MapCache, available_mb: int) -> MapState:
        """Prepare alignment; ``available_mb`` is the memory left beside a pass of the network."""
        config, sparse_map = self.config, map_cache.sparse_map
        source = self._source(map_cache)
        extra_finder = self._extra_finder if config.multistart else None
        observer = None if extra_finder is None else extra_finder.observer(source)
        observations = load_references(source, available_mb, observer)
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
        # Retrieval uses the coarsest features, so that no other network has to run.
        descriptors = LazyDescriptors(observations.read_coarse, len(observations))
        retrieval = References.build(sparse_map, descriptors)
        refine = Refiner(
            config,
            extract,
            problems,
            retrieval,
            self._matches,
            self._memory_left_mb(1.0) * MEGABYTE,
            available_mb * MEGABYTE,
        )
        coarse = None
        if config.multistart and config.place.candidates:
            coarse = CoarseSearch(self._extract, config.place)
            coarse.prepare(map_cache, source.extractor_key)
        if extra_finder is not None:
            extra_finder.prepare(source)
        if self.matched_finder is not None:
            self.matched_finder.prepare(map_cache)
        self._release_freed_memory()
        search = GlobalSearch(refine, sparse_map, coarse, extra_finder, self.matched_finder)
        return MapState(refine, search, tracking)

    def _release_freed_memory(self) -> None:
        """Return freed memory to the system, and set the memory above which queries return it."""
        freeze_objects()
        trim_heap()
        self._trim_above_bytes = resident_bytes() + _RETURN_FREED_MB * MEGABYTE

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Fill the cache for a part of the photographs; see ``PreparesParts``."""
        config = self.config
        if config.multistart and config.matches is not None:
            create_matcher(config.matches).prepare_part(sparse_map, images, cache, part)
        source = self._source(MapCache.of(sparse_map, images, cache, part))
        extra_finder = self._extra_finder if config.multistart else None
        write_part(source, None if extra_finder is None else extra_finder.observer(source))
        if self.matched_finder is not None:
            self.matched_finder.prepare_part(source.map_cache, part)

    def _source(self, map_cache: MapCache) -> ReferenceSource:
        """Return the inputs of the reference features of a map."""
        config = self.config
        return ReferenceSource(
            map_cache,
            self._extract,
            f"{self._network_sha256} {config.longest} {config.precision}",
            self.name,
            corners=config.corners,
        )

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Choose reference images and initial poses, align from each, and return the best."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._compute_shorter_side(query)) < LEAST_SIDE:
            reason = (
                f"the shorter side of the image is {side} pixels if the longer side is limited to "
                f"{self.config.longest}; at least {LEAST_SIDE} are needed"
            )
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        if (tracked := self._track(query, clock)) is not None:
            return tracked
        trim_heap_above(self._trim_above_bytes)
        if self._needs_search(query) and (found := self._search(query, clock)) is not None:
            return found
        refine = self._preparation.prepare_for_query(clock).refine
        with clock.stage("retrieval"):
            reference_rows = refine.choose_references(query)
            if not len(reference_rows):
                return Estimate(Status.FAILED, seconds=clock.seconds, reason=NO_REFERENCE)
            poses = list_initial_poses(
                query.prior, self._map, reference_rows, self.config.same_place_m
            )
        attempts = self._make_attempts(refine, query, reference_rows, poses, clock)
        if not is_accepted(attempts, self.config.search):
            attempts += self._try_matched(refine, query, clock)
        return select_estimate(
            attempts, poses, source_of_initial_poses(query.prior), self.config.search, clock
        )

    def _needs_search(self, query: Query) -> bool:
        """Return whether the prior is incomplete, so that the map is searched."""
        return self.config.multistart and query.references is None and not has_pose(query.prior)

    def _search(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose from matches if ``is_sure_match``, else from a global search; None if
        the global search gives none."""
        matched = None
        if self._matches is not None:
            with clock.stage("matches"):
                matched = self._acceptance.rate(self._matches.localize(query))
            if is_sure_match(matched, self.config.search):
                return replace(matched, seconds=clock.seconds)
        return self._preparation.prepare_for_query(clock).search(query, matched, clock)

    def _track(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose aligned from the predicted pose of a sequence; None if the query has no
        prediction or the pose is not accepted."""
        if self.config.tracking is None or not query.tracked or not has_pose(query.prior):
            return None
        prepared = self._preparation.prepare_for_query(clock)
        assert prepared.tracking is not None
        attempt = prepared.tracking(query, prepared.refine.choose_references(query), clock)
        if attempt is None:
            return None
        found = select_estimate(
            [attempt], [attempt.pose], PoseSource.TRACKING, self.config.search, clock
        )
        return replace(found, by=PoseSource.TRACKING)

    def _make_attempts(
        self,
        refine: Refiner,
        query: Query,
        reference_rows: NDArray[np.int64],
        poses: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts; if none gives an answer, search once more with more hypotheses and points.

        With a complete prior, the second search begins at the same starts; else at the likeliest
        pose, if its probability exceeds ``search.risk``.

        Args:
            refine: refines a start.
            query: the image.
            reference_rows: rows of its reference images.
            poses: starts, ``cam_from_world``.
            clock: sums the seconds of each stage.
        """
        options = self.config.search
        attempts = self._try_starts(refine, query, reference_rows, poses, clock)
        is_single_search = not self.config.multistart or options.again == 1
        if is_single_search or is_accepted(attempts, options):
            return attempts
        thorough = refine.widen(options.again)
        if has_pose(query.prior):
            return attempts + self._try_starts(thorough, query, reference_rows, poses, clock)
        best, probability = select_likeliest(attempts)
        if probability > options.risk:
            attempts.append(thorough.align_near(self._prepare_near(query), best.pose, clock))
        return attempts

    def _searches_position(self, query: Query) -> bool:
        """Return whether the position of the query is unknown and the method searches for it."""
        return self.config.multistart and not has_position(query.prior)

    def _prepare_near(self, query: Query) -> Query:
        """Return the query for an alignment near a pose.

        If the query's reference images only gave the start, others near the pose replace them.
        """
        return replace(query, references=None) if self._searches_position(query) else query

    def _try_starts(
        self,
        refine: Refiner,
        query: Query,
        reference_rows: NDArray[np.int64],
        poses: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts position by position, until a pose is probable.

        If there are several starts or the position is unknown, the image is then aligned once more
        from the likeliest pose. Warped from that pose, it is rotated and scaled better.
        """
        options, radius = self.config.search, search_radius(query.prior)
        attempts: list[Attempt] = []
        by_position = groupby(poses, lambda start: start.centre().round(decimals=6).tolist())
        with progress_within("starts aligned", len(poses)) as advance:
            for _, at_position in by_position:
                for start in at_position:
                    attempts.append(refine(query, reference_rows, start, clock, radius))
                    advance(len(attempts))
                if is_probable(attempts, options):
                    if len(poses) > 1 or self._searches_position(query):
                        best, _ = select_likeliest(attempts)
                        attempts.append(
                            refine.align_near(self._prepare_near(query), best.pose, clock)
                        )
                    break
        return attempts

    def _try_matched(self, refine: Refiner, query: Query, clock: Stopwatch) -> list[Attempt]:
        """Align from the pose by the method ``search.matcher``, unless a search has done so."""
        if self.matched_finder is None or self._needs_search(query):
            return []
        with clock.stage("matcher"):
            found = self.matched_finder.find(query)
        near = self._prepare_near(query)
        return [refine.align_near(near, each.pose, clock, MATCHES_RADIUS) for each in found]

    def _memory_left_mb(self, max_magnification: float) -> int:
        """Return how much of ``memory_mb`` is left beside a pass of the network, MB.

        Args:
            max_magnification: largest factor by which the pass enlarges a photograph.
        """
        cameras = (image.camera for image in self._map.images.values())
        return max(
            1, self.config.memory_mb - self._extract.pass_megabytes(cameras, max_magnification)
        )

    def _compute_shorter_side(self, query: Query) -> int:
        """Return the shorter side (px) of the image after its longer side is limited."""
        camera = query.camera
        return round(min(camera.width, camera.height) * self._extract.largest_scale(camera))
