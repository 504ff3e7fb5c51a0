"""The motion model against numbers computed by hand and against a camera that really moves."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from objconnect.localization.pipeline.motion import Motion, MotionOptions
from objconnect.scene.geometry.gimbal import gimbal_pose
from objconnect.scene.geometry.pose import Pose

OPTIONS = MotionOptions()
EXACT = 1e-4 * np.eye(6)


def fly(seconds: float, yaw_rate: float = 10.0, velocity: tuple[float, ...] = (6, -3, 1)) -> Pose:
    """A camera that moves evenly and turns about the vertical, clockwise from above, deg/s."""
    rotation = gimbal_pose(yaw_rate * seconds, -60.0, 0.0).rotation
    centre = torch.tensor(velocity, dtype=torch.float64) * seconds
    return Pose(rotation, -rotation @ centre)


def track(until: int, **how: object) -> Motion:
    motion = Motion.begin(0.0, fly(0.0, **how), EXACT, OPTIONS)
    for k in range(1, until):
        motion = motion.predict(0.5 * k, OPTIONS).correct(fly(0.5 * k, **how), EXACT, OPTIONS)
    return motion


def test_an_even_motion_is_predicted() -> None:
    motion = track(20)
    predicted = motion.predict(10.0, OPTIONS)
    metres, degrees = predicted.pose.error_to(fly(10.0))

    assert float(metres) < 0.05 and float(degrees) < 0.1
    np.testing.assert_allclose(motion.velocity, [6, -3, 1], atol=0.05)
    # A turn clockwise from above is negative about up.
    np.testing.assert_allclose(np.degrees(motion.turn_rate), [0, 0, -10], atol=0.1)


def test_covariance_of_a_prediction_is_that_of_the_equations() -> None:
    """By hand, per axis: m^2 + (v dt)^2 + a^2 dt^4 / 4."""
    options = MotionOptions(
        acceleration=2,
        speed=5,
        turn_deg=10,
        turn_acceleration_deg=20,
        least_sigma_m=0.3,
        least_sigma_deg=0.4,
    )
    motion = Motion.begin(1.0, fly(0.0), 0.16 * np.eye(6), options).predict(3.0, options)

    assert motion.sigma_m == pytest.approx(np.sqrt(0.16 + 0.09 + (5 * 2) ** 2 + 4 * 16 / 4))
    degrees = np.degrees(np.sqrt(0.16)) ** 2 + 0.4**2 + (10 * 2) ** 2 + 20**2 * 16 / 4
    assert motion.sigma_deg == pytest.approx(np.sqrt(degrees))
    np.testing.assert_allclose(motion.prior.position_sigma, motion.sigma_m)


def test_a_correction_weighs_prediction_and_measurement() -> None:
    """Scalar filter by hand: P = 1, R = 3 (with its floor) moves by a quarter of the innovation."""
    options = MotionOptions(least_sigma_m=1.0, least_sigma_deg=1.0)
    motion = Motion.begin(0.0, fly(0.0), np.zeros((6, 6)), options)
    assert motion.sigma_m == pytest.approx(1.0)
    there = Pose(fly(0.0).rotation, -fly(0.0).rotation @ torch.tensor([4.0, 0, 0]).double())

    corrected = motion.correct(there, 2.0 * np.eye(6), options)
    np.testing.assert_allclose(corrected.pose.centre().numpy(), [1.0, 0, 0], atol=1e-12)
    assert corrected.sigma_m == pytest.approx(np.sqrt(0.75))
    # d^2 = 4^2 / (1 + 3)
    assert motion.distance(there, 2.0 * np.eye(6), options) == pytest.approx(4.0)


def test_innovation_of_an_attitude_is_about_the_worlds_axes() -> None:
    motion = Motion.begin(0.0, fly(0.0), EXACT, OPTIONS)
    turned = gimbal_pose(-3.0, -60.0, 0.0)  # counter-clockwise from above: positive about up
    np.testing.assert_allclose(
        np.degrees(motion.innovation(turned)), [0, 0, 0, 0, 0, 3.0], atol=1e-9
    )


def test_an_uneven_motion_stays_within_its_covariance() -> None:
    """Stops, starts and turns of a drone: distances below the 99.9 % point of 6 freedoms, 22.5."""
    times = np.arange(0, 60, 0.5)
    rng = np.random.default_rng(0)
    pushes = rng.normal(0, 2.0, (len(times), 3))
    speed = np.cumsum(0.5 * pushes, axis=0)
    centres = np.cumsum(0.5 * (speed - 0.5 * 0.5 * pushes), axis=0)
    yaw = 40 * np.sin(0.3 * times)
    motion = None
    distances = []
    for time, centre, angle in zip(times, centres, yaw, strict=True):
        rotation = gimbal_pose(float(angle), -70.0, 0.0).rotation
        pose = Pose(rotation, -rotation @ torch.from_numpy(centre))
        if motion is None:
            motion = Motion.begin(float(time), pose, EXACT, OPTIONS)
            continue
        motion = motion.predict(float(time), OPTIONS)
        distances.append(motion.distance(pose, EXACT, OPTIONS))
        motion = motion.correct(pose, EXACT, OPTIONS)
    assert np.quantile(distances, 0.99) < 22.5
    assert float(motion.pose.error_to(pose)[0]) < 0.1
