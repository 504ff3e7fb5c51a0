from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.basin import (
    DEFAULT_ERRORS,
    CourseCounts,
    Level,
    PriorError,
    basin,
    load_basin,
    parse_errors,
)
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import parse_start
from benchmark.scoring.intervals import share
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Query, Status
from tests.benchmark.made_data import FakeLocalizer

ERRORS = (PriorError(0, 0), PriorError(1, 2), PriorError(8, 10))


class Believer(FakeLocalizer):
    """Takes its prior for the pose."""

    def localize(self, query: Query) -> Estimate:
        self.seen.append(query)
        assert query.prior is not None
        assert query.prior.cam_from_world_rotation is not None
        rotation = torch.from_numpy(query.prior.cam_from_world_rotation)
        centre = torch.from_numpy(query.prior.position)
        return Estimate(Status.OK, Pose(rotation, -(rotation @ centre)))


def priors(method: Believer) -> list[np.ndarray]:
    return [query.prior.position for query in method.seen if query.prior is not None]


def test_errors_equal_those_of_the_start_error(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    ours, theirs, other = Believer({}), Believer({}), Believer({})
    basin(dataset, ours, tmp_path, [PriorError(3, 5)])
    evaluate(dataset, theirs, tmp_path, parse_start("error=3m,5deg"))
    assert np.array_equal(priors(ours), priors(theirs))
    basin(dataset, other, tmp_path, [PriorError(3, 5)], seed=1)
    centres = [query.reference.centre().numpy() for query in dataset.queries]
    away = np.array(priors(other)) - centres
    assert np.linalg.norm(away, axis=1) == pytest.approx(3)
    assert (np.abs(np.array(priors(other)) - priors(ours)).max(1) > 0.1).all()


def test_all_sizes_of_a_query_use_one_direction(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    method = Believer({})
    basin(dataset, method, tmp_path, [PriorError(1, 2), PriorError(20, 2)])
    centre = dataset.queries[0].reference.centre().numpy()
    near, far = (position - centre for position in priors(method)[:2])
    assert far == pytest.approx(20 * near)


def test_recall_falls_with_the_error(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    method = Believer({})
    made = basin(dataset, method, tmp_path, ERRORS)
    assert [list(level.correct.values()) for level in made.levels] == [
        [3, 3, 3],
        [0, 0, 3],
        [0, 0, 0],
    ]
    recall = made.levels[1].recall("5m_10deg")
    assert (recall.value, recall.low) == (100, None), "all queries are of one flight"
    assert load_basin(tmp_path / "meadow" / "fake.basin.json") == made
    # One photograph is read once for all sizes, and no prior of the data set is handed on.
    assert len(method.seen) == 9
    assert {id(query.image) for query in method.seen[:3]} == {id(method.seen[0].image)}


def test_intervals_are_by_course(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    level = basin(dataset, Believer({}), tmp_path, [PriorError(1, 2)]).levels[0]
    counts = dict.fromkeys(level.correct, 1)
    halves = {name: CourseCounts(queries=2, correct=counts) for name in "ab"}
    numbers = {"queries": 4, "correct": dict.fromkeys(counts, 2), "by_course": halves}
    split = Level.model_validate(level.model_dump() | numbers)
    found, expected = split.recall("5m_10deg"), share([True, False, True, False], list("aabb"))
    assert (found.value, found.low, found.high) == expected
    assert split.model_copy(update={"by_course": None}).recall("5m_10deg").text() == "50.0 [–]"
    with pytest.raises(ValueError, match="do not add up"):
        Level.model_validate(level.model_dump() | numbers | {"queries": 5})


def test_failures_count_as_wrong(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    answers = {
        "b.jpg": Estimate(Status.OK, dataset.queries[0].reference),
        "d.jpg": Estimate(Status.FALLBACK, dataset.queries[1].reference, reason="prior"),
        "f.jpg": ValueError("crash"),
    }
    (level,) = basin(dataset, FakeLocalizer(answers), tmp_path, [PriorError(1, 1)]).levels
    assert (level.queries, level.failed, level.fallback) == (3, 1, 1)
    assert set(level.correct.values()) == {1}


def test_an_interrupted_run_leaves_no_file(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    with pytest.raises(KeyboardInterrupt):
        basin(dataset, FakeLocalizer({"f.jpg": KeyboardInterrupt()}), tmp_path / "out", ERRORS)
    assert not (tmp_path / "out").exists()


def test_sizes_are_read_from_text() -> None:
    assert parse_errors("1m/2deg, 3.5m/5deg") == (PriorError(1, 2), PriorError(3.5, 5))
    assert parse_errors(",".join(str(error) for error in DEFAULT_ERRORS)) == DEFAULT_ERRORS
    for words, message in [
        ("1m", "write errors as"),
        ("", "write errors as"),
        ("-1m/2deg", "write errors as"),
        ("1m/2deg,1m/2deg", "listed twice"),
        ("1m/200deg", "an attitude error is at most 180 degrees; got 200"),
    ]:
        with pytest.raises(InputError, match=message):
            parse_errors(words)


@pytest.mark.parametrize(
    "change",
    [
        {"queries": 0},
        {"queries": 10**400},
        {"correct": {}},
        {"failed": 3},
        {"prior_t_m": -1},
        {"colour": 1},
    ],
)
def test_contradicting_counts_are_refused(
    made_flight: Path, tmp_path: Path, change: dict[str, object]
) -> None:
    (dataset,) = open_datasets(made_flight)
    basin(dataset, Believer({}), tmp_path, ERRORS)
    path = tmp_path / "meadow" / "fake.basin.json"
    stored = json.loads(path.read_text())
    stored["levels"][1] |= change
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError, match=r"levels\.1.* in .*fake\.basin\.json"):
        load_basin(path)
