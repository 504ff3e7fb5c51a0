"""Bars on a terminal: one in another, and what is shown within a slow query."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from objconnect.scene.runtime import progress
from objconnect.scene.runtime.progress import (
    PATIENCE_S,
    _Terminal,
    one_step,
    progress_bar,
    progress_within,
)


class Terminal(io.StringIO):
    """What a terminal was told."""

    def isatty(self) -> bool:
        return True

    def drawn(self) -> str:
        """Return what the terminal shows now: bars are drawn a few times a second, here at once."""
        assert _Terminal.bars is not None
        self.seek(0)
        self.truncate()
        _Terminal.bars.refresh()
        return self.getvalue()


class Clock:
    """Tells the seconds that a test says."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    told = Terminal()
    monkeypatch.setattr(progress, "Console", lambda stderr: Console(file=told))
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    return told


def work(seconds: float, terminal: Terminal) -> list[str]:
    """What is shown of a query: after each of three steps, and once it is answered."""
    shown, clock = [], Clock()
    with progress_bar("localize", 9) as queries, one_step(clock):
        with progress_within("places aligned", 3, clock) as advance:
            for done in (1, 2, 3):
                clock.now += seconds
                advance(done)
                queries(0)
                shown.append(terminal.drawn())
        queries(1)
        shown.append(terminal.drawn())
    return shown


def test_a_slow_query_shows_its_steps(terminal: Terminal) -> None:
    first, second, third, after = work(PATIENCE_S / 2, terminal)
    assert "localize" in first and "places aligned" not in first
    assert "places aligned" in second and "2/3" in second
    assert "places aligned" in third and "3/3" in third
    assert "localize" in after and "places aligned" not in after


def test_a_fast_query_shows_none(terminal: Terminal) -> None:
    shown = work(PATIENCE_S / 4, terminal)
    assert all("localize" in text for text in shown[:3])
    assert not any("places aligned" in text for text in shown)


def test_time_counts_from_the_beginning_of_the_query(terminal: Terminal) -> None:
    clock = Clock()
    with progress_bar("localize", 9), one_step(clock):
        clock.now += PATIENCE_S + 1
        with progress_within("place search", 12, clock):
            shown = terminal.drawn()
            assert "place search" in shown and "0/12" in shown


def test_a_bar_in_a_bar_is_a_line_below_it(terminal: Terminal) -> None:
    with progress_bar("localize", 9):
        with progress_bar("map features", 56) as advance:
            advance(7)
            shown = terminal.drawn()
            assert shown.index("localize") < shown.index("map features") < shown.index("7/56")
        assert "map features" not in terminal.drawn()
    with progress_bar("another", 2):
        assert "another" in terminal.drawn() and "localize" not in terminal.drawn()


def test_without_a_terminal_nothing_is_said_within(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    bar = progress_bar("localize", 9)
    with bar, one_step(clock), progress_within("places aligned", 3, clock) as advance:
        clock.now += 10 * PATIENCE_S
        advance(1)
    assert capsys.readouterr() == ("", "")


def test_outside_of_a_query_nothing_is_said_within(terminal: Terminal) -> None:
    with progress_bar("localize", 9), progress_within("places aligned", 3) as advance:
        advance(1)
        assert "places aligned" not in terminal.drawn()
