"""The gate on a fixed scene: our own recall, planted faults, and chance.

``tests/data/gate`` is kept in the repository, see ``tests/data/make_gate.py``. After a change that
is meant to change recall: ``pytest tests/benchmark/test_gate.py --update-recall -k has_not``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from baselines.sift import Sift, SiftConfig, SiftLocalizer
from benchmark.cli import app
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluate import evaluate
from scene.geometry.camera import Camera
from scene.localizer import Estimate, Query, Status
from scene.maps.features import Features

DATA = Path(__file__).parents[1] / "data"
BASELINE = DATA / "gate-baseline"


@pytest.fixture(scope="module")
def gate() -> Dataset:
    (dataset,) = open_datasets(DATA / "gate")
    return dataset


class Faulty(SiftLocalizer):
    """SIFT with something between it and its queries."""

    def __init__(self, fault: Callable[[Query], Query | None]) -> None:
        super().__init__(SiftConfig())
        self.fault = fault

    def localize(self, query: Query) -> Estimate:
        changed = self.fault(query)
        if changed is None:
            return Estimate(Status.FAILED, reason="dropped")
        return super().localize(changed)


def regress(results: Path) -> Result:
    return CliRunner().invoke(app, ["regress", str(results), "--against", str(BASELINE)])


def test_recall_has_not_dropped(
    gate: Dataset, tmp_path: Path, no_recall_drop: Callable[[Path, Path], None]
) -> None:
    evaluate(gate, SiftLocalizer(SiftConfig()), tmp_path)
    no_recall_drop(tmp_path, BASELINE)


def two_pixels(query: Query) -> Query:
    fx, fy, cx, cy, *rest = query.camera.params
    camera = query.camera
    biased = Camera(camera.model, camera.width, camera.height, (fx, fy, cx + 2, cy + 2, *rest))
    return replace(query, camera=biased)


@pytest.mark.thorough
def test_a_bias_of_two_pixels_is_caught(gate: Dataset, tmp_path: Path) -> None:
    evaluate(gate, Faulty(two_pixels), tmp_path)
    answer = regress(tmp_path)
    assert answer.exit_code == 1
    assert "DROP sift on gate (flight), all, 0.25m_2deg: -" in answer.stdout


@pytest.mark.thorough
def test_one_query_in_ten_dropped_is_caught(gate: Dataset, tmp_path: Path) -> None:
    dropped = {query.name for query in gate.queries[::10]}
    evaluate(gate, Faulty(lambda q: None if q.name in dropped else q), tmp_path)
    answer = regress(tmp_path)
    assert answer.exit_code == 1
    assert "DROP sift on gate" in answer.stdout


@pytest.mark.thorough
def test_swapped_cameras_are_caught(gate: Dataset, tmp_path: Path) -> None:
    first, second = dict.fromkeys(query.camera for query in gate.queries)
    other = {first: second, second: first}
    evaluate(gate, Faulty(lambda q: replace(q, camera=other[q.camera])), tmp_path)
    answer = regress(tmp_path)
    assert answer.exit_code == 1
    assert "DROP sift on gate" in answer.stdout


@pytest.mark.slow
def test_another_seed_is_not_flagged_in_twenty_of_twenty(gate: Dataset, tmp_path: Path) -> None:
    remembered: dict[bytes, Features] = {}
    for seed in range(1, 21):
        localizer = SiftLocalizer(SiftConfig(seed=seed))
        sift = localizer._extractor
        assert isinstance(sift, Sift)
        extract = sift._extract

        def once(image: Any, extract: Callable[[Any], Features] = extract) -> Features:
            key = image.tobytes()
            if key not in remembered:
                remembered[key] = extract(image)
            return remembered[key]

        sift._extract = once  # type: ignore[assignment]
        evaluate(gate, localizer, tmp_path / str(seed), cache=tmp_path / "cache")
        answer = regress(tmp_path / str(seed))
        assert answer.exit_code == 0, f"seed {seed}:\n{answer.stdout}"
