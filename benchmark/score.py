"""Scoring: from pose errors to recall with its interval. Pure functions of numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import Final, NamedTuple, Protocol

from scene.localizer import Status

# The normal quantile of a two-sided 95 % interval.
Z_95: Final = 1.959963984540054


class Threshold(NamedTuple):
    """A pose counts as right when it is closer than both."""

    metres: float
    degrees: float

    @property
    def key(self) -> str:
        """As in results files: ``0.25m_2deg``."""
        return f"{self.metres:g}m_{self.degrees:g}deg"

    def __str__(self) -> str:
        return f"{self.metres:g} m {self.degrees:g}°"


THRESHOLDS: Final = (Threshold(0.25, 2), Threshold(0.5, 5), Threshold(5, 10))


class Outcome(Protocol):
    """One scored query: how it ended and, when there is a pose, its errors."""

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
    """Whether a query counts as localized: status ``ok`` and strictly below both thresholds.

    A fallback is not a localization, however close its pose happens to be.
    """
    if outcome.status is not Status.OK or outcome.t_err_m is None or outcome.r_err_deg is None:
        return False
    return outcome.t_err_m < threshold.metres and outcome.r_err_deg < threshold.degrees


def recall(outcomes: Sequence[Outcome], threshold: Threshold) -> Interval:
    """Percent of all listed queries that are correct, with the Wilson 95 % interval."""
    correct = sum(is_correct(outcome, threshold) for outcome in outcomes)
    low, high = wilson(correct, len(outcomes))
    return Interval(100 * correct / len(outcomes), 100 * low, 100 * high)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a proportion, fractions in [0, 1]. ``trials`` is at least 1.

    Unlike the textbook interval it does not shrink to nothing at 0 and 100 %.
    """
    p, z2 = successes / trials, Z_95 * Z_95
    centre = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials) * math.sqrt(p * (1 - p) / trials + z2 / (4 * trials**2))
    # At the ends the interval touches them exactly; rounding would leave it a hair short.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return low, high


def median_errors(outcomes: Sequence[Outcome]) -> tuple[float | None, float | None]:
    """Median position error (m) and rotation error (deg) over the queries that have a pose.

    Fallback poses take part, failed queries cannot; None when no query has a pose. Read the medians
    together with the recall: they know nothing of the queries without a pose.
    """
    metres = [outcome.t_err_m for outcome in outcomes if outcome.t_err_m is not None]
    degrees = [outcome.r_err_deg for outcome in outcomes if outcome.r_err_deg is not None]
    return median(metres) if metres else None, median(degrees) if degrees else None
