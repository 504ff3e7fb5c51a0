"""Scoring of pose errors: recall with its confidence interval, and median errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import Final, NamedTuple, Protocol

from objconnect.scene.localizer import Status

# Quantile of the normal distribution for a two-sided 95 % interval.
Z_95: Final = 1.959963984540054


class Threshold(NamedTuple):
    """The largest errors of a correct pose; both must be undercut."""

    metres: float
    degrees: float

    @property
    def key(self) -> str:
        """Return the key of the threshold in results files, such as ``0.25m_2deg``."""
        return f"{self.metres:g}m_{self.degrees:g}deg"

    def __str__(self) -> str:
        return f"{self.metres:g} m {self.degrees:g}°"


THRESHOLDS: Final = (Threshold(0.25, 2), Threshold(0.5, 5), Threshold(5, 10))


FALSE_FIX: Final = THRESHOLDS[-1]
"""A pose of status ``ok`` with a larger position or rotation error is a false fix."""


class Outcome(Protocol):
    """A scored query: its status and, where it has a pose, the errors of the pose."""

    @property
    def status(self) -> Status: ...
    @property
    def t_err_m(self) -> float | None: ...
    @property
    def r_err_deg(self) -> float | None: ...


class Interval(NamedTuple):
    """A share of queries with its 95 % interval, all in percent."""

    value: float
    low: float
    high: float


def is_correct(outcome: Outcome, threshold: Threshold) -> bool:
    """Return whether a query counts as localized.

    Its status is ``ok`` and both errors are strictly below the threshold. A fallback pose never
    counts, however small its errors are.
    """
    if outcome.status is not Status.OK or outcome.t_err_m is None or outcome.r_err_deg is None:
        return False
    return outcome.t_err_m < threshold.metres and outcome.r_err_deg < threshold.degrees


def is_false_fix(outcome: Outcome) -> bool:
    """Return whether a pose of status ``ok`` is wrong by more than 5 m or 10 degrees.

    Such a pose misleads whoever flies by it; a fallback or a failed query does not.
    """
    if outcome.status is not Status.OK or outcome.t_err_m is None or outcome.r_err_deg is None:
        return False
    return outcome.t_err_m > FALSE_FIX.metres or outcome.r_err_deg > FALSE_FIX.degrees


def recall(outcomes: Sequence[Outcome], threshold: Threshold) -> Interval:
    """Return the percentage of all queries that are correct, with its Wilson 95 % interval."""
    return _share([is_correct(outcome, threshold) for outcome in outcomes])


def false_fixes(outcomes: Sequence[Outcome]) -> Interval:
    """Return the percentage of all queries that are false fixes, with its Wilson 95 % interval."""
    return _share([is_false_fix(outcome) for outcome in outcomes])


def _share(counted: Sequence[bool]) -> Interval:
    low, high = wilson(sum(counted), len(counted))
    return Interval(100 * sum(counted) / len(counted), 100 * low, 100 * high)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a proportion as fractions in [0, 1].

    Unlike the normal approximation, it does not shrink to a point at 0 and 100 %.

    Args:
        successes: number of successes.
        trials: number of trials, at least 1.
    """
    p, z2 = successes / trials, Z_95 * Z_95
    centre = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials) * math.sqrt(p * (1 - p) / trials + z2 / (4 * trials**2))
    # The interval includes 0 or 1 exactly there, which rounding errors would prevent.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return low, high


def median_errors(outcomes: Sequence[Outcome]) -> tuple[float | None, float | None]:
    """Return the median position error (m) and rotation error (deg) of the queries with a pose.

    Fallback poses are included and failed queries are not, so read the medians together with the
    recall. Both are None where no query has a pose.
    """
    metres = [outcome.t_err_m for outcome in outcomes if outcome.t_err_m is not None]
    degrees = [outcome.r_err_deg for outcome in outcomes if outcome.r_err_deg is not None]
    return median(metres) if metres else None, median(degrees) if degrees else None
