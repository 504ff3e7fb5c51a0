"""A Kalman filter of a camera's motion with nearly constant velocity and turn rate.

Accelerations are random, constant between two frames and independent of those before (Bar-Shalom,
Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.3.2).
Position and attitude have separate filters. The attitude filter estimates the error of the
attitude, a small rotation about the east, north and up axes, to first order (Sola, Quaternion
kinematics for the error-state Kalman filter, 2017).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from objconnect.scene.config import Config
from objconnect.scene.geometry.pose import Pose, so3_exp, so3_log
from objconnect.scene.localizer import Prior

Array = NDArray[np.float64]


class MotionOptions(Config):
    """Noise of the motion model of aircraft and gimbal."""

    acceleration: float = Field(
        3.0, gt=0, description="Standard deviation of the acceleration per axis, m/s^2."
    )
    turn_acceleration_deg: float = Field(
        30.0, gt=0, description="Standard deviation of the angular acceleration per axis, deg/s^2."
    )
    speed: float = Field(
        10.0,
        gt=0,
        description="Initial standard deviation of the velocity per axis, after one pose, m/s.",
    )
    turn_deg: float = Field(
        20.0,
        gt=0,
        description="Initial standard deviation of the turn rate per axis, after one pose, deg/s.",
    )
    least_sigma_m: float = Field(
        0.1,
        gt=0,
        description="Standard deviation per axis of errors that the covariance of a pose does not "
        "include, such as errors of the map, m. Its square is added to the variances of the "
        "position.",
    )
    least_sigma_deg: float = Field(
        0.2,
        gt=0,
        description="The same for the attitude, deg.",
    )


@dataclass(frozen=True)
class Motion:
    """The state of the filter: pose, velocity, turn rate and their covariances.

    Attributes:
        seconds: time of the state.
        pose: ``cam_from_world``.
        velocity: (3,) of the camera centre to the east, north and up, m/s.
        turn_rate: (3,) of the camera's attitude about east, north and up, rad/s.
        position_covariance: (6, 6) of centre (m) and velocity (m/s).
        attitude_covariance: (6, 6) of attitude (rad) and turn rate (rad/s).
    """

    seconds: float
    pose: Pose
    velocity: Array
    turn_rate: Array
    position_covariance: Array
    attitude_covariance: Array

    @staticmethod
    def begin(seconds: float, pose: Pose, covariance: Array, options: MotionOptions) -> Motion:
        """Return the state after the first pose, with unknown velocity.

        Args:
            seconds: time of the pose.
            pose: ``cam_from_world``.
            covariance: (6, 6) of centre (metres) and attitude (rad), about east, north and up.
            options: initial uncertainty of the velocities.
        """
        measured_covariance = _add_variances(covariance, options)
        rate_variances = options.speed**2, np.radians(options.turn_deg) ** 2
        position, attitude = np.zeros((6, 6)), np.zeros((6, 6))
        position[:3, :3], attitude[:3, :3] = (
            measured_covariance[:3, :3],
            measured_covariance[3:, 3:],
        )
        position[3:, 3:], attitude[3:, 3:] = (rate * np.eye(3) for rate in rate_variances)
        return Motion(seconds, pose, np.zeros(3), np.zeros(3), position, attitude)

    def predict(self, seconds: float, options: MotionOptions) -> Motion:
        """Return the state predicted for a later time."""
        step = seconds - self.seconds
        transition = np.kron(np.array([[1.0, step], [0.0, 1.0]]), np.eye(3))
        noise_of_axis = np.array([[step**4 / 4, step**3 / 2], [step**3 / 2, step**2]])
        noise = np.kron(noise_of_axis, np.eye(3))
        turn = so3_exp(torch.from_numpy(step * self.turn_rate))
        rotation = self.pose.rotation @ turn.T
        centre = self.pose.centre() + torch.from_numpy(step * self.velocity)
        return replace(
            self,
            seconds=seconds,
            pose=Pose(rotation, -rotation @ centre),
            position_covariance=transition @ self.position_covariance @ transition.T
            + options.acceleration**2 * noise,
            attitude_covariance=transition @ self.attitude_covariance @ transition.T
            + np.radians(options.turn_acceleration_deg) ** 2 * noise,
        )

    def correct(self, pose: Pose, covariance: Array, options: MotionOptions) -> Motion:
        """Return the state after a pose was measured at the time of the state.

        Args:
            pose: measured ``cam_from_world``.
            covariance: (6, 6) of its centre (metres) and attitude (rad), about east, north and up.
            options: noise of the filter.
        """
        measured_covariance = _add_variances(covariance, options)
        innovation = self.innovation(pose)
        shift, position = _update(
            self.position_covariance, innovation[:3], measured_covariance[:3, :3]
        )
        turn, attitude = _update(
            self.attitude_covariance, innovation[3:], measured_covariance[3:, 3:]
        )
        rotation = self.pose.rotation @ so3_exp(torch.from_numpy(turn[:3])).T
        centre = self.pose.centre() + torch.from_numpy(shift[:3])
        return Motion(
            self.seconds,
            Pose(rotation, -rotation @ centre),
            self.velocity + shift[3:],
            self.turn_rate + turn[3:],
            position,
            attitude,
        )

    def innovation(self, pose: Pose) -> Array:
        """Return the difference (6,) of a pose from the state: centre (metres), attitude (rad)."""
        centre = pose.centre() - self.pose.centre()
        # A camera that turns by w about the world's axes has the rotation R exp(w)^T.
        attitude = so3_log(pose.rotation.T @ self.pose.rotation)
        return np.concatenate([centre.numpy(), attitude.numpy()])

    def distance(self, pose: Pose, covariance: Array, options: MotionOptions) -> float:
        """Return the squared Mahalanobis distance of a measured pose (6 degrees of freedom).

        Arguments are those of ``correct``.
        """
        measured_covariance = _add_variances(covariance, options)
        innovation, total = self.innovation(pose), 0.0
        for rows, state in (
            (slice(3), self.position_covariance),
            (slice(3, 6), self.attitude_covariance),
        ):
            variance = state[:3, :3] + measured_covariance[rows, rows]
            total += float(innovation[rows] @ np.linalg.solve(variance, innovation[rows]))
        return total

    @property
    def sigma_m(self) -> float:
        """Return the largest standard deviation of the position along an axis, metres."""
        return float(np.sqrt(self.position_covariance.diagonal()[:3].max()))

    @property
    def sigma_deg(self) -> float:
        """Return the largest standard deviation of the attitude about an axis, degrees."""
        return float(np.degrees(np.sqrt(self.attitude_covariance.diagonal()[:3].max())))

    @property
    def prior(self) -> Prior:
        """Return the state as the prior of a query."""
        return Prior(
            position=self.pose.centre().numpy(),
            position_sigma=np.sqrt(self.position_covariance.diagonal()[:3]),
            cam_from_world_rotation=self.pose.rotation.numpy(),
            attitude_sigma_deg=self.sigma_deg,
        )


def _add_variances(covariance: Array, options: MotionOptions) -> Array:
    """Return a measured covariance (6, 6) plus the variances of ``least_sigma_*``."""
    sigmas = [options.least_sigma_m] * 3 + [np.radians(options.least_sigma_deg)] * 3
    total: Array = covariance + np.diag(np.square(sigmas))
    return total


def _update(
    covariance: Array, innovation: Array, measured_covariance: Array
) -> tuple[Array, Array]:
    """Return the Kalman correction (6,) of value and rate, and the covariance (6, 6) after it.

    Args:
        covariance: (6, 6) of value and rate before the measurement.
        innovation: (3,) measured value less the predicted value.
        measured_covariance: (3, 3) covariance of the measured value.
    """
    innovation_covariance, crossed = covariance[:3, :3] + measured_covariance, covariance[:3]
    # torch, because NumPy would start LAPACK's threads, which takes 2 ms.
    gain = (
        torch.linalg.solve(torch.from_numpy(innovation_covariance), torch.from_numpy(crossed))
        .numpy()
        .T
    )
    remaining = np.eye(6) - gain @ np.eye(3, 6)
    # In Joseph's form the covariance stays symmetric and positive definite.
    updated = remaining @ covariance @ remaining.T + gain @ measured_covariance @ gain.T
    return gain @ innovation, updated
