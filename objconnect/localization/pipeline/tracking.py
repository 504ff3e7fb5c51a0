"""Localization of a sequence: what the camera's motion predicts is the prior of the next image.

Every image is localized in the map, so that errors do not add up; the motion only says where to
look. It is believed no further than its covariance: an answer that contradicts it is checked by a
search from what else is known, and after some failures the camera counts as lost, and is searched.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from pydantic import Field

from objconnect.localization.pipeline.failures import localize_retrying, localize_safely
from objconnect.localization.pipeline.motion import Array, Motion, MotionOptions
from objconnect.scene.config import Config, load_config
from objconnect.scene.localizer import Estimate, Localizer, Prior, Query, Status
from objconnect.scene.storage.records import Record

# A position that claims to be more exact than this, metres, counts as this exact.
_MOST_EXACT_M: Final = 1e-3
# The camera is lost, too, when the predicted attitude is less exact than this, degrees per axis.
_LOST_SIGMA_DEG: Final = 30.0
# Answers in a row that agree with the motion, after which a search that contradicts it is not
# believed.
_SURE_AFTER: Final = 3
# Two answers closer than this agree.
_AGREED_M: Final = 0.5
_AGREED_DEG: Final = 2.0
# Sigmas per axis of a pose that states no covariance: metres, degrees.
_UNKNOWN_SIGMA_M: Final = 1.0
_UNKNOWN_SIGMA_DEG: Final = 2.0
_CONTRADICTED = "what was found contradicts the motion of the camera"


class SequenceConfig(Config):
    """When an image of a sequence is believed, and when the camera counts as lost."""

    motion: MotionOptions = Field(MotionOptions(), description="How aircraft and gimbal move.")
    gate: float = Field(
        22.5,
        gt=0,
        description="Squared Mahalanobis distance from the predicted pose below which an answer "
        "agrees with it; of the right answers 99.9 % do (6 degrees of freedom).",
    )
    lost_after: int = Field(
        4, ge=1, description="Images without an answer after which the camera is lost."
    )
    lost_sigma_m: float = Field(
        15.0,
        gt=0,
        description="The camera is lost when the predicted position is less exact than this, "
        "metres per axis.",
    )


class _Settings(Record):
    """What of the settings is of a sequence and not of its method."""

    sequence: SequenceConfig = SequenceConfig()


def sequence_config(settings: dict[str, Any]) -> SequenceConfig:
    """Take the settings of a sequence, ``sequence.KEY``, out of others.

    Args:
        settings: values by key; those of the sequence are removed.

    Raises:
        InputError: a key of the sequence is unknown or its value is bad.
    """
    own = [key for key in settings if key.partition(".")[0] == "sequence"]
    return load_config(_Settings, None, {key: settings.pop(key) for key in own}).sequence


class Tracker:
    """Localizes the images of a sequence, one after the other.

    The state follows from the answers alone, so that an interrupted run is taken up by telling the
    tracker the answers it gave.

    Attributes:
        searched: number of images that were searched so far.
    """

    def __init__(self, localizer: Localizer, config: SequenceConfig) -> None:
        """Begin a sequence with a method that is prepared for the map."""
        self._localizer, self._config = localizer, config
        self._motion: Motion | None = None
        self._failures = self._agreed = 0
        self.searched = 0

    def localize(self, query: Query, seconds: float) -> Estimate:
        """Localize the next image; call ``take`` with the answer.

        Args:
            query: the image, with what the aircraft knows of its pose; its ``prior`` may be None.
            seconds: time of the image, later than those before.
        """
        moving = self._predict(seconds)
        if moving is None:
            return self._search(query)
        near = self._near(query, moving, tracked=True)
        if near.is_tracked and not self._believes(near, moving, query.prior):
            near = self._near(query, moving, tracked=False)
        if self._believes(near, moving, query.prior):
            return near
        found = self._search(query)
        if found.status is not Status.OK:
            return found
        confirmed = self._same(near, found) or self._agrees(found, moving)
        if confirmed or self._agreed < _SURE_AFTER:
            return found
        return Estimate(Status.FAILED, seconds=found.seconds, reason=_CONTRADICTED)

    def take(self, estimate: Estimate, seconds: float) -> None:
        """Take over an answer, of this run or of the one that was interrupted."""
        pose = estimate.cam_from_world
        if estimate.status is not Status.OK or pose is None:
            self._failures += 1
            if self._failures >= self._config.lost_after:
                self._motion, self._agreed = None, 0
            return
        moving = self._predict(seconds)
        covariance, options = self._covariance(estimate), self._config.motion
        self._failures = 0
        if moving is None or not self._agrees(estimate, moving):
            self._motion, self._agreed = Motion.begin(seconds, pose, covariance, options), 1
        else:
            self._motion = moving.correct(pose, covariance, options)
            self._agreed += 1

    def _predict(self, seconds: float) -> Motion | None:
        """Return the state at a time; None where the camera is lost."""
        if self._motion is None:
            return None
        moving = self._motion.after(seconds, self._config.motion)
        known = moving.sigma_m < self._config.lost_sigma_m
        return moving if known and moving.sigma_deg < _LOST_SIGMA_DEG else None

    def _near(self, query: Query, moving: Motion, tracked: bool) -> Estimate:
        """Localize an image from what the motion predicts, and there alone if ``tracked``."""
        asked = replace(query, prior=moving.prior, tracked=tracked)
        return localize_safely(self._localizer, asked)

    def _believes(self, estimate: Estimate, moving: Motion, prior: Prior | None) -> bool:
        """Return whether an answer agrees with the motion and with what the aircraft says."""
        return self._agrees(estimate, moving) and self._fits(estimate, prior)

    def _search(self, query: Query) -> Estimate:
        """Localize an image from what is known without the motion."""
        self.searched += 1
        return localize_retrying(self._localizer, query)

    def _agrees(self, estimate: Estimate, moving: Motion) -> bool:
        """Return whether an answer is a pose that the motion predicts."""
        pose = estimate.cam_from_world
        if estimate.status is not Status.OK or pose is None:
            return False
        covariance = self._covariance(estimate)
        return moving.distance(pose, covariance, self._config.motion) < self._config.gate

    def _fits(self, estimate: Estimate, prior: Prior | None) -> bool:
        """Return whether an answer is where the aircraft says that it is, if it says so."""
        pose = estimate.cam_from_world
        if prior is None or prior.position_sigma is None or pose is None:
            return True
        sigma = np.maximum(prior.position_sigma, _MOST_EXACT_M)
        errors = (pose.centre().numpy() - prior.position) / sigma
        return bool(errors @ errors < self._config.gate)

    def _same(self, estimate: Estimate, other: Estimate) -> bool:
        """Return whether two answers are one pose."""
        if estimate.status is not Status.OK or other.status is not Status.OK:
            return False
        if estimate.cam_from_world is None or other.cam_from_world is None:
            return False
        metres, degrees = estimate.cam_from_world.error_to(other.cam_from_world)
        return float(metres) < _AGREED_M and float(degrees) < _AGREED_DEG

    def _covariance(self, estimate: Estimate) -> Array:
        """Return the covariance (6, 6) of an answer's centre and attitude in the world."""
        stated = estimate.world_covariance()
        if stated is not None and np.isfinite(stated).all():
            return stated
        sigmas = [_UNKNOWN_SIGMA_M] * 3 + [np.radians(_UNKNOWN_SIGMA_DEG)] * 3
        return np.diag(np.square(sigmas))
