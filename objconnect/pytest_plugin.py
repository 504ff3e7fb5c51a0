"""A pytest plugin with a fixture against drops of recall, for any repository that has this package.

``no_recall_drop(results, baseline)`` fails the test that calls it if recall dropped by more than
chance; ``pytest --update-recall`` records the results as the baseline instead.

pytest loads this module in every repository of the environment. A repository may have a package
that is called ``benchmark`` too, so this module does not import ``benchmark``. It runs the
comparison as ``objconnect regress`` in a separate process, which imports this project's
``benchmark``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

# The folder that holds the packages ``objconnect`` and ``benchmark``.
_PACKAGES: Final = Path(__file__).resolve().parents[1]
# Exit code of ``objconnect regress`` that means a drop of recall, and nothing else.
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
        arguments = [f"--against={baseline}", "--", str(results)]
        if request.config.getoption("--update-recall"):
            arguments.insert(0, "--update")
        process = _regress(arguments)
        if process.returncode == _REGRESSION:
            drops = [line for line in process.stdout.splitlines() if line.startswith("DROP")]
            pytest.fail("\n".join(["recall dropped", *drops]), pytrace=False)
        if process.returncode:
            fallback = f"objconnect regress ended with exit code {process.returncode}"
            message = process.stderr.strip() or fallback
            pytest.fail(message, pytrace=False)

    return check


def _regress(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Run ``objconnect regress``, even if the repository has its own package ``benchmark``.

    ``-P`` keeps the working folder off the path, and ``PYTHONPATH`` puts ``_PACKAGES`` first.
    """
    path = os.pathsep.join(filter(None, [str(_PACKAGES), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-P", "-m", "benchmark.cli", "regress", *arguments],
        check=False,
        env={**os.environ, "PYTHONPATH": path, "PYTHONUTF8": "1"},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
    )
