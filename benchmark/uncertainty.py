"""Is the predicted covariance honest, and does it tell good poses from bad ones?"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.score import Interval, Outcome, Threshold, is_correct, wilson
from scene.geometry.pose import Pose

DEGREES_OF_FREEDOM: Final = 6
# 95 % quantile of chi-square with 6 degrees of freedom.
_CHI2_95: Final = 12.591587243743977


class Predicted(Outcome, Protocol):
    """A scored query with what the method believed about its pose."""

    @property
    def nees(self) -> float | None: ...
    @property
    def sigma_t_m(self) -> float | None: ...


class Consistency(NamedTuple):
    """How the errors compare with the predicted covariances.

    Attributes:
        queries: localized queries with a covariance.
        mean: of the normalised estimation error squared; 6 when the covariance is right.
        median: likewise, 5.35.
        within_95: percent inside the 95 % ellipsoid, with its Wilson interval.
    """

    queries: int
    mean: float
    median: float
    within_95: Interval


def normalised_error(
    estimate: Pose, reference: Pose, covariance: NDArray[np.float64] | None
) -> float | None:
    """Normalised estimation error squared (NEES) of a pose.

    With the error e in the left tangent, ``reference = exp(e) @ estimate``, it is e' S^-1 e, which
    follows chi-square with 6 degrees of freedom when S is right (Bar-Shalom, Li and Kirubarajan,
    "Estimation with Applications to Tracking and Navigation", 2001, 5.4.2).

    Args:
        estimate: ``cam_from_world``.
        reference: the truth.
        covariance: (6, 6), rotation (rad) then translation (m), or None.

    Returns:
        None without a covariance, or with one that is not positive definite.
    """
    if covariance is None or not np.isfinite(covariance).all():
        return None
    error = (reference @ estimate.inverse()).log().numpy()
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    value = float(np.square(np.linalg.solve(lower, error)).sum())
    return value if np.isfinite(value) else None


def consistency(outcomes: Sequence[Predicted]) -> Consistency | None:
    """Over the queries of status ``ok`` with a NEES; None when there is none."""
    values = [o.nees for o in outcomes if o.status == "ok" and o.nees is not None]
    if not values:
        return None
    inside = sum(value <= _CHI2_95 for value in values)
    low, high = wilson(inside, len(values))
    share = Interval(100 * inside / len(values), 100 * low, 100 * high)
    return Consistency(len(values), fmean(values), median(values), share)


def risk_coverage(outcomes: Sequence[Predicted], threshold: Threshold) -> list[tuple[float, float]]:
    """How often answers are wrong when only the surest are believed.

    Queries are sorted by predicted sigma of the position, surest first; those that have none come
    last, and so do failures (Geifman and El-Yaniv, NeurIPS 2017).

    Returns:
        (coverage, risk) in percent after each query: the share believed, and of these the share
        that is wrong.
    """

    def doubt(outcome: Predicted) -> float:
        known = outcome.status == "ok" and outcome.sigma_t_m is not None
        return outcome.sigma_t_m if known and outcome.sigma_t_m is not None else np.inf

    wrong, curve = 0, []
    for count, outcome in enumerate(sorted(outcomes, key=doubt), 1):
        wrong += not is_correct(outcome, threshold)
        curve.append((100 * count / len(outcomes), 100 * wrong / count))
    return curve
