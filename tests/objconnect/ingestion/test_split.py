from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from objconnect.ingestion.neighbours import choose_pairs
from objconnect.ingestion.split import choose_queries, flight_lines
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_gps


def test_lines_of_a_real_flight(beach: Path) -> None:
    """Three lines of six photographs, flown there and back."""
    fixes = read_gps(beach / "gps.csv")
    assert flight_lines(sorted(fixes), fixes) == [0] * 6 + [1] * 6 + [2] * 6


def test_a_photograph_without_a_fix_belongs_to_the_line_before(beach: Path) -> None:
    fixes = read_gps(beach / "gps.csv")
    names = sorted(fixes)
    del fixes[names[8]], fixes[names[0]]
    assert flight_lines(names, fixes) == [0] * 6 + [1] * 6 + [2] * 6


def test_queries_by_photograph_and_by_line(beach: Path) -> None:
    fixes = read_gps(beach / "gps.csv")
    names = sorted(fixes)
    assert choose_queries(names, fixes, "photo", 4) == set(names[2::4])
    assert choose_queries(names, fixes, "line", 3) == set(names[6:12])
    assert choose_queries(names, fixes, "none", 4) == set()
    with pytest.raises(InputError, match="3 lines, too few for a query line among every 8"):
        choose_queries(names, fixes, "line", 8)


def test_pairs_are_near_or_follow_each_other(beach: Path) -> None:
    fixes = read_gps(beach / "gps.csv")
    names = sorted(fixes)
    far = {name: fix * [100, 100, 1] for name, fix in fixes.items()}
    pairs = choose_pairs(names, {**far, names[4]: np.array([1e6, 0, 0])})
    assert len(set(pairs)) == len(pairs)
    assert all(a < b for a, b in pairs)
    # One whose fix is wrong still meets those taken before and after it.
    assert {(names[3], names[4]), (names[4], names[5]), (names[4], names[7])} <= set(pairs)


def test_photographs_without_a_fix_meet_those_around_them(beach: Path) -> None:
    fixes = read_gps(beach / "gps.csv")
    names = sorted(fixes)
    del fixes[names[9]]
    partners = {
        a if b == names[9] else b for a, b in choose_pairs(names, fixes) if names[9] in (a, b)
    }
    assert set(names[:9]) | set(names[10:]) == partners
