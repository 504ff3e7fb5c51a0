"""Progress on standard error: a bar on a terminal, lines in a log file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from scene.runtime.escaping import for_terminal

# Without a terminal: seconds until the first line, seconds between lines, and the share of all
# steps after which the next line is written sooner.
_FIRST_S = 10.0
_EVERY_S = 30.0
_EVERY_SHARE = 0.1


@contextmanager
def progress_bar(
    what: str, total: int, clock: Callable[[], float] = monotonic
) -> Iterator[Callable[[int], None]]:
    """Show progress; call the yielded function with the number of steps done so far.

    If standard error is not a terminal but a log file, a line is written now and then. Work of less
    than ten seconds writes none there.

    Args:
        what: name of the work.
        total: number of steps.
        clock: function that returns seconds.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines(for_terminal(what), total, clock)
        return
    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


class _Lines:
    """A writer of progress lines, called with the number of steps done."""

    def __init__(self, what: str, total: int, clock: Callable[[], float]) -> None:
        self._what, self._total, self._clock = what, total, clock
        self._last = clock() + _FIRST_S - _EVERY_S
        self._shown = 0
        # Time and steps of the first call; the steps of an earlier run do not count for the pace.
        self._first: tuple[float, int] | None = None

    def __call__(self, done: int) -> None:
        now = self._clock()
        self._first = self._first or (now, done)
        waited = now - self._last
        further = done - self._shown >= _EVERY_SHARE * self._total and waited >= _FIRST_S
        if waited < _EVERY_S and not (further and self._shown):
            return
        self._last, self._shown = now, done
        left = self._left_s(now, done)
        ending = "" if left is None else f", {_in_words(left)} left"
        with suppress(OSError):  # standard error is closed
            text = f"{self._what}: {done} of {self._total}{ending}"
            print(text, file=sys.stderr, flush=True)

    def _left_s(self, now: float, done: int) -> float | None:
        """Return the seconds left at the pace since the first call; None before there is a pace."""
        assert self._first is not None
        began, before = self._first
        if done <= before or done >= self._total:
            return None
        return (now - began) / (done - before) * (self._total - done)


def _in_words(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
