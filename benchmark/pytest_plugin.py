"""For pytest: the gate as a fixture, in any repository where this package is installed.

``no_recall_drop(results, baseline)`` fails the test that calls it when recall dropped by more than
chance; ``pytest --update-recall`` records the results as the baseline instead.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option that records."""
    parser.addoption(
        "--update-recall",
        action="store_true",
        help="record the results given to no_recall_drop as its baseline",
    )


@pytest.fixture
def no_recall_drop(request: pytest.FixtureRequest) -> Callable[[Path, Path], None]:
    """Compares a folder that ``evaluate`` wrote with a recorded one; see ``benchmark.regress``."""
    from benchmark.regress import regress, update
    from scene.errors import InputError

    def check(results: Path, baseline: Path) -> None:
        __tracebackhide__ = True
        try:
            if request.config.getoption("--update-recall"):
                update(results, baseline)
                return
            comparisons = regress(results, baseline)
        except InputError as error:
            pytest.fail(str(error), pytrace=False)
        dropped = [comparison.text() for comparison in comparisons if comparison.dropped]
        if dropped:
            pytest.fail("\n".join(["recall dropped", *dropped]), pytrace=False)

    return check
