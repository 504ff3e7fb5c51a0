"""Localization of a sequence: the predicted motion of the camera is the prior of the next image.

Every image is localized in the map, so that errors do not accumulate; the motion only gives the
prior. A pose that contradicts the motion is checked by a search without the motion. After several
successive failures the camera is lost, and the next image is localized without the motion.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from pydantic import Field

from objconnect.localization.pipeline.failures import localize_safely, localize_with_retry
from objconnect.localization.pipeline.motion import Array, Motion, MotionOptions
from objconnect.scene.config import Config, load_config
from objconnect.scene.localizer import Estimate, Localizer, Prior, Query, Status
from objconnect.scene.storage.records import Record

# Lower bound of a prior's position sigmas, metres.
_MIN_SIGMA_M: Final = 1e-3
# Sigma of the predicted attitude (degrees per axis) above which the camera is lost.
_LOST_SIGMA_DEG: Final = 30.0
# After this many successive poses of one motion, a search result that contradicts the motion is
# rejected, unless localization near the predicted pose gave the same pose.
_MIN_CONFIRMED_POSES: Final = 3
# Two poses within this distance and angle are the same.
_SAME_POSE_M: Final = 0.5
_SAME_POSE_DEG: Final = 2.0
# Sigmas per axis that a pose without covariance is assumed to have.
_UNKNOWN_SIGMA_M: Final = 1.0
_UNKNOWN_SIGMA_DEG: Final = 2.0
_CONTRADICTED: Final = "the pose contradicts the motion of the camera"


class SequenceConfig(Config):
    """Options of a sequence: agreement of poses with the motion, and loss of the camera."""

    motion: MotionOptions = Field(
        MotionOptions(), description="Noise of the motion model of aircraft and gimbal."
    )
    gate: float = Field(
        22.5,
        gt=0,
        description="Gate: squared Mahalanobis distance from the predicted pose below which a pose "
        "agrees with it; 99.9 % of right poses do (6 degrees of freedom).",
    )
    lost_after: int = Field(
        4, ge=1, description="Number of successive failures after which the camera is lost."
    )
    lost_sigma_m: float = Field(
        15.0,
        gt=0,
        description="Standard deviation of the predicted position per axis above which the camera "
        "is lost, m.",
    )


class _Settings(Record):
    """The settings of a command that belong to a sequence."""

    sequence: SequenceConfig = SequenceConfig()


def sequence_config(settings: dict[str, Any]) -> SequenceConfig:
    """Remove the settings of a sequence, ``sequence.KEY``, from ``settings`` and return them.

    Args:
        settings: values by key; the keys of the sequence are removed.

    Raises:
        InputError: a key of the sequence is unknown, or its value is invalid.
    """
    keys = [key for key in settings if key.partition(".")[0] == "sequence"]
    return load_config(_Settings, None, {key: settings.pop(key) for key in keys}).sequence


class Tracker:
    """Localizes the images of a sequence, one after the other.

    The state depends on the estimates alone, so that an interrupted run resumes by passing its
    earlier estimates to ``update``.

    Attributes:
        search_count: number of images that were searched without the motion.
    """

    def __init__(self, localizer: Localizer, config: SequenceConfig) -> None:
        """Begin a sequence with a method that is prepared for the map."""
        self._localizer, self._config = localizer, config
        self._motion: Motion | None = None
        self._failures = self._agreeing_poses = 0
        self.search_count = 0

    def localize(self, query: Query, seconds: float) -> Estimate:
        """Localize the next image; call ``update`` with the estimate.

        Args:
            query: the image; its prior, if any, is the measurement of the aircraft.
            seconds: time of the image from the start of the sequence, later than those of all
                earlier images.
        """
        predicted = self._predict(seconds)
        if predicted is None:
            return self._search(query)
        near = self._localize_near(query, predicted, tracked=True)
        if near.is_tracked and not self._agrees_with_both(near, predicted, query.prior):
            near = self._localize_near(query, predicted, tracked=False)
        if self._agrees_with_both(near, predicted, query.prior):
            return near
        found = self._search(query)
        if found.status is not Status.OK:
            return found
        confirmed = self._is_same_pose(near, found) or self._agrees_with_motion(found, predicted)
        if confirmed or self._agreeing_poses < _MIN_CONFIRMED_POSES:
            return found
        return Estimate(Status.FAILED, seconds=found.seconds, reason=_CONTRADICTED)

    def update(self, estimate: Estimate, seconds: float) -> None:
        """Update the motion with an estimate of this run or of the interrupted run.

        Args:
            estimate: estimate of the image.
            seconds: time of the image from the start of the sequence.
        """
        pose = estimate.cam_from_world
        if estimate.status is not Status.OK or pose is None:
            self._failures += 1
            if self._failures >= self._config.lost_after:
                self._motion, self._agreeing_poses = None, 0
            return
        predicted = self._predict(seconds)
        covariance, options = self._covariance(estimate), self._config.motion
        self._failures = 0
        if predicted is None or not self._agrees_with_motion(estimate, predicted):
            self._motion, self._agreeing_poses = Motion.begin(seconds, pose, covariance, options), 1
        else:
            self._motion = predicted.correct(pose, covariance, options)
            self._agreeing_poses += 1

    def _predict(self, seconds: float) -> Motion | None:
        """Return the state at a time; None if the camera is lost."""
        if self._motion is None:
            return None
        predicted = self._motion.predict(seconds, self._config.motion)
        has_position = predicted.sigma_m < self._config.lost_sigma_m
        return predicted if has_position and predicted.sigma_deg < _LOST_SIGMA_DEG else None

    def _localize_near(self, query: Query, predicted: Motion, tracked: bool) -> Estimate:
        """Localize an image near the predicted pose; ``tracked`` sets ``Query.tracked``."""
        with_prior = replace(query, prior=predicted.prior, tracked=tracked)
        return localize_safely(self._localizer, with_prior)

    def _agrees_with_both(self, estimate: Estimate, predicted: Motion, prior: Prior | None) -> bool:
        """Return whether an estimate agrees with the motion and with the aircraft's prior."""
        as_predicted = self._agrees_with_motion(estimate, predicted)
        return as_predicted and self._agrees_with_prior(estimate, prior)

    def _search(self, query: Query) -> Estimate:
        """Localize an image without the motion."""
        self.search_count += 1
        return localize_with_retry(self._localizer, query)

    def _agrees_with_motion(self, estimate: Estimate, predicted: Motion) -> bool:
        """Return whether an estimate agrees with the motion."""
        pose = estimate.cam_from_world
        if estimate.status is not Status.OK or pose is None:
            return False
        covariance = self._covariance(estimate)
        return predicted.distance(pose, covariance, self._config.motion) < self._config.gate

    def _agrees_with_prior(self, estimate: Estimate, prior: Prior | None) -> bool:
        """Return whether an estimate agrees with the prior's position; True if its sigma is
        unknown."""
        pose = estimate.cam_from_world
        if prior is None or prior.position_sigma is None or pose is None:
            return True
        sigma = np.maximum(prior.position_sigma, _MIN_SIGMA_M)
        errors = (pose.centre().numpy() - prior.position) / sigma
        return bool(errors @ errors < self._config.gate)

    def _is_same_pose(self, estimate: Estimate, other: Estimate) -> bool:
        """Return whether two estimates have nearly the same pose."""
        if estimate.status is not Status.OK or other.status is not Status.OK:
            return False
        if estimate.cam_from_world is None or other.cam_from_world is None:
            return False
        metres, degrees = estimate.cam_from_world.error_to(other.cam_from_world)
        return float(metres) < _SAME_POSE_M and float(degrees) < _SAME_POSE_DEG

    def _covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (6, 6) of an estimate's centre and attitude in the world."""
        stated = estimate.world_covariance()
        if stated is not None and np.isfinite(stated).all():
            return stated
        sigmas = [_UNKNOWN_SIGMA_M] * 3 + [np.radians(_UNKNOWN_SIGMA_DEG)] * 3
        return np.diag(np.square(sigmas))
