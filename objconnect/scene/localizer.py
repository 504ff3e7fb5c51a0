"""The protocol of a localizer, which takes a query and returns an estimate.

``Query`` does not hold the true pose, so no localizer can see it.
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
    """The camera pose that the aircraft measures without the image.

    Attributes:
        position: camera centre, (3,) world metres (ENU).
        position_sigma: standard deviation of ``position`` per axis, (3,) metres; None if unknown.
        cam_from_world_rotation: attitude, (3, 3); None if unknown.
        attitude_sigma_deg: standard deviation of the attitude, degrees; None if unknown.
        heading_sigma_deg: standard deviation of the heading, degrees; None if it equals
            ``attitude_sigma_deg``, infinite if a gimbal measures the tilt but no compass measures
            the heading.
    """

    position: NDArray[np.float64]
    position_sigma: NDArray[np.float64] | None = None
    cam_from_world_rotation: NDArray[np.float64] | None = None
    attitude_sigma_deg: float | None = None
    heading_sigma_deg: float | None = None

    @property
    def has_position(self) -> bool:
        """Return whether the horizontal position was measured."""
        return self.position_sigma is None or bool(np.isfinite(self.position_sigma[:2]).all())

    @property
    def horizontal_sigma(self) -> float | None:
        """Return the larger horizontal standard deviation, metres; None if unknown."""
        if self.position_sigma is None or not self.has_position:
            return None
        return float(self.position_sigma[:2].max())

    @property
    def has_heading(self) -> bool:
        """Return whether the attitude is known including its heading."""
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
        references: reference images to match with, most similar first; None leaves retrieval to
            the method. A coarse search of the map begins at these images.
        tracked: whether the prior is predicted from the preceding images. A method may then refine
            the prior alone, and search only if that fails.
    """

    name: str
    image: NDArray[np.uint8]
    camera: Camera
    prior: Prior | None = None
    references: tuple[str, ...] | None = None
    tracked: bool = False


def query_error(query: Query) -> str:
    """Return why a query is invalid for every method; empty if it is valid.

    An infinite sigma is allowed; it means that the axis was not measured.
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
        return "the prior's position has a sigma that is negative or NaN"
    rotation = prior.cam_from_world_rotation
    if rotation is not None and not np.isfinite(rotation).all():
        return "the prior's attitude is not finite"
    if prior.attitude_sigma_deg is not None and not prior.attitude_sigma_deg >= 0:
        return "the prior's attitude has a sigma that is negative or NaN"
    if prior.heading_sigma_deg is not None and not prior.heading_sigma_deg >= 0:
        return "the prior's heading has a sigma that is negative or NaN"
    return ""


class Status(StrEnum):
    """The outcome of a localization."""

    OK = "ok"
    FALLBACK = "fallback"  # the prior, a candidate or a reference image's pose: not found
    FAILED = "failed"


class PoseSource(StrEnum):
    """The step of a method that produced the pose of an estimate."""

    MATCHES = "matches"  # local features matched to those of reference images
    ALIGNMENT = "alignment"  # dense features aligned to those of the map's points
    TRACKING = "tracking"  # an alignment from the pose that the preceding images predict
    PLACE = "place"  # the best candidate of the coarse search, not refined
    RETRIEVAL = "retrieval"  # a reference image that looks like the query or lies near it
    PRIOR = "prior"  # the prior, completed from reference images if it is partial


@dataclass(frozen=True)
class Estimate:
    """The result of a localizer for one query.

    Attributes:
        status: ``ok``, or ``fallback`` / ``failed`` with a ``reason``.
        cam_from_world: pose (float64, unbatched); None if failed.
        covariance: (6, 6), of the left tangent of ``cam_from_world``: rotation (rad) then
            translation (m); None if unknown.
        inliers: number of points or matches that agree with the pose.
        iterations: number of iterations of the robust estimator or the optimizer.
        seconds: time per stage.
        reason: why the status is not ``ok``, in words.
        by: step that produced the pose; None if there is no pose or the method does not say.
        probability: probability that the method's best pose is within 5 m and 10 degrees of the
            truth; for a fallback, the probability of the rejected pose. None if the method gives
            none.
    """

    status: Status
    cam_from_world: Pose | None = None
    covariance: NDArray[np.float64] | None = None
    inliers: int = 0
    iterations: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    by: PoseSource | None = None
    probability: float | None = None

    @property
    def is_tracked(self) -> bool:
        """Return whether the pose is the confirmed prior of a tracked query, without a search."""
        return self.by is PoseSource.TRACKING

    def world_covariance(self) -> NDArray[np.float64] | None:
        """Return the covariance (6, 6) of centre and attitude; None where it is unknown.

        The centre is metres to the east, north and up, the attitude rad about these axes. With
        ``exp(omega, v) @ (R, t)`` the centre moves by ``-R^T v`` and the camera turns by
        ``-R^T omega``.
        """
        if self.cam_from_world is None or self.covariance is None:
            return None
        world_from_cam = self.cam_from_world.rotation.numpy().T
        jacobian = np.zeros((6, 6))
        jacobian[:3, 3:] = jacobian[3:, :3] = -world_from_cam
        return np.asarray(jacobian @ self.covariance @ jacobian.T)

    def sigma_position(self) -> float | None:
        """Return the predicted standard deviation of the camera centre (m), None if unknown.

        It is the root of the trace of the centre's covariance. With ``exp(omega, v) @ (R, t)`` the
        centre ``-R^T t`` moves by ``-R^T v`` to first order, so only the translation block matters.
        """
        if self.covariance is None:
            return None
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


class Stopwatch:
    """A clock that sums the seconds of each stage of one localization in ``seconds``."""

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
        """Return the options that change the result; the results file records them."""
        ...

    @property
    def weights_sha256(self) -> str | None:
        """Return the digest of the learned weights; None for a method without weights."""
        ...

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Build the per-map state once.

        Args:
            sparse_map: map; its image names are relative to ``images``.
            images: folder of the map's photographs.
            cache: folder that keeps the state for later runs, keyed by a digest of map, weights
                and configuration; None keeps nothing.

        Raises:
            InputError: the map is empty, or a photograph is missing or damaged.
        """
        ...

    def localize(self, query: Query) -> Estimate:
        """Return the pose of a query; a query that cannot be localized is ``FAILED`` with a reason.

        It never raises because of the query.
        """
        ...


@runtime_checkable
class PreparesLazily(Protocol):
    """A localizer that builds part of its per-map state only when a query needs it."""

    def prepare_lazily(self, sparse_map: SparseMap, images: Path, cache: Path) -> None:
        """Build the part of the per-map state that every query needs.

        The first query that needs the rest builds it, in its stage ``preparation``. The results
        equal those after ``Localizer.prepare``.

        Args:
            sparse_map: map; its image names are relative to ``images``.
            images: folder of the map's photographs; it must exist until the last query.
            cache: folder as for ``Localizer.prepare``; it must exist until the last query.

        Raises:
            InputError: the map is empty, or a photograph is missing or damaged.
        """
        ...


def prepare_lazily(localizer: Localizer, sparse_map: SparseMap, images: Path, cache: Path) -> None:
    """Prepare a method lazily if it supports that, else completely; see ``PreparesLazily``."""
    if isinstance(localizer, PreparesLazily):
        localizer.prepare_lazily(sparse_map, images, cache)
    else:
        localizer.prepare(sparse_map, images, cache)


@dataclass(frozen=True)
class MapPart:
    """The photographs of a map that one of several processes prepares.

    Attributes:
        names: names of the photographs.
        folder: folder inside the cache for the results of this process.
    """

    names: Sequence[str]
    folder: Path


@runtime_checkable
class PreparesParts(Protocol):
    """A localizer whose per-map state several processes can compute in parts."""

    def prepare_part(self, sparse_map: SparseMap, images: Path, cache: Path, part: MapPart) -> None:
        """Compute the cache entries of the photographs of ``part``, unless the cache is complete.

        When all parts exist, ``prepare`` with the same map and cache merges them.

        Args:
            sparse_map: the whole map.
            images: folder of its photographs.
            cache: folder of the cache.
            part: the photographs.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        ...
