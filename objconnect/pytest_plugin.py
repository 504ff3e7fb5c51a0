"""A pytest plugin: the recall gate as a fixture, wherever this package is installed.

``no_recall_drop(results, baseline)`` fails the test that calls it when recall dropped by more than
chance; ``pytest --update-recall`` records the results as the baseline instead.

Pytest loads this module in every repository of the environment. A repository may have a package of
its own that is called ``benchmark``, so nothing of ours but this package is imported here: the
comparison runs as ``objconnect regress`` in a process of its own, which finds ours first.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

# The folder of our packages: a checkout, or that of installed packages.
_OURS: Final = Path(__file__).resolve().parents[1]
# The exit code of a regression, and of nothing else.
_REGRESSION: Final = 1


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option ``--update-recall``, which records results as the baseline."""
    parser.addoption(
        "--update-recall",
        action="store_true",
        help="record the results given to no_recall_drop as its baseline",
    )


@pytest.fixture
def no_recall_drop(request: pytest.FixtureRequest) -> Callable[[Path, Path], None]:
    """Return a function that compares results with recorded ones like ``objconnect regress``."""

    def check(results: Path, baseline: Path) -> None:
        __tracebackhide__ = True
        words = [f"--against={baseline}", "--", str(results)]
        if request.config.getoption("--update-recall"):
            words.insert(0, "--update")
        answer = _regress(words)
        if answer.returncode == _REGRESSION:
            dropped = [line for line in answer.stdout.splitlines() if line.startswith("DROP")]
            pytest.fail("\n".join(["recall dropped", *dropped]), pytrace=False)
        if answer.returncode:
            said = answer.stderr.strip() or f"objconnect regress ended with {answer.returncode}"
            pytest.fail(said, pytrace=False)

    return check


def _regress(words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run ``objconnect regress``, even beside packages with the names of ours.

    ``-P`` keeps the working folder off the path; ``PYTHONPATH`` puts ours before all others.
    """
    path = os.pathsep.join(filter(None, [str(_OURS), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-P", "-m", "benchmark.cli", "regress", *words],
        check=False,
        env={**os.environ, "PYTHONPATH": path, "PYTHONUTF8": "1"},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
    )
