"""The protocol of a localizer: it takes a query and returns an estimate.

A localizer never sees the reference pose of a query, which is not part of ``Query``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import SparseMap

if TYPE_CHECKING:
    from objconnect.scene.geometry.pose import Pose


@dataclass(frozen=True)
class Prior:
    """The aircraft's knowledge of its pose without the image.

    Attributes:
        position: camera centre, (3,) world metres (ENU).
        position_sigma: standard deviation of ``position`` per axis, (3,) metres; None if unknown.
        cam_from_world_rotation: attitude, (3, 3); None if unknown.
        attitude_sigma_deg: standard deviation of the attitude, degrees; None if unknown.
        heading_sigma_deg: standard deviation of the heading, degrees, where it is not that of the
            attitude: infinite where a gimbal knows the tilt and no compass the heading.
    """

    position: NDArray[np.float64]
    position_sigma: NDArray[np.float64] | None = None
    cam_from_world_rotation: NDArray[np.float64] | None = None
    attitude_sigma_deg: float | None = None
    heading_sigma_deg: float | None = None

    @property
    def has_position(self) -> bool:
        """Whether the horizontal position was measured."""
        return self.position_sigma is None or bool(np.isfinite(self.position_sigma[:2]).all())

    @property
    def horizontal_sigma(self) -> float | None:
        """The larger horizontal standard deviation, metres; None if unknown or not measured."""
        if self.position_sigma is None or not self.has_position:
            return None
        return float(self.position_sigma[:2].max())

    @property
    def has_heading(self) -> bool:
        """Whether the attitude is given, and its heading with it."""
        sigma = self.heading_sigma_deg
        return self.cam_from_world_rotation is not None and (sigma is None or sigma < np.inf)


@dataclass(frozen=True)
class Query:
    """One image to localize.

    Attributes:
        name: name, unique within its data set.
        image: (H, W, 3) uint8 RGB, of the size of ``camera``.
        camera: calibrated camera.
        prior: approximate pose, or None.
        references: photographs of the map to match with, most similar first, where retrieval is not
            left to the method; else None. A method that searches begins there.
        tracked: whether the prior is what the images just before predict, so that a method may
            look there alone, and search only where that is not confirmed.
    """

    name: str
    image: NDArray[np.uint8]
    camera: Camera
    prior: Prior | None = None
    references: tuple[str, ...] | None = None
    tracked: bool = False


def query_error(query: Query) -> str:
    """Return why a query cannot be localized by any method; empty if there is no reason.

    An infinite sigma is allowed: that axis was not measured.
    """
    if query.image.dtype != np.uint8:
        return f"the image is {query.image.dtype}, not uint8"
    size = (query.camera.height, query.camera.width, 3)
    if query.image.shape != size:
        return f"the image has shape {query.image.shape}, its camera {size}"
    prior = query.prior
    if prior is None:
        return ""
    if not np.isfinite(prior.position).all():
        return "the prior's position is not finite"
    if prior.position_sigma is not None and not (prior.position_sigma >= 0).all():
        return "the prior's position has a sigma that is no standard deviation"
    rotation = prior.cam_from_world_rotation
    if rotation is not None and not np.isfinite(rotation).all():
        return "the prior's attitude is not finite"
    if prior.attitude_sigma_deg is not None and not prior.attitude_sigma_deg >= 0:
        return "the prior's attitude has a sigma that is no standard deviation"
    if prior.heading_sigma_deg is not None and not prior.heading_sigma_deg >= 0:
        return "the prior's heading has a sigma that is no standard deviation"
    return ""


class Status(StrEnum):
    """The outcome of a localization."""

    OK = "ok"
    FALLBACK = "fallback"  # the pose is only that of the prior or of a reference: counts as wrong
    FAILED = "failed"


class By(StrEnum):
    """What gave the pose of an answer."""

    MATCHES = "matches"  # local features, matched to those of the map's photographs
    ALIGNMENT = "alignment"  # features of the image, aligned to those of the map's points
    TRACKING = "tracking"  # an alignment where the images before lead, and nowhere else
    PLACE = "place"  # the place of the map that looks most like the image, unrefined
    RETRIEVAL = "retrieval"  # a photograph of the map that looks like the image or lies near it
    PRIOR = "prior"  # the prior, which photographs of the map may have completed


@dataclass(frozen=True)
class Estimate:
    """The answer of a localizer.

    Attributes:
        status: ``ok``, or ``fallback`` / ``failed`` with a ``reason``.
        cam_from_world: pose (float64, unbatched); None if failed.
        covariance: (6, 6), of the left tangent of ``cam_from_world``: rotation (rad) then
            translation (m); None if unknown.
        inliers: number of points or matches that agree with the pose.
        iterations: number of iterations of the robust estimator or the optimizer.
        seconds: time per stage.
        reason: why there is no pose, in words.
        by: what gave the pose; None without one, or where the method does not say.
        probability: probability that the method's best pose is right, within 5 m and 10 degrees. Of
            a fallback it is that of the pose that was not believed. None where it does not say.
    """

    status: Status
    cam_from_world: Pose | None = None
    covariance: NDArray[np.float64] | None = None
    inliers: int = 0
    iterations: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    by: By | None = None
    probability: float | None = None

    @property
    def is_tracked(self) -> bool:
        """Whether only the prior of a tracked query was looked at, and confirmed."""
        return self.by is By.TRACKING

    def world_covariance(self) -> NDArray[np.float64] | None:
        """Return the covariance (6, 6) of centre and attitude; None where it is unknown.

        The centre is metres to the east, north and up, the attitude rad about these axes. With
        ``exp(omega, v) @ (R, t)`` the centre moves by ``-R^T v`` and the camera turns by
        ``-R^T omega``.
        """
        if self.cam_from_world is None or self.covariance is None:
            return None
        world_from_cam = self.cam_from_world.rotation.numpy().T
        moves = np.zeros((6, 6))
        moves[:3, 3:] = moves[3:, :3] = -world_from_cam
        return np.asarray(moves @ self.covariance @ moves.T)

    def sigma_position(self) -> float | None:
        """Return the predicted standard deviation of the camera centre (m), None if unknown.

        It is the root of the trace of the centre's covariance. With ``exp(omega, v) @ (R, t)`` the
        centre ``-R^T t`` moves by ``-R^T v`` to first order, so only the translation block matters.
        """
        if self.covariance is None:
            return None
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


class Stopwatch:
    """The time that each stage of one localization takes.

    Attributes:
        seconds: seconds by stage.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to the stage ``name``."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + perf_counter() - start


class Localizer(Protocol):
    """A method that finds the pose of an image in a map."""

    @property
    def name(self) -> str:
        """Return the short name used on the command line."""
        ...

    @property
    def config(self) -> BaseModel:
        """Return everything that changes the result; it is written into the results file."""
        ...

    @property
    def weights_sha256(self) -> str | None:
        """Return the digest of the learned weights, None for methods without."""
        ...

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Build the per-map state once.

        Args:
            sparse_map: map; its image names are relative to ``images``.
            images: folder of the map's photographs.
            cache: folder for state that outlives the process, or None to keep none. Entries are
                keyed by a digest of map, weights and configuration.

        Raises:
            InputError: the map is empty, or a photograph is missing or damaged.
        """
        ...

    def localize(self, query: Query) -> Estimate:
        """Find the pose of a query.

        A query that cannot be localized is answered with ``FAILED`` and a reason, never by an
        exception.
        """
        ...


@runtime_checkable
class PreparesLater(Protocol):
    """A localizer that can leave what not every query needs until one needs it."""

    def prepare_first(self, sparse_map: SparseMap, images: Path, cache: Path) -> None:
        """Build of the per-map state what a query needs first.

        The rest is built by the first query that needs it, as its stage ``preparation``, and then
        is that of ``Localizer.prepare``: answers are the same.

        Args:
            sparse_map: map; its image names are relative to ``images``.
            images: folder of the map's photographs, there until the last query.
            cache: folder as for ``Localizer.prepare``, there until the last query.

        Raises:
            InputError: the map is empty, or a photograph is missing or damaged.
        """
        ...


def prepare_first(localizer: Localizer, sparse_map: SparseMap, images: Path, cache: Path) -> None:
    """Prepare a method, and leave until a query needs it what the method can leave.

    The arguments and errors are those of ``PreparesLater.prepare_first``.
    """
    if isinstance(localizer, PreparesLater):
        localizer.prepare_first(sparse_map, images, cache)
    else:
        localizer.prepare(sparse_map, images, cache)


@dataclass(frozen=True)
class MapPart:
    """Some photographs of a map, which one of several processes prepares.

    Attributes:
        names: of the photographs.
        folder: folder in that of the cache, for what is computed of them.
    """

    names: Sequence[str]
    folder: Path


@runtime_checkable
class PreparesParts(Protocol):
    """A localizer whose ``prepare`` takes what several processes have computed of a map."""

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Compute what the cache is to hold of some photographs, unless it holds all already.

        Once all parts are there, ``prepare`` with the same map and cache copies them.

        Args:
            sparse_map: the whole map.
            images: folder of its photographs.
            cache: folder of the cache.
            part: the photographs.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        ...
