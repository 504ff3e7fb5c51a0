"""The gate as users have it: a fixture in their own tests, run by a pytest of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.scene.bundle.scene import Scene
from tests.benchmark.test_regress import GOOD, write

pytestmark = pytest.mark.thorough

pytest_plugins = "pytester"

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples" / "gate"
TEST = """
from pathlib import Path

def test_recall(no_recall_drop):
    no_recall_drop(Path("results"), Path("baseline"))
"""


def test_a_drop_fails_the_test_and_recording_does_not(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(TEST)
    write(pytester.path / "results", GOOD)
    pytester.runpytest().assert_outcomes(failed=1)  # nothing is recorded yet
    pytester.runpytest("--update-recall").assert_outcomes(passed=1)
    pytester.runpytest().assert_outcomes(passed=1)

    write(pytester.path / "results", GOOD | {f"s{k}": 9.0 for k in range(20)})
    result = pytester.runpytest()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["recall dropped", "DROP sift on d (uav-sim), all, 0.25m_2deg: *"])
    assert "Traceback" not in result.stdout.str()


def test_the_example_test_runs_as_it_stands(pytester: pytest.Pytester, rendered: Scene) -> None:
    (pytester.path / "data").mkdir()
    (pytester.path / "data" / "flight").symlink_to(rendered.path)
    pytester.makepyfile((EXAMPLES / "test_recall.py").read_text())
    pytester.runpytest("--update-recall").assert_outcomes(passed=1)
    pytester.runpytest().assert_outcomes(passed=1)
    assert list((pytester.path / "baseline").rglob("sift.json"))
