"""Residuals of neighbouring matches that are alike, and the covariances that follow."""

from __future__ import annotations

import numpy as np
import pytest

from objconnect.scene.geometry.correlation import estimate_correlation

SIDE, REACH, COUNT = 1000.0, 120.0, 500


def places(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, SIDE, (COUNT, 2))


def lines(xy: np.ndarray) -> np.ndarray:
    """The derivatives (N, 2, 4) of residuals by a shift and a change of size in x and y."""
    jacobian = np.zeros((len(xy), 2, 4))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1
    jacobian[:, 0, 2] = xy[:, 0] / SIDE - 0.5
    jacobian[:, 1, 3] = xy[:, 1] / SIDE - 0.5
    return jacobian


def correlate(xy: np.ndarray, share: float, reach: float, sigma: float) -> np.ndarray:
    """A root of the covariance (N, N) of errors, by the formula of a spherical variogram."""
    t = np.minimum(np.linalg.norm(xy[:, None] - xy[None], axis=2) / reach, 1)
    alike = share * (1 - 1.5 * t + 0.5 * t**3)
    return sigma * np.linalg.cholesky(alike + (1 - share + 1e-9) * np.eye(len(xy)))


def fit(
    xy: np.ndarray, share: float, seed: int, reach: float = REACH
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Errors of parameters, the correlation that is found, and covariances without and with it."""
    rng = np.random.default_rng(seed)
    jacobian = lines(xy)
    errors = correlate(xy, share, REACH, 0.5) @ rng.normal(size=(len(xy), 2))
    flat = jacobian.reshape(-1, 4)
    found = np.linalg.lstsq(flat, errors.ravel(), rcond=None)[0]
    residuals = errors - (flat @ found).reshape(-1, 2)
    pairs = estimate_correlation(xy, residuals, jacobian, reach)
    variance = (residuals**2).sum() / (2 * len(xy) - 4)
    inverse = np.linalg.inv(flat.T @ flat)
    added = inverse @ pairs.information @ inverse * pairs.correlation
    return found, pairs.correlation, variance * inverse, variance * (inverse + added)


@pytest.mark.parametrize(
    ("share", "alone"),
    [
        pytest.param(0.0, 1.0, marks=pytest.mark.thorough),
        pytest.param(0.15, 1.68, marks=pytest.mark.thorough),
        (0.4, 2.81),
    ],
)
def test_covariances_are_those_of_alike_errors(share: float, alone: float) -> None:
    """Over many draws of 500 residuals: the mean NEES of four parameters is four.

    Without, it is ``1 + share * 500 * pi REACH^2 / 5 / SIDE^2``, the integral of the variogram.
    """
    xy = places(np.random.default_rng(0))
    nees = np.empty((60, 2))
    correlations = []
    for seed in range(len(nees)):
        found, correlation, without, covariance = fit(xy, share, seed)
        nees[seed] = [found @ np.linalg.solve(c, found) for c in (without, covariance)]
        correlations.append(correlation)
    mean_without, mean = nees.mean(0) / 4
    assert mean == pytest.approx(1, abs=0.35)
    assert mean_without == pytest.approx(alone, rel=0.25)
    assert np.mean(correlations) == pytest.approx(share, abs=0.06)


def test_without_reach_or_pairs_nothing_is_added() -> None:
    xy = places(np.random.default_rng(1))
    for reach in (0.0, 1e-6):
        _, correlation, without, covariance = fit(xy, 0.4, 0, reach)
        assert correlation == 0
        np.testing.assert_array_equal(without, covariance)


def test_pairs_are_all_pairs() -> None:
    """The strips and the blocks of rows miss none: by the matrix of all of them."""
    rng = np.random.default_rng(2)
    xy, residuals = rng.uniform(0, SIDE, (700, 2)), rng.normal(size=(700, 2))
    jacobian = rng.normal(size=(700, 2, 3))
    t = np.minimum(np.linalg.norm(xy[:, None] - xy[None], axis=2) / REACH, 1)
    weight = (1 - 1.5 * t + 0.5 * t**3) - np.eye(700)
    expected = sum(jacobian[:, axis].T @ weight @ jacobian[:, axis] for axis in range(2))
    pairs = estimate_correlation(xy, residuals, jacobian, REACH)
    np.testing.assert_allclose(pairs.information, expected, atol=1e-8)


def test_residuals_that_differ_from_their_neighbours_add_nothing() -> None:
    xy = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), -1).reshape(-1, 2)
    board = np.where((xy.sum(1) % 2) == 0, 1.0, -1.0)
    residuals = np.stack([board, board], 1)
    assert estimate_correlation(xy, residuals, lines(xy), 3.0).correlation == 0
