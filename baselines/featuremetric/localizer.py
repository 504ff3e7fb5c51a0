"""Localization by alignment: the pose at which the image looks like the map's points do in the
nearest photographs.

One pipeline for every network with features at several strides; a method is a network and a
configuration. After PixLoc (Sarlin et al., CVPR 2021). Differently from their code, features of the
photographs are kept from ``prepare`` on, photographs are seen north up and at one resolution,
steps that make the cost larger are not taken, and the pose has a covariance.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
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
from baselines.align.hypotheses import Reach, align_from_many
from baselines.align.residuals import Level
from baselines.align.sampling import per_axis
from baselines.featuremetric.maps import FeatureMap, MapExtractor, Network, Precision
from baselines.featuremetric.references import references
from baselines.resolution import metres_per_pixel, scale_to
from baselines.retrieval import OnDemand, References
from baselines.starts import every_way, starts
from baselines.views import View, north
from scene.config import Config
from scene.localizer import Estimate, Prior, Query, Status, Stopwatch, fault
from scene.pose import Pose
from scene.projection import Intrinsics
from scene.sparse_map import SparseMap

# The coarsest level has a cell for so many pixels; an image must have one at least.
_LEAST_SIDE: Final = 16
# Poses of pictures of nothing cost 0.98 of chance and more, 0.95 where little is in view; those of
# right ones 0.64 to 0.87.
_BETTER: Final = 0.93
_CLEARLY: Final = 0.87
# Variance of a pose in parts of what alignment alone says, which knows neither what the map is off
# nor shadows and snow that pull all points one way: so it was on town 102, kept for such choices.
_DOUBT: Final = 3.0
# Points by which starts are compared; the one kept is aligned to all.
_COMPARED: Final = 512
# A grid of starts that is spread wider has gaps.
_FARTHEST: Final = Reach(metres=40.0, degrees=30.0)
# Degrees to look to either side of each of the headings tried, which are 30 apart.
_BETWEEN_HEADINGS: Final = 15.0

_Problem = tuple[list[Level], torch.Tensor, Intrinsics, Pose, list[torch.Tensor], Options]


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
            below it (``scene.held.room``).
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

    start: Pose
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
        self._options = Options(iterations=config.iterations)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Keep what the points of the map look like in its photographs."""
        if cache is None:
            self._folder = tempfile.TemporaryDirectory(prefix=f"{self.name}-")
            cache = Path(self._folder.name)
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
        # The coarsest features tell places apart: nothing else need be extracted to find similar
        # photographs.
        described = OnDemand(self._observations.coarse, len(self._observations))
        self._retrieval = References.build(sparse_map, described)

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Feature maps, references, starting pose, points, alignment."""
        if reason := fault(query):
            return Estimate(Status.FAILED, reason=reason)
        if (side := self._least_side(query)) < _LEAST_SIDE:
            reason = f"the image is {side} pixels wide or high, {_LEAST_SIDE} are needed"
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
                best.start,
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
        """All starts of one place, then those of the next, until one is clearly right. Then, where
        there were several, once more from the pose found: from there the image is seen better
        turned and at a better scale."""
        tried: list[_Attempt] = []
        for _, there in groupby(begin, lambda start: start.centre().round(decimals=6).tolist()):
            tried += [self._attempt(query, chosen, start, clock) for start in there]
            best = min(tried, key=lambda attempt: attempt.fit)
            if best.fit < _CLEARLY:
                if len(begin) > 1:
                    near = replace(query, prior=_known(best.pose))
                    tried.append(self._attempt(near, self._chosen(near), best.pose, clock))
                break
        return tried

    def _attempt(
        self, query: Query, chosen: NDArray[np.int64], start: Pose, clock: Stopwatch
    ) -> _Attempt:
        """Look at the query as if a start were right, and align it."""
        with clock.stage("features"):
            view, maps = self._look(query, chosen, start)
        many = self.config.multistart
        count = min(_COMPARED, self.config.points) if many else self.config.points
        with clock.stage("points"):
            problem = self._problem(view, maps, chosen, start, count)
        with clock.stage("alignment"):
            if many:
                found = align_from_many(*problem, _reach(query.prior))
                problem, found = self._again(query, view, maps, problem, found)
            else:
                found = align(*problem)
            reason = found.reason(0)
            fit = math.inf if reason else _fit(problem, found.pose)
            if not reason and not fit < _BETTER:
                reason = "the image fits the map's points hardly better than it would by chance"
        return _Attempt(start, view, found, fit, reason)

    def _again(
        self, query: Query, view: View, maps: list[FeatureMap], problem: _Problem, found: Alignment
    ) -> tuple[_Problem, Alignment]:
        """Align once more, to all that is seen from the pose found: a start far off saw other
        points, and had other photographs beside it."""
        if found.failed[0]:
            return problem, found
        there = _pose(view, found)
        chosen = self._chosen(replace(query, prior=_known(there)))
        after = self._problem(view, maps, chosen, there, self.config.points)
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
        _, maps = self._extract(query.image, query.camera)
        cells = maps[0].features[0].flatten(1).T.float()
        return torch.nn.functional.normalize(cells, dim=1).numpy()

    def _look(
        self, query: Query, chosen: NDArray[np.int64], start: Pose
    ) -> tuple[View, list[FeatureMap]]:
        """The image as the photographs of the map were seen, if the start is right."""
        points = np.concatenate([self._observations[int(row)].xyz for row in chosen])
        camera = query.camera
        own = metres_per_pixel(start, camera, points)
        largest = self._extract.largest_scale(camera)
        # The view must not fall below what the network needs.
        least = _LEAST_SIDE / min(camera.width, camera.height)
        scale = max(scale_to(self._observations.metres_per_pixel, own, largest), least)
        view, maps = self._extract(query.image, camera, north(start.rotation.numpy()), scale)
        # Once for all problems that are made of them.
        unit = torch.nn.functional.normalize
        return view, [replace(each, features=unit(each.features, dim=1)) for each in maps]

    def _problem(
        self, view: View, maps: list[FeatureMap], chosen: NDArray[np.int64], start: Pose, count: int
    ) -> _Problem:
        """At most ``count`` points, those first that the start sees, and what they look like.

        A point seen by several references counts once for each of them, as in the authors' code.
        """
        from_world = view.pose(start)
        observed = [self._observations[int(row)] for row in chosen]
        xyz = np.concatenate([seen.xyz for seen in observed])
        turn = np.concatenate([np.arange(len(seen.xyz)) for seen in observed])
        in_camera = from_world.transform(torch.from_numpy(xyz))
        projected = view.camera.project(in_camera)
        inside = projected.valid & view.camera.contains(projected.xy)
        visible = inside.numpy() & view.shows(projected.xy.numpy())
        kept = np.lexsort((turn, ~visible))[:count]
        confidence = np.concatenate([seen.confidence for seen in observed])[kept]
        levels = []
        for number, level in enumerate(maps):
            reference = np.concatenate([seen.features[number] for seen in observed])[kept]
            levels.append(
                Level(
                    level.features,
                    level.stride,
                    torch.from_numpy(reference).float()[None],
                    level.confidence,
                    torch.from_numpy(confidence[:, number]).float()[None],
                )
            )
        return (
            levels,
            torch.from_numpy(xyz[kept])[None],
            view.camera.intrinsics(),
            Pose(from_world.rotation[None], from_world.translation[None]),
            self._damping,
            self._options,
        )


def _pose(view: View, found: Alignment) -> Pose:
    return view.photograph_pose(Pose(found.pose.rotation[0], found.pose.translation[0]))


def _known(pose: Pose) -> Prior:
    return Prior(pose.centre().numpy(), cam_from_world_rotation=pose.rotation.numpy())


def _heading_unknown(prior: Prior | None) -> bool:
    return prior is not None and prior.cam_from_world_rotation is None


def _reach(prior: Prior | None) -> Reach:
    """How far a prior may be off: two of its standard deviations, where they are known."""
    usual = Reach()
    if prior is None:
        return usual
    metres = usual.metres
    if prior.position_sigma is not None:
        # An axis that was not measured is infinitely unsure: nothing says how far to look.
        known = prior.position_sigma[:2][np.isfinite(prior.position_sigma[:2])]
        metres = max([metres, *(2 * float(sigma) for sigma in known)])
    degrees = max(usual.degrees, 2 * (prior.attitude_sigma_deg or 0.0))
    return Reach(
        min(metres, _FARTHEST.metres),
        min(degrees, _FARTHEST.degrees),
        _BETWEEN_HEADINGS if _heading_unknown(prior) else 0.0,
    )


def _fit(problem: _Problem, pose: Pose) -> float:
    """The cost at a pose, in parts of what other points would cost where these are seen."""
    levels, points, intrinsics, _, damping, options = problem
    still = replace(options, iterations=0)
    judge = len(levels) // 2
    level, held_back = levels[judge], damping[judge]
    projected = intrinsics.project(pose.transform(points))
    size = torch.tensor(level.features.shape[:1:-1], dtype=points.dtype)
    cells = projected.xy / per_axis(level.stride, points)
    seen = (projected.valid & (cells > 1).all(-1) & (cells < size - 1).all(-1))[0]
    if not bool(seen.any()):
        return math.inf
    # Those seen change places among themselves, and keep how far they are trusted: where all of the
    # picture looks the same, so do they. Neighbours in the list are of different parts of it.
    order = torch.nonzero(seen)[:, 0]
    other = torch.roll(order, len(order) // 2)

    def cost(which: torch.Tensor) -> float:
        trust = level.reference_confidence
        chosen = replace(
            level,
            reference=level.reference[:, which],
            reference_confidence=None if trust is None else trust[:, which],
        )
        return float(align([chosen], points[:, order], intrinsics, pose, [held_back], still).cost)

    return cost(order) / max(cost(other), 1e-12)
