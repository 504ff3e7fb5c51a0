"""Scoring of pose errors: recall and integrity with their intervals, and median errors."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Final, NamedTuple, Protocol

from benchmark.scoring.intervals import Interval, share
from objconnect.scene.flights.reference_error import ReferencePoseError
from objconnect.scene.localizer import Status


class Threshold(NamedTuple):
    """The limits of a correct pose; both errors must be smaller than their limit."""

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

WRONG_M: Final = 1.0
"""An answer with a larger position error, metres, is a wrong answer."""

WRONG_TEXT: Final = f"{WRONG_M:g} m"
"""The name of this bound in lists of thresholds, see ``list_unjudged``."""

# An answer that repeats its prior differs from it by rounding alone, metres.
_ROUNDING_M: Final = 1e-6


def list_unjudged(error: ReferencePoseError) -> tuple[str, ...]:
    """Return the thresholds, finest first, for which reference poses are too inexact."""
    bounds = {str(each): each.metres for each in THRESHOLDS} | {WRONG_TEXT: WRONG_M}
    ranked = sorted(bounds.items(), key=lambda bound: bound[1])
    return tuple(text for text, metres in ranked if not error.can_judge(metres))


class Outcome(Protocol):
    """A scored query: its status and, where it has a pose, the errors of the pose."""

    @property
    def status(self) -> Status: ...
    @property
    def t_err_m(self) -> float | None: ...
    @property
    def r_err_deg(self) -> float | None: ...


class OutcomeWithPrior(Outcome, Protocol):
    """A scored query with the error of its prior's position, None without a position."""

    @property
    def prior_t_m(self) -> float | None: ...


class ClusteredOutcome(Outcome, Protocol):
    """A scored query with its flight path (course), along which errors are correlated."""

    @property
    def course_name(self) -> str: ...


class ClusteredOutcomeWithPrior(ClusteredOutcome, OutcomeWithPrior, Protocol):
    """A scored query with its course and the error of its prior's position."""


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

    Such a pose misleads a vehicle that navigates by it; a fallback or a failed query does not.
    """
    if outcome.status is not Status.OK or outcome.t_err_m is None or outcome.r_err_deg is None:
        return False
    return outcome.t_err_m > FALSE_FIX.metres or outcome.r_err_deg > FALSE_FIX.degrees


def is_wrong(outcome: Outcome) -> bool:
    """Return whether the position of an answer, a pose of status ``ok``, is off by over 1 m."""
    return outcome.status is Status.OK and (outcome.t_err_m or 0.0) > WRONG_M


def is_worse_than_prior(outcome: OutcomeWithPrior) -> bool:
    """Return whether an answer, a pose of status ``ok``, is farther off than its prior's position.

    It is False for a query that was given no position.
    """
    if outcome.status is not Status.OK or outcome.t_err_m is None or outcome.prior_t_m is None:
        return False
    return outcome.t_err_m > outcome.prior_t_m + _ROUNDING_M


def recall(outcomes: Sequence[ClusteredOutcome], threshold: Threshold) -> Interval:
    """Return the percentage of all queries that are correct, with its 95 % interval by course."""
    return _share(outcomes, [is_correct(outcome, threshold) for outcome in outcomes])


def false_fixes(outcomes: Sequence[ClusteredOutcome]) -> Interval:
    """Return the percentage of all queries that are false fixes, with its interval by course."""
    return _share(outcomes, [is_false_fix(outcome) for outcome in outcomes])


def wrong_answers(outcomes: Sequence[ClusteredOutcome]) -> Interval:
    """Return the percentage of all queries whose answer is off by over 1 m, with its interval."""
    return _share(outcomes, [is_wrong(outcome) for outcome in outcomes])


def worse_than_prior(outcomes: Sequence[ClusteredOutcomeWithPrior]) -> Interval | None:
    """Return the percentage of queries whose answer is farther off than the prior's position.

    Only queries whose prior has a position are counted. The interval is by course. The result is
    None without such a query.
    """
    known = [outcome for outcome in outcomes if outcome.prior_t_m is not None]
    return _share(known, [is_worse_than_prior(outcome) for outcome in known]) if known else None


def _share(outcomes: Sequence[ClusteredOutcome], flags: Sequence[bool]) -> Interval:
    return share(flags, [outcome.course_name for outcome in outcomes])


def median_errors(outcomes: Sequence[Outcome]) -> tuple[float | None, float | None]:
    """Return the median position error (m) and rotation error (deg) of the queries with a pose.

    Fallback poses are included and failed queries are not, so read the medians together with the
    recall. Both are None where no query has a pose.
    """
    metres = [outcome.t_err_m for outcome in outcomes if outcome.t_err_m is not None]
    degrees = [outcome.r_err_deg for outcome in outcomes if outcome.r_err_deg is not None]
    return median(metres) if metres else None, median(degrees) if degrees else None
