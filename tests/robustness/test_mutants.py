"""Tests fail on mutants; see ``tests.robustness.mutants``."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

import pytest

from tests.robustness.mutants import MUTANTS, ROOT, Mutant, list_unlisted

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_every_mutant_changes_existing_code(mutant: Mutant) -> None:
    assert not list_unlisted(mutant)


def test_an_outdated_mutant_is_an_error() -> None:
    first = MUTANTS[0]
    assert "0 times, not once" in list_unlisted(first._replace(old="TAKEN_OUT: Final = 0.1"))
    assert "no test" in list_unlisted(
        first._replace(killed_by=("tests/test_line.py::test_nothing",))
    )


def require_death(mutants: Sequence[Mutant]) -> None:
    """In a process of its own: those it begins must know nothing of the unchanged tree."""
    command = [
        sys.executable,
        "-m",
        "tests.robustness.mutants",
        *(mutant.name for mutant in mutants),
    ]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("dies") == len(mutants)


# The first of the list are parts that went missing once without a test that noticed.
_EVERY_TIME = 11


def test_mutants_that_once_lived_die() -> None:
    require_death(MUTANTS[:_EVERY_TIME])


@pytest.mark.slow
def test_all_other_mutants_die() -> None:
    require_death(MUTANTS[_EVERY_TIME:])
