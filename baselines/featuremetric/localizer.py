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

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from baselines.align.options import Options
from baselines.featuremetric.attempt import Attempt, estimated, is_found, is_sure, unclear
from baselines.featuremetric.global_search import GlobalSearch, OtherFinder
from baselines.featuremetric.maps import MapExtractor, Network
from baselines.featuremetric.matcher import matcher
from baselines.featuremetric.options import FeaturemetricConfig
from baselines.featuremetric.priors import says_all, says_where, search_radius
from baselines.featuremetric.problem import LEAST_SIDE, Levelling, ProblemBuilder
from baselines.featuremetric.quantized import quantized_extractor
from baselines.featuremetric.references import ReferenceSource, references, write_part
from baselines.featuremetric.refiner import Refiner
from baselines.featuremetric.tracking import Tracking
from baselines.place.finder import PlaceFinder
from baselines.quantization import require_quantizable
from baselines.retrieval import OnDemand, References
from baselines.sift import SiftLocalizer
from baselines.starts import starts
from scene.geometry.pose import Pose
from scene.localizer import Estimate, MapPart, Query, Status, Stopwatch, query_error
from scene.maps.sparse_map import SparseMap
from scene.runtime.memory import (
    resident_bytes,
    return_freed,
    return_freed_above,
    spare_collector,
)
from scene.storage.lru_cache import MEGABYTE
from scene.storage.scratch import scratch


class FeaturemetricLocalizer:
    """Localizes images by alignment. Implements ``scene.localizer.Localizer``.

    Args:
        name: of the method.
        network: the trained network.
        weights_sha256: digest of its weights.
        config: options of the method.
        other: finds places too, before the search or after it.

    Raises:
        InputError: the network is to be quantized, and cannot be here.
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
        kept_mb = self._kept_mb(config.max_magnification)
        matches = None  # first: it takes more memory than the rest
        if config.multistart and config.matches is not None:
            least_mb = min(kept_mb, config.matches.memory_mb)
            of_matches = config.matches.model_copy(update={"memory_mb": least_mb})
            matches = matcher(of_matches, sparse_map, images, cache)
        source = self._source(sparse_map, images)
        other = self._other if config.multistart else None
        watch = None if other is None else other.watcher(source, cache)
        observations = references(source, cache, kept_mb, watch)
        extract = self._extract
        if config.quantized:
            extract = quantized_extractor(source, config.quantization)
        solver = Options(**config.solver.model_dump(), iterations=config.iterations)
        problems = ProblemBuilder(
            extract,
            observations,
            sparse_map.centres,
            self._damping,
            solver,
            config.reference,
            Levelling.of(sparse_map, config.most_tilt_deg),
        )
        options = config.tracking
        self._tracking = None if options is None else Tracking(problems, config.search, options)
        # The coarsest features tell places apart: nothing else need be extracted to find similar
        # photographs.
        described = OnDemand(observations.coarse, len(observations))
        retrieval = References.build(sparse_map, described, config.retrieval)
        self._refine = Refiner(
            config,
            extract,
            problems,
            retrieval,
            matches,
            self._kept_mb(1.0) * MEGABYTE,
            kept_mb * MEGABYTE,
        )
        places = None
        if config.multistart and config.place.candidates:
            places = PlaceFinder(self._extract, config.place)
            places.prepare(sparse_map, images, source.extractor_key, cache)
        if other is not None:
            other.prepare(source, cache)
        self._search = GlobalSearch(self._refine, sparse_map, places, other)
        spare_collector()
        return_freed()
        self._most_bytes = resident_bytes() + config.return_freed_mb * MEGABYTE

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Compute what the cache is to hold of a part; see ``scene.localizer.PreparesParts``."""
        config = self.config
        if config.multistart and config.matches is not None:
            SiftLocalizer(config.matches).prepare_part(sparse_map, images, cache, part)
        source = self._source(sparse_map, images)
        other = self._other if config.multistart else None
        watch = None if other is None else other.watcher(source, cache, part)
        write_part(source, cache, part, watch)

    def _source(self, sparse_map: SparseMap, images: Path) -> ReferenceSource:
        """Return what references of a map are computed from."""
        config = self.config
        return ReferenceSource(
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

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Choose references and starts, align the image from each, and return the best pose."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._least_side(query)) < LEAST_SIDE:
            reason = f"the image is {side} pixels wide or high, {LEAST_SIDE} are needed"
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        if (followed := self._followed(query, clock)) is not None:
            return followed
        return_freed_above(self._most_bytes)
        unsaid = query.references is None and not says_all(query.prior)
        if self.config.multistart and unsaid and (found := self._search(query, clock)) is not None:
            return found
        with clock.stage("retrieval"):
            chosen = self._refine.photographs(query)
            if not len(chosen):
                return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
            begin = starts(query.prior, self._map, chosen, self.config.starts)
        attempts = self._attempts(query, chosen, begin, clock)
        if self._has_no_position(query):
            options = self.config.search
            attempts = [each if is_found(each, options) else unclear(each) for each in attempts]
        return self._estimate(attempts, begin, clock)

    def _estimate(
        self, attempts: Sequence[Attempt], begin: Sequence[Pose], clock: Stopwatch
    ) -> Estimate:
        """Return the best of some attempts; where none is accepted, the first start."""
        return estimated(attempts, begin, self.config.search, clock)

    def _followed(self, query: Query, clock: Stopwatch) -> Estimate | None:
        """Return the pose near the one that the images before predict; None if unconfirmed."""
        if self._tracking is None or not query.tracked or not says_all(query.prior):
            return None
        attempt = self._tracking(query, self._refine.photographs(query), clock)
        if attempt is None:
            return None
        return replace(self._estimate([attempt], [attempt.pose], clock), tracked=True)

    def _attempts(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts; where no answer is sure, search once more and thoroughly.

        That search begins at the same starts around a known pose, else at the pose that fits best,
        if it fits well enough to stop there.
        """
        options = self.config.search
        attempts = self._tried(self._refine, query, chosen, begin, clock)
        enough = not self.config.multistart or options.again == 1
        if enough or any(is_sure(each, options) for each in attempts):
            return attempts
        thorough = self._refine.searching(options.times(options.again))
        if says_all(query.prior):
            return attempts + self._tried(thorough, query, chosen, begin, clock)
        best = min(attempts, key=lambda attempt: attempt.fit)
        if best.fit < options.stop_fit:
            attempts.append(thorough.near(self._near_query(query), best.pose, clock))
        return attempts

    def _has_no_position(self, query: Query) -> bool:
        """Return whether a pose is searched for of which no position is known."""
        return self.config.multistart and not says_where(query.prior)

    def _near_query(self, query: Query) -> Query:
        """Return a query near a pose that was found: photographs it names gave but the start."""
        return replace(query, references=None) if self._has_no_position(query) else query

    def _tried(
        self,
        refine: Refiner,
        query: Query,
        chosen: NDArray[np.int64],
        begin: Sequence[Pose],
        clock: Stopwatch,
    ) -> list[Attempt]:
        """Try starts place by place, until the fit of one is good enough to stop.

        Where there were several starts, or no position is known, the image is then aligned once
        more from the best pose: seen from there it is turned and scaled better.
        """
        options = self.config.search
        radius = search_radius(query.prior, options)
        attempts: list[Attempt] = []
        by_place = groupby(begin, lambda start: start.centre().round(decimals=6).tolist())
        for _, at_place in by_place:
            attempts += [refine(query, chosen, start, clock, radius) for start in at_place]
            best = min(attempts, key=lambda attempt: attempt.fit)
            if best.fit < options.stop_fit:
                if len(begin) > 1 or self._has_no_position(query):
                    attempts.append(refine.near(self._near_query(query), best.pose, clock))
                break
        return attempts

    def _kept_mb(self, magnification: float) -> int:
        """Return what is left of ``memory_mb`` beside a pass of images magnified so much."""
        cameras = (image.camera for image in self._map.images.values())
        return max(1, self.config.memory_mb - self._extract.pass_megabytes(cameras, magnification))

    def _least_side(self, query: Query) -> int:
        """Return the shorter side (px) of the image at the largest scale the network sees."""
        camera = query.camera
        return round(min(camera.width, camera.height) * self._extract.largest_scale(camera))
