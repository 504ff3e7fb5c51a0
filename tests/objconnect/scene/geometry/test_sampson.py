from __future__ import annotations

import numpy as np
import torch

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.sampson import Matches, refine

CAMERA = Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0))
DOWN = torch.diag(torch.tensor([1.0, -1, -1], dtype=torch.float64))


def at(*place: float) -> Pose:
    """A camera that looks down, tilted a little."""
    tilt = Pose.exp(torch.tensor([0.1, -0.05, 0.2, 0, 0, 0], dtype=torch.float64)).rotation
    rotation = tilt @ DOWN
    return Pose(rotation, -(rotation @ torch.tensor(place, dtype=torch.float64)))


TRUTH = at(2.0, 1.0, 50.0)
OTHERS = [at(-12.0, 3.0, 52.0), at(9.0, 14.0, 47.0), at(5.0, -15.0, 51.0)]
NEAR = Pose.exp(torch.tensor([0.02, -0.03, 0.01, 0.8, -0.5, 1.0], dtype=torch.float64)) @ TRUTH


def matches(noise: float = 0.0, seed: int = 0, wrong: float = 0.0) -> list[Matches]:
    rng = np.random.default_rng(seed)
    found = []
    for other in OTHERS:
        points = torch.from_numpy(rng.uniform([-25, -25, 0], [25, 25, 12], (150, 3)))
        rays = []
        for pose in (TRUTH, other):
            xy = CAMERA.project(pose.transform(points)).xy
            rays.append(
                CAMERA.unproject(xy + noise * torch.from_numpy(rng.normal(size=(150, 2))))[0]
            )
        bad = torch.from_numpy(rng.uniform(size=150) < wrong)
        rays[1][bad] = rays[1][bad].flip(0)
        found.append(Matches(other, rays[0], rays[1]))
    return found


def test_exact_matches_give_the_exact_pose() -> None:
    refined = refine(NEAR, matches(), CAMERA.focal[0])
    metres, degrees = refined.pose.error_to(TRUTH)
    assert metres < 1e-8
    assert degrees < 1e-8


def test_an_error_is_the_distance_to_the_epipolar_line() -> None:
    """Of a query one pixel off across its lines, both pictures take half in a Sampson error."""
    (exact, *_) = matches()
    shifted = exact.query_rays.clone()
    relative = TRUTH @ exact.reference.inverse()
    line = torch.linalg.cross(
        relative.translation.expand_as(shifted), exact.reference_rays @ relative.rotation.T
    )
    across = line[:, :2] / line[:, :2].norm(dim=1, keepdim=True)
    shifted[:, :2] += across / CAMERA.focal[0]
    error, _ = Matches(exact.reference, shifted, exact.reference_rays).residuals(
        TRUTH, CAMERA.focal[0]
    )
    np.testing.assert_allclose(error.abs(), np.sqrt(0.5), rtol=0.1)


def test_derivatives_are_those_of_autograd() -> None:
    (noisy, *_) = matches(2.0)
    _, jacobian = noisy.residuals(NEAR, CAMERA.focal[0])
    numeric = torch.autograd.functional.jacobian(
        lambda delta: noisy.residuals(Pose.exp(delta) @ NEAR, CAMERA.focal[0])[0],
        torch.zeros(6, dtype=torch.float64),
    )
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-9, atol=1e-7)


def test_a_tenth_of_wrong_matches_does_little() -> None:
    refined = refine(NEAR, matches(0.5, wrong=0.1), CAMERA.focal[0])
    metres, degrees = refined.pose.error_to(TRUTH)
    assert metres < 0.15
    assert degrees < 0.15


def test_the_covariance_is_honest() -> None:
    """Over noise drawn again and again, normalised errors are chi-squared with six degrees."""
    normalised = []
    for seed in range(30):
        refined = refine(NEAR, matches(0.5, seed), CAMERA.focal[0])
        assert refined.covariance is not None
        delta = (TRUTH @ refined.pose.inverse()).log().numpy()
        normalised.append(delta @ np.linalg.solve(refined.covariance, delta))
    assert 3.5 < np.mean(normalised) < 7.5


def test_one_photograph_leaves_the_distance_open() -> None:
    refined = refine(NEAR, matches()[:1], CAMERA.focal[0])
    assert bool(refined.pose.matrix().isfinite().all())
    _, degrees = refined.pose.error_to(TRUTH)
    assert degrees < 1e-3
    assert refined.covariance is None
