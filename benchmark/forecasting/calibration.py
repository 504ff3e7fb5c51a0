"""Probability of an accurate pose (*fix*) from views of a site's rendered copy (*twin*).

A twin is not the site, and rendered snow is not the next winter's snow, so that the share of views
with a fix is not yet a probability. A small logistic model turns the results of views around a
waypoint into a probability. Its parameters were fitted to training towns
(``experiments.forecast``) and regularized towards the smoothed share itself, which is the
probability for methods without a calibration. A training town is rendered twice: as its twin made
from summer views, and as the town itself in its own seasons. The renders of the town itself are the
true queries.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.storage.files import parse_json
from objconnect.scene.storage.records import Record

Array = NDArray[np.float64]

FEATURES: Final = ("constant", "logit of the share of fixes", "log of inliers", "log of points")
# With these weights, the probability is the smoothed share of views with a fix.
_PRIOR_WEIGHTS: Final = np.array([0.0, 1.0, 0.0, 0.0])
# Usual values of the features. They are subtracted, so that the weight of the constant is small.
_CENTRE: Final = np.array([0.0, 0.0, 3.0, 5.0])
# Strength of the ridge penalty on the difference from ``_PRIOR_WEIGHTS``.
_RIDGE: Final = np.array([0.3, 3.0, 3.0, 3.0])
_ITERATIONS: Final = 50  # number of Newton steps
_PSEUDO_COUNT: Final = 0.5  # added to the numbers of views with and without a fix
# The risk of a false fix is regularized by this number of additional views, whose share of false
# fixes is ``Calibration.false_share``.
_PSEUDO_VIEWS: Final = 6.0
# Standard deviation (m) of the Gaussian weights of neighbours: a view of a waypoint this far away
# has 61 % of the weight of a view of the waypoint itself.
POOL_M: Final = 20.0


class Calibration(Record):
    """The calibration of a method, fitted on training towns.

    Attributes:
        weights: weights of ``FEATURES``.
        across_scale: factor of predicted horizontal standard deviations.
        up_scale: factor of predicted vertical ones.
        false_share: share of the true queries that were false fixes.
        queries: number of true queries that it was fitted to; 0 without a calibration.
        source: the training towns.
    """

    weights: tuple[float, float, float, float]
    across_scale: float = 1.0
    up_scale: float = 1.0
    false_share: float = 0.02
    queries: int = 0
    source: str = "none: the smoothed share of views with a fix"


UNCALIBRATED: Final = Calibration(weights=(0.0, 1.0, 0.0, 0.0))


class Evidence(NamedTuple):
    """The pooled results of the views around each of N waypoints in one season.

    Attributes:
        views: sum of the weights of views, (N,).
        found: weighted number of fixes, (N,).
        false: weighted number of false fixes, (N,).
        inliers: weighted mean of log(1 + inliers), (N,).
        points: weighted mean of log(1 + points of the map in view), (N,).
        sigma_across_m: predicted horizontal standard deviation of fixes relative to the map,
            geometric mean, (N,); NaN where no fix has one.
        sigma_up_m: the vertical one.
    """

    views: Array
    found: Array
    false: Array
    inliers: Array
    points: Array
    sigma_across_m: Array
    sigma_up_m: Array


class ViewResult(NamedTuple):
    """The result of one view, from which evidence is pooled; unknown sigmas are NaN."""

    waypoint: int
    fix: bool
    false: bool
    inliers: int
    points: int
    sigma_across_m: float
    sigma_up_m: float


def pool(results: Sequence[ViewResult], centres: Array) -> Evidence:
    """Pool the views of one season over neighbouring waypoints.

    The weight of a view is a Gaussian of the distance between its own waypoint and the waypoint of
    the result, with a standard deviation of 20 m.

    Args:
        results: the views.
        centres: positions of all waypoints, (N, 3) metres.
    """
    waypoint_of = np.array([view.waypoint for view in results])
    distance = np.linalg.norm(centres[:, None] - centres[waypoint_of][None], axis=-1)
    weight = np.exp(-0.5 * np.square(distance / POOL_M))  # (N, views)
    fix = np.array([view.fix for view in results], float)

    def mean(values: Array, used: Array) -> Array:
        """Return, at each waypoint, the weighted mean over the views where ``used`` is 1."""
        total = weight @ used
        return np.divide(
            weight @ np.where(used > 0, used * values, 0.0),
            total,
            out=np.full(len(centres), np.nan),
            where=total > 1e-9,
        )

    ones = np.ones(len(results))
    sigma = np.array([(view.sigma_across_m, view.sigma_up_m) for view in results]).reshape(-1, 2)
    has_sigma = fix * (np.isfinite(sigma) & (sigma > 0)).all(1)
    log_sigma = np.log(np.where(has_sigma[:, None] > 0, sigma, 1.0))
    return Evidence(
        views=weight.sum(1),
        found=weight @ fix,
        false=weight @ np.array([view.false for view in results], float),
        inliers=mean(np.log1p([view.inliers for view in results]), ones),
        points=mean(np.log1p([view.points for view in results]), ones),
        sigma_across_m=np.exp(mean(log_sigma[:, 0], has_sigma)),
        sigma_up_m=np.exp(mean(log_sigma[:, 1], has_sigma)),
    )


def features(evidence: Evidence) -> Array:
    """Return the features (N, 4) of the logistic model, see ``FEATURES``."""
    share = (evidence.found + _PSEUDO_COUNT) / (evidence.views + 2 * _PSEUDO_COUNT)
    columns = (np.ones(len(share)), np.log(share / (1 - share)), evidence.inliers, evidence.points)
    return np.asarray(np.stack(columns, -1) - _CENTRE)


def probability(evidence: Evidence, calibration: Calibration) -> Array:
    """Return the probability of a fix at each waypoint, (N,)."""
    return _sigmoid(features(evidence) @ np.array(calibration.weights))


def false_risk(evidence: Evidence, calibration: Calibration) -> Array:
    """Return the probability of a false fix at each waypoint, (N,)."""
    pseudo_false = _PSEUDO_VIEWS * calibration.false_share
    return np.asarray((evidence.false + pseudo_false) / (evidence.views + _PSEUDO_VIEWS))


def fit(rows: Array, is_fix: NDArray[np.bool_]) -> tuple[float, float, float, float]:
    """Return the weights of the features that best predict fixes.

    They minimize the logarithmic loss plus a quadratic penalty on the difference from the weights
    that give the smoothed share, by Newton's method.

    Args:
        rows: features (M, 4) at M waypoints.
        is_fix: whether the true query at each was a fix, (M,).
    """
    weights = _PRIOR_WEIGHTS.copy()
    truth = is_fix.astype(float)
    for _ in range(_ITERATIONS):
        p = _sigmoid(rows @ weights)
        gradient = rows.T @ (p - truth) + _RIDGE * (weights - _PRIOR_WEIGHTS)
        hessian = (rows * (p * (1 - p))[:, None]).T @ rows + np.diag(_RIDGE)
        step = np.linalg.solve(hessian, gradient)
        weights = weights - step / max(1.0, float(np.abs(step).max()))
    a, b, c, d = (round(float(value), 4) for value in weights)
    return a, b, c, d


def calibration_of(method: str, wanted: bool = True) -> Calibration:
    """Return the calibration of a method; ``UNCALIBRATED`` if there is none or none is wanted."""
    return _load_shipped().get(method, UNCALIBRATED) if wanted else UNCALIBRATED


@cache
def _load_shipped() -> dict[str, Calibration]:
    text = (files("benchmark.forecasting") / "calibration.json").read_text(encoding="utf-8")
    return {name: Calibration.model_validate(values) for name, values in parse_json(text).items()}


def _sigmoid(x: Array) -> Array:
    return np.asarray(1 / (1 + np.exp(-np.clip(x, -30, 30))))
