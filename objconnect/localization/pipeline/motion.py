"""A Kalman filter of a camera's motion with constant velocity and turn rate.

Accelerations are white noise that is constant between frames (Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001, section 6.3.2). Position and attitude
have separate filters. The attitude's state is a small rotation about the east, north and up axes on
top of the estimate, to first order (Sola, Quaternion kinematics for the error-state Kalman filter,
2017).
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
        description="Standard deviation per axis that is added to that of a measured position, m: "
        "the covariance of a pose does not include errors of the map.",
    )
    least_sigma_deg: float = Field(
        0.2,
        gt=0,
        description="Standard deviation per axis that is added to that of a measured attitude, "
        "deg.",
    )


@dataclass(frozen=True)
class Motion:
    """The state of the filter: pose, velocity, turn rate and their covariances.

    Attributes:
        pose: ``cam_from_world``.
        velocity: (3,) of the camera centre, m/s.
        turn: (3,) rate of the camera's attitude about east, north and up, rad/s.
        position_covariance: (6, 6) of centre and velocity.
        attitude_covariance: (6, 6) of attitude and turn rate.
    """

    seconds: float
    pose: Pose
    velocity: Array
    turn: Array
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
        measured = _floor(covariance, options)
        unknown = options.speed**2, np.radians(options.turn_deg) ** 2
        position, attitude = np.zeros((6, 6)), np.zeros((6, 6))
        position[:3, :3], attitude[:3, :3] = measured[:3, :3], measured[3:, 3:]
        position[3:, 3:], attitude[3:, 3:] = (rate * np.eye(3) for rate in unknown)
        return Motion(seconds, pose, np.zeros(3), np.zeros(3), position, attitude)

    def after(self, seconds: float, options: MotionOptions) -> Motion:
        """Return the state predicted for a later time."""
        step = seconds - self.seconds
        flow = np.kron(np.array([[1.0, step], [0.0, 1.0]]), np.eye(3))
        shape = np.array([[step**4 / 4, step**3 / 2], [step**3 / 2, step**2]])
        noise = np.kron(shape, np.eye(3))
        turned = so3_exp(torch.from_numpy(step * self.turn))
        rotation = self.pose.rotation @ turned.T
        centre = self.pose.centre() + torch.from_numpy(step * self.velocity)
        return replace(
            self,
            seconds=seconds,
            pose=Pose(rotation, -rotation @ centre),
            position_covariance=flow @ self.position_covariance @ flow.T
            + options.acceleration**2 * noise,
            attitude_covariance=flow @ self.attitude_covariance @ flow.T
            + np.radians(options.turn_acceleration_deg) ** 2 * noise,
        )

    def correct(self, pose: Pose, covariance: Array, options: MotionOptions) -> Motion:
        """Return the state after a pose measured at its time.

        Args:
            pose: measured ``cam_from_world``.
            covariance: (6, 6) of its centre and attitude, about east, north and up.
            options: noise of the filter.
        """
        measured = _floor(covariance, options)
        innovation = self.innovation(pose)
        moved, position = _update(self.position_covariance, innovation[:3], measured[:3, :3])
        turned, attitude = _update(self.attitude_covariance, innovation[3:], measured[3:, 3:])
        rotation = self.pose.rotation @ so3_exp(torch.from_numpy(turned[:3])).T
        centre = self.pose.centre() + torch.from_numpy(moved[:3])
        return Motion(
            self.seconds,
            Pose(rotation, -rotation @ centre),
            self.velocity + moved[3:],
            self.turn + turned[3:],
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
        """Return the squared Mahalanobis distance of a measured pose, of 6 degrees of freedom."""
        measured = _floor(covariance, options)
        innovation, total = self.innovation(pose), 0.0
        for rows, own in (
            (slice(3), self.position_covariance),
            (slice(3, 6), self.attitude_covariance),
        ):
            spread = own[:3, :3] + measured[rows, rows]
            total += float(innovation[rows] @ np.linalg.solve(spread, innovation[rows]))
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


def _floor(covariance: Array, options: MotionOptions) -> Array:
    """Return a measured covariance (6, 6) plus the variances of ``least_sigma_*``."""
    least = [options.least_sigma_m] * 3 + [np.radians(options.least_sigma_deg)] * 3
    floored: Array = covariance + np.diag(np.square(least))
    return floored


def _update(covariance: Array, innovation: Array, measured: Array) -> tuple[Array, Array]:
    """Return the Kalman correction (6,) of value and rate, and the covariance (6, 6) after it."""
    total, crossed = covariance[:3, :3] + measured, covariance[:3]
    # NumPy would start LAPACK's threads, which takes 2 ms.
    gain = torch.linalg.solve(torch.from_numpy(total), torch.from_numpy(crossed)).numpy().T
    remaining = np.eye(6) - gain @ np.eye(3, 6)
    # Joseph's form stays symmetric and positive.
    after = remaining @ covariance @ remaining.T + gain @ measured @ gain.T
    return gain @ innovation, after
