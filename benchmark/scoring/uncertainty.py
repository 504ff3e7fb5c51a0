"""Measures of predicted covariances: whether they match the errors, and whether they rank poses."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.scoring.intervals import Interval, mean_interval, share
from benchmark.scoring.score import ClusteredOutcome, Threshold, is_correct

if TYPE_CHECKING:  # pose.py loads torch
    from objconnect.scene.geometry.pose import Pose

# 95 % quantile of the chi-square distribution with 6 degrees of freedom.
_CHI2_95: Final = 12.591587243743977


class PredictedOutcome(ClusteredOutcome, Protocol):
    """A scored query with the uncertainty that the method predicted for its pose."""

    @property
    def nees(self) -> float | None: ...
    @property
    def sigma_t_m(self) -> float | None: ...
    @property
    def probability(self) -> float | None: ...


class Consistency(NamedTuple):
    """Figures that compare the errors with the predicted covariances.

    Attributes:
        queries: number of localized queries with a covariance.
        mean: mean normalised estimation error squared (NEES); 6 if the covariances are right.
        ends: 95 % interval of the mean by course (flight path); None with one course.
        median: median NEES; 5.35 if the covariances are right.
        within_95: percentage of errors inside the 95 % ellipsoid, with its interval by course.
    """

    queries: int
    mean: float
    ends: tuple[float, float] | None
    median: float
    within_95: Interval


def compute_nees(
    estimate: Pose, reference: Pose, covariance: NDArray[np.float64] | None
) -> float | None:
    """Return the normalised estimation error squared (NEES) of a pose.

    With the error e in the left tangent, ``reference = exp(e) @ estimate``, it is e' S^-1 e, which
    follows chi-square with 6 degrees of freedom if S is right (Bar-Shalom, Li and Kirubarajan,
    "Estimation with Applications to Tracking and Navigation", 2001, 5.4.2).

    Args:
        estimate: estimated pose ``cam_from_world``.
        reference: true pose ``cam_from_world``.
        covariance: (6, 6) covariance of rotation (rad), then translation (m), or None.

    Returns:
        The NEES; None without a covariance, or where it is not positive definite.
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


def consistency(outcomes: Sequence[PredictedOutcome]) -> Consistency | None:
    """Return the consistency over the queries of status ``ok`` with a NEES; None without any."""
    known = [(o.nees, o.course_name) for o in outcomes if o.status == "ok" and o.nees is not None]
    if not known:
        return None
    values, clusters = zip(*known, strict=True)
    share_within = share([value <= _CHI2_95 for value in values], clusters)
    ends = mean_interval(values, clusters)
    if ends is not None:
        ends = max(ends[0], 0.0), ends[1]
    return Consistency(len(values), fmean(values), ends, median(values), share_within)


def doubt(outcome: PredictedOutcome) -> tuple[float, float]:
    """Return the key that sorts answers from the most to the least certain.

    The key is the predicted probability that the pose is wrong, if the method predicts it, then the
    standard deviation of the position. Failed queries, and answers without either, come last.
    """
    if outcome.status != "ok" or (outcome.probability is None and outcome.sigma_t_m is None):
        return np.inf, np.inf
    wrong = 0.0 if outcome.probability is None else 1 - outcome.probability
    return wrong, np.inf if outcome.sigma_t_m is None else outcome.sigma_t_m


def risk_coverage(
    outcomes: Sequence[PredictedOutcome], threshold: Threshold
) -> list[tuple[float, float]]:
    """Return the risk-coverage curve (Geifman and El-Yaniv, NeurIPS 2017), most certain first.

    Returns:
        One pair (coverage, risk) in percent for each query: the share of queries up to this one,
        and the share of wrong poses among them.
    """
    wrong, curve = 0, []
    for count, outcome in enumerate(sorted(outcomes, key=doubt), 1):
        wrong += not is_correct(outcome, threshold)
        curve.append((100 * count / len(outcomes), 100 * wrong / count))
    return curve
