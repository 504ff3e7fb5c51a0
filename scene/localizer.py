"""The protocol every localizer speaks: a query goes in, an estimate comes out.

A localizer never sees the reference pose of a query: it is not part of ``Query``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.maps.sparse_map import SparseMap


@dataclass(frozen=True)
class Prior:
    """What the aircraft believes about its pose before looking at the image.

    Attributes:
        position: (3,) camera centre in world metres (ENU).
        position_sigma: (3,) one standard deviation per axis, metres; None when nobody knows it.
        cam_from_world_rotation: (3, 3) attitude; None when unknown.
        attitude_sigma_deg: one standard deviation of the attitude, degrees; None when unknown.
    """

    position: NDArray[np.float64]
    position_sigma: NDArray[np.float64] | None = None
    cam_from_world_rotation: NDArray[np.float64] | None = None
    attitude_sigma_deg: float | None = None


@dataclass(frozen=True)
class Query:
    """One image to localize.

    Attributes:
        name: unique within its data set.
        image: (H, W, 3) uint8 RGB, the size of ``camera``.
        camera: calibrated.
        prior: starting information, or None.
        references: photographs of the map to look at, most similar first, where retrieval is not
            left to the method; else None.
    """

    name: str
    image: NDArray[np.uint8]
    camera: Camera
    prior: Prior | None = None
    references: tuple[str, ...] | None = None


def query_error(query: Query) -> str:
    """Why nobody can localize a query, in words; empty when there is no reason.

    An infinite sigma is no fault: that axis was not measured.
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
    return ""


class Status(StrEnum):
    """How a localization ended."""

    OK = "ok"
    FALLBACK = "fallback"  # a pose is given, but only the prior or a reference's: counts as wrong
    FAILED = "failed"


@dataclass(frozen=True)
class Estimate:
    """What a localizer answers.

    Attributes:
        status: ``ok``, or ``fallback`` / ``failed`` with a ``reason``.
        cam_from_world: the pose (float64, unbatched); None when failed.
        covariance: (6, 6) of the left tangent of ``cam_from_world``: rotation (rad) then
            translation (m); None when unknown.
        inliers: number of points or matches that agree with the pose.
        iterations: of the robust estimator or the optimizer.
        seconds: per stage.
        reason: why there is no pose, in words.
    """

    status: Status
    cam_from_world: Pose | None = None
    covariance: NDArray[np.float64] | None = None
    inliers: int = 0
    iterations: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    reason: str = ""

    def sigma_position(self) -> float | None:
        """Predicted standard deviation of the camera centre (m): root of the covariance's trace.

        With ``exp(omega, v) @ (R, t)`` the centre ``-R^T t`` moves by ``-R^T v`` to first order, so
        only the translation block matters.
        """
        if self.covariance is None:
            return None
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


class Stopwatch:
    """Seconds per stage of one localization."""

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
        """Short name, as on the command line."""
        ...

    @property
    def config(self) -> BaseModel:
        """Everything that changes the result; written into the results file."""
        ...

    @property
    def weights_sha256(self) -> str | None:
        """Digest of learned weights, None for methods without."""
        ...

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Build the per-map state once.

        Args:
            sparse_map: the map; image names are relative to ``images``.
            images: folder of the map's photographs.
            cache: folder for state that outlives the process, or None to keep none. Entries are
                keyed by a digest of map, weights and configuration.

        Raises:
            InputError: the map is empty or a photograph is missing or broken.
        """
        ...

    def localize(self, query: Query) -> Estimate:
        """Find the pose. A query that cannot be localized is an answer, not an exception."""
        ...
