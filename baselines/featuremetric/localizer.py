"""Localization by alignment: the pose at which the image looks like the map's points do in the
nearest photographs.

One pipeline for every network with features at several strides; a method is a network and a
configuration. After PixLoc (Sarlin et al., CVPR 2021). Differently from their code, features of the
photographs are kept from ``prepare`` on, photographs are seen north up and at one resolution,
steps that make the cost larger are not taken, and the pose has a covariance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.align.aligner import Alignment, align
from baselines.align.descent import Options
from baselines.align.hypotheses import SearchRadius, align_from_many, promise
from baselines.featuremetric.maps import FeatureMap, MapExtractor, Network, Precision
from baselines.featuremetric.problem import LEAST_SIDE, Problem, Problems, fit
from baselines.featuremetric.references import references
from baselines.retrieval import OnDemand, References
from baselines.starts import every_way, starts
from baselines.views import View, turned_to
from scene.config import Config
from scene.geometry.pose import Pose
from scene.localizer import Estimate, Prior, Query, Status, Stopwatch, query_error
from scene.maps.sparse_map import SparseMap
from scene.storage.scratch import scratch

# Poses of pictures of nothing cost 0.98 of chance and more, 0.95 where little is in view; those of
# right ones 0.64 to 0.87.
_BETTER: Final = 0.93
_CLEARLY: Final = 0.87
# So little only where much is in view: reason enough to try nothing else.
_SURELY: Final = 0.75
# Variance of a pose in parts of what alignment alone says, which knows neither what the map is off
# nor shadows and snow that pull all points one way: so it was on town 102, kept for such choices.
_DOUBT: Final = 3.0
# Points by which starts are compared; the one kept is aligned to all.
_COMPARED: Final = 512
# By which places are, before any start.
_GLANCED: Final = 256
# A grid of starts that is spread wider has gaps.
_FARTHEST: Final = SearchRadius(metres=40.0, degrees=30.0)
# Headings tried where nobody knows it, and degrees to look to either side of each.
_HEADINGS: Final = 12
_BETWEEN_HEADINGS: Final = 15.0
# Photographs near the prior beside which an image of unknown heading is looked for too, how far
# from them in heights above ground, and how many of all places and headings are tried first.
_NEAR: Final = 6
_BESIDE: Final = 0.3
_PROMISING: Final = 4
# Scales that differ by less than one in so many are looked at as one.
_ALIKE: Final = 10


class FeaturemetricConfig(Config):
    """Options of a localizer by alignment.

    Attributes:
        weights: file of the network; None is the one that comes with the project.
        references: photographs of the map the query is aligned to, together.
        points: shared by the references.
        corners: of each photograph of the map that become points beside the map's own; 0 for none.
        longest: larger images are resized to this side (px).
        iterations: at most, per level.
        multistart: look around the start too, for priors beyond the reach of the features.
        precision: of the convolutions.
        memory_mb: for the whole process: features of the map stay in memory as far as there is room
            below it (``scene.storage.lru_cache.room``).
    """

    weights: Path | None = None
    references: int = Field(5, ge=1)
    points: int = Field(2048, ge=10)
    corners: int = Field(2500, ge=0)
    longest: int = Field(1024, ge=64)
    iterations: int = Field(100, ge=1)
    multistart: bool = False
    precision: Precision = "float32"
    memory_mb: int = Field(2048, ge=1)


class _Attempt(NamedTuple):
    """What came of one start: ``fit`` is the cost in parts of that by chance."""

    view: View
    found: Alignment
    fit: float
    reason: str

    @property
    def pose(self) -> Pose:
        """``cam_from_world`` of the photograph."""
        return _pose(self.view, self.found)


class FeaturemetricLocalizer:
    """See the module. Implements ``scene.localizer.Localizer``.

    Args:
        name: of the method.
        network: trained.
        weights_sha256: digest of its weights.
        config: how it is used.
    """

    def __init__(
        self, name: str, network: Network, weights_sha256: str, config: FeaturemetricConfig
    ) -> None:
        self.name = name
        self.weights_sha256: str | None = weights_sha256
        self.config = config
        self._extract = MapExtractor(network, config.longest, config.precision)
        self._damping = [factors().detach() for factors in network.damping]

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Keep what the points of the map look like in its photographs."""
        if cache is None:
            with scratch() as folder:  # files stay open
                self.prepare(sparse_map, images, folder)
            return
        config = self.config
        self._map = sparse_map
        self._observations = references(
            sparse_map,
            images,
            self._extract,
            config.points,
            config.corners,
            self.name,
            f"{self.weights_sha256} {config.longest} {config.precision}",
            cache,
            config.memory_mb,
        )
        self._problems = Problems(
            self._extract, self._observations, self._damping, Options(iterations=config.iterations)
        )
        # The coarsest features tell places apart: nothing else need be extracted to find similar
        # photographs.
        described = OnDemand(self._observations.coarse, len(self._observations))
        self._retrieval = References.build(sparse_map, described)

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Feature maps, references, starting pose, points, alignment."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._least_side(query)) < LEAST_SIDE:
            reason = f"the image is {side} pixels wide or high, {LEAST_SIDE} are needed"
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        with clock.stage("retrieval"):
            chosen = self._chosen(query)
            if not len(chosen):
                return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
            begin = starts(query.prior, self._map, chosen)
            if self.config.multistart and _heading_unknown(query.prior):
                begin = every_way(begin)
        tried = self._tried(query, chosen, begin, clock)
        best = min(tried, key=lambda attempt: (bool(attempt.reason), attempt.fit))
        found, view = best.found, best.view
        seen, iterations = int(found.seen), sum(int(each.found.iterations) for each in tried)
        if best.reason:
            return Estimate(
                Status.FALLBACK,
                begin[0],
                inliers=seen,
                iterations=iterations,
                seconds=clock.seconds,
                reason=best.reason,
            )
        covariance = view.photograph_covariance(_DOUBT * found.covariance[0].numpy())
        return Estimate(
            Status.OK,
            best.pose,
            covariance if np.isfinite(covariance).all() else None,
            inliers=seen,
            iterations=iterations,
            seconds=clock.seconds,
        )

    def _tried(
        self, query: Query, chosen: NDArray[np.int64], begin: Sequence[Pose], clock: Stopwatch
    ) -> list[_Attempt]:
        """Starts until one is clearly right. Then, where there were several, once more from the
        pose found: from there the image is seen better turned and at a better scale."""
        tried: list[_Attempt] = []
        for some, enough in self._in_turn(query, chosen, begin, clock):
            tried += some
            best = min(tried, key=lambda attempt: attempt.fit)
            if best.fit < enough:
                if len(begin) > 1:
                    tried.append(self._attempt_near(query, best.pose, clock, SearchRadius()))
                break
        return tried

    def _in_turn(
        self, query: Query, chosen: NDArray[np.int64], begin: Sequence[Pose], clock: Stopwatch
    ) -> Iterator[tuple[list[_Attempt], float]]:
        """What promises most, if the heading is not known; then all starts of one place, and those
        of the next. With the fit that is good enough to stop there."""
        by_place = groupby(begin, lambda start: start.centre().round(decimals=6).tolist())
        places = [list(there) for _, there in by_place]
        reach = _reach(query.prior)
        if self.config.multistart and _heading_unknown(query.prior):
            with clock.stage("retrieval"):
                promising = self._promising(query, [(there[0], reach) for there in places])
            for start, within in promising:
                yield [self._attempt_near(query, start, clock, within)], _SURELY
        for there in places:
            yield [self._attempt(query, chosen, start, clock, reach) for start in there], _CLEARLY

    def _promising(
        self, query: Query, places: Sequence[tuple[Pose, SearchRadius]]
    ) -> list[tuple[Pose, SearchRadius]]:
        """Of poses, and of photographs near the prior, turned to every heading, those around which
        the image fits best on the coarsest level, the best first; with how far to look."""
        assert query.prior is not None
        photographs = []
        for row in self._retrieval.viewpoints.near(query.prior.position, _NEAR):
            pose = self._map.images[self._map.names[int(row)]].pose
            metres = _BESIDE * self._map.height_above(pose.centre().numpy())
            photographs.append((pose, SearchRadius(min(metres, _FARTHEST.metres))))
        seen = []
        for pose, reach in [*places, *photographs]:
            chosen = self._chosen(replace(query, prior=_known(pose)))
            scale = self._problems.scale(query.camera, chosen, pose)
            alike = round(_ALIKE * math.log(scale))
            seen.append((pose, replace(reach, heading=_BETWEEN_HEADINGS), chosen, alike))
        found = []
        for heading in np.arange(_HEADINGS) * math.tau / _HEADINGS:
            looked: dict[int, tuple[View, list[FeatureMap]]] = {}
            for pose, reach, chosen, alike in seen:
                turned = turned_to(pose, float(heading))
                if alike not in looked:
                    looked[alike] = self._problems.look(query, chosen, turned, levels=1)
                levels, points, intrinsics, start, _, options = self._problems.of(
                    *looked[alike], chosen, turned, _GLANCED
                )
                most = promise(levels[0], points, intrinsics, start, options, reach)
                found.append((float(most), turned, reach))
        found.sort(key=lambda each: -each[0])
        return [(turned, reach) for _, turned, reach in found[:_PROMISING]]

    def _attempt_near(
        self, query: Query, start: Pose, clock: Stopwatch, reach: SearchRadius
    ) -> _Attempt:
        """From a start of which more is known than the query says."""
        near = replace(query, prior=_known(start))
        return self._attempt(near, self._chosen(near), start, clock, reach)

    def _attempt(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        start: Pose,
        clock: Stopwatch,
        reach: SearchRadius,
    ) -> _Attempt:
        """Look at the query as if a start were right, and align it."""
        with clock.stage("features"):
            view, maps = self._problems.look(query, chosen, start)
        many = self.config.multistart
        count = min(_COMPARED, self.config.points) if many else self.config.points
        with clock.stage("points"):
            problem = self._problems.of(view, maps, chosen, start, count)
        with clock.stage("alignment"):
            if many:
                found = align_from_many(*problem, reach)
                problem, found = self._again(query, view, maps, problem, found)
            else:
                found = align(*problem)
            reason = found.reason(0)
            of_chance = math.inf if reason else fit(problem, found.pose)
            if not reason and not of_chance < _BETTER:
                reason = "the image fits the map's points hardly better than it would by chance"
        return _Attempt(view, found, of_chance, reason)

    def _again(
        self, query: Query, view: View, maps: list[FeatureMap], problem: Problem, found: Alignment
    ) -> tuple[Problem, Alignment]:
        """Align once more, to all that is seen from the pose found: a start far off saw other
        points, and had other photographs beside it."""
        if found.failed[0]:
            return problem, found
        there = _pose(view, found)
        chosen = self._chosen(replace(query, prior=_known(there)))
        after = self._problems.of(view, maps, chosen, there, self.config.points)
        levels, points, intrinsics, begin, damping, options = after
        # The coarsest level has no more to say of a pose that the finest one found.
        final = align(
            levels[1:] or levels, points, intrinsics, begin, damping[1:] or damping, options
        )
        if final.failed[0]:
            return problem, found
        return after, replace(final, iterations=found.iterations + final.iterations)

    def _chosen(self, query: Query) -> NDArray[np.int64]:
        """Rows of the photographs to align a query to."""
        return self._retrieval.choose(
            query, self.config.references, lambda: self._described(query), tilted=False
        )

    def _least_side(self, query: Query) -> int:
        """Pixels of the image's shorter side, as the network would see it as taken."""
        camera = query.camera
        scale = min(1.0, self._extract.largest_scale(camera))
        return round(min(camera.width, camera.height) * scale)

    def _described(self, query: Query) -> NDArray[np.float32]:
        """Unit features of all coarse cells of the image as it was taken, (n, C)."""
        _, maps = self._extract(query.image, query.camera, levels=1)
        cells = maps[0].features[0].flatten(1).T.float()
        return torch.nn.functional.normalize(cells, dim=1).numpy()


def _pose(view: View, found: Alignment) -> Pose:
    return view.photograph_pose(Pose(found.pose.rotation[0], found.pose.translation[0]))


def _known(pose: Pose) -> Prior:
    return Prior(pose.centre().numpy(), cam_from_world_rotation=pose.rotation.numpy())


def _heading_unknown(prior: Prior | None) -> bool:
    return prior is not None and prior.cam_from_world_rotation is None


def _reach(prior: Prior | None) -> SearchRadius:
    """How far a prior may be off: two of its standard deviations, where they are known."""
    usual = SearchRadius()
    if prior is None:
        return usual
    metres = usual.metres
    if prior.position_sigma is not None:
        # An axis that was not measured is infinitely unsure: nothing says how far to look.
        known = prior.position_sigma[:2][np.isfinite(prior.position_sigma[:2])]
        metres = max([metres, *(2 * float(sigma) for sigma in known)])
    degrees = max(usual.degrees, 2 * (prior.attitude_sigma_deg or 0.0))
    return SearchRadius(
        min(metres, _FARTHEST.metres),
        min(degrees, _FARTHEST.degrees),
        _BETWEEN_HEADINGS if _heading_unknown(prior) else 0.0,
    )
