"""Progress on standard error: bars on a terminal, lines in a log file.

A bar that starts while another one is shown appears below it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from time import monotonic
from typing import Final

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from objconnect.scene.runtime.escaping import for_terminal

# Without a terminal: seconds before the first line, seconds between lines, and the share of all
# steps after which a line is written earlier.
_FIRST_S = 10.0
_EVERY_S = 30.0
_EVERY_SHARE = 0.1
PATIENCE_S: Final = 5.0
"""Seconds after which work inside a step shows a bar of its own."""


class _Terminal:
    """The one display of the bars of all threads; None while no bar is shown."""

    bars: Progress | None = None


# Start time of this thread's step of a bar.
_STEP_START: ContextVar[float | None] = ContextVar("began", default=None)


@contextmanager
def progress_bar(
    what: str, total: int, clock: Callable[[], float] = monotonic
) -> Iterator[Callable[[int], None]]:
    """Show progress; call the yielded function with the number of steps done so far.

    If standard error is not a terminal, it writes a line now and then, and none in the first ten
    seconds.

    Args:
        what: name of the work.
        total: number of steps.
        clock: returns seconds.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _LogLines(for_terminal(what), total, clock)
        return
    if _Terminal.bars is not None:
        with _bar_below(_Terminal.bars, what, total) as advance:
            yield advance
        return
    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bars:
        task = bars.add_task(what, total=total)
        _Terminal.bars = bars
        try:
            yield lambda done: bars.update(task, completed=done)
        finally:
            _Terminal.bars = None


@contextmanager
def one_step(clock: Callable[[], float] = monotonic) -> Iterator[None]:
    """Mark a block as one step of a bar, from whose start ``progress_within`` counts time."""
    token = _STEP_START.set(clock())
    try:
        yield
    finally:
        _STEP_START.reset(token)


@contextmanager
def progress_within(
    what: str, total: int, clock: Callable[[], float] = monotonic
) -> Iterator[Callable[[int], None]]:
    """Show progress inside one step of a bar after that step has lasted ``PATIENCE_S``.

    Nothing is shown outside of ``one_step`` or without a bar on a terminal.

    Args:
        what: name of the work.
        total: number of its steps.
        clock: clock of ``one_step``.
    """
    bar = _DelayedBar(what, total, clock)
    try:
        bar(0)
        yield bar
    finally:
        bar.end()


class _DelayedBar:
    """A bar below another one that appears after ``PATIENCE_S``; call it with the steps done."""

    def __init__(self, what: str, total: int, clock: Callable[[], float]) -> None:
        self._what, self._total, self._clock = what, total, clock
        self._bar: tuple[Progress, TaskID] | None = None

    def __call__(self, done: int) -> None:
        if self._bar is None:
            bars, began = _Terminal.bars, _STEP_START.get()
            if bars is None or began is None or self._clock() - began < PATIENCE_S:
                return
            self._bar = (
                bars,
                bars.add_task(f"  {for_terminal(self._what)}", total=self._total),
            )
        bars, task = self._bar
        bars.update(task, completed=done)

    def end(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            bars, task = self._bar
            bars.remove_task(task)


@contextmanager
def _bar_below(bars: Progress, what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar below another one during the block."""
    task = bars.add_task(f"  {what}", total=total)
    try:
        yield lambda done: bars.update(task, completed=done)
    finally:
        bars.remove_task(task)


class _LogLines:
    """A writer of progress lines; call it with the number of steps done."""

    def __init__(self, what: str, total: int, clock: Callable[[], float]) -> None:
        self._what, self._total, self._clock = what, total, clock
        self._last = clock() + _FIRST_S - _EVERY_S
        self._shown = 0
        # Time and steps of the first call: the pace leaves out the steps of an earlier run.
        self._first: tuple[float, int] | None = None

    def __call__(self, done: int) -> None:
        now = self._clock()
        self._first = self._first or (now, done)
        waited = now - self._last
        further = done - self._shown >= _EVERY_SHARE * self._total and waited >= _FIRST_S
        if waited < _EVERY_S and not (further and self._shown):
            return
        self._last, self._shown = now, done
        left = self._seconds_left(now, done)
        ending = "" if left is None else f", {_describe_duration(left)} left"
        with suppress(OSError):  # standard error is closed
            text = f"{self._what}: {done} of {self._total}{ending}"
            print(text, file=sys.stderr, flush=True)

    def _seconds_left(self, now: float, done: int) -> float | None:
        """Return the seconds left at the pace since the first call; None without a pace."""
        assert self._first is not None
        began, before = self._first
        if done <= before or done >= self._total:
            return None
        return (now - began) / (done - before) * (self._total - done)


def _describe_duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
