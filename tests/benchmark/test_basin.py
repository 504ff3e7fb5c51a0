from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.basin import DEFAULT_SIZES, Size, basin, load_basin, parse_sizes, wrong_prior
from benchmark.datasets import open_datasets
from scene.errors import InputError
from scene.localizer import Estimate, Query, Status
from scene.pose import Pose, so3_log
from tests.benchmark.made_data import FakeLocalizer

SIZES = (Size(0, 0), Size(1, 2), Size(8, 10))


class Believer(FakeLocalizer):
    """Takes its prior for the pose."""

    def localize(self, query: Query) -> Estimate:
        self.seen.append(query)
        assert query.prior is not None
        assert query.prior.cam_from_world_rotation is not None
        rotation = torch.from_numpy(query.prior.cam_from_world_rotation)
        centre = torch.from_numpy(query.prior.position)
        return Estimate(Status.OK, Pose(rotation, -(rotation @ centre)))


@pytest.mark.parametrize("size", SIZES)
def test_priors_are_wrong_by_exactly_so_much(made_flight: Path, size: Size) -> None:
    (dataset,) = open_datasets(made_flight)
    for query in dataset.queries:
        prior = wrong_prior(query, size, seed=3)
        away = prior.position - query.reference.centre().numpy()
        assert np.linalg.norm(away) == pytest.approx(size.metres, abs=1e-9)
        assert prior.cam_from_world_rotation is not None
        turn = torch.from_numpy(prior.cam_from_world_rotation) @ query.reference.rotation.T
        angle = float(torch.rad2deg(so3_log(turn).norm()))
        assert angle == pytest.approx(size.degrees, abs=1e-6)


def test_directions_are_of_seed_and_query_alone(made_flight: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    one, two = dataset.queries[:2]

    def way(query: object, metres: float, seed: int) -> np.ndarray:
        prior = wrong_prior(query, Size(metres, 1), seed)
        return np.asarray((prior.position - query.reference.centre().numpy()) / metres)

    assert way(one, 1, 0) == pytest.approx(way(one, 20, 0))
    assert np.abs(way(one, 1, 0) - way(two, 1, 0)).max() > 0.1
    assert np.abs(way(one, 1, 0) - way(one, 1, 1)).max() > 0.1


def test_recall_falls_with_the_error(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    method = Believer({})
    made = basin(dataset, method, tmp_path, SIZES)
    assert [list(level.correct.values()) for level in made.levels] == [
        [3, 3, 3],
        [0, 0, 3],
        [0, 0, 0],
    ]
    recall = made.levels[1].recall("5m_10deg")
    assert (recall.value, round(recall.low, 1)) == (100, 43.9)
    assert load_basin(tmp_path / "meadow" / "fake.basin.json") == made
    # One photograph is read once for all sizes, and no prior of the data set is handed on.
    assert len(method.seen) == 9
    assert {id(query.image) for query in method.seen[:3]} == {id(method.seen[0].image)}


def test_failures_count_as_wrong(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    answers = {
        "b.jpg": Estimate(Status.OK, dataset.queries[0].reference),
        "d.jpg": Estimate(Status.FALLBACK, dataset.queries[1].reference, reason="prior"),
        "f.jpg": ValueError("crash"),
    }
    (level,) = basin(dataset, FakeLocalizer(answers), tmp_path, [Size(1, 1)]).levels
    assert (level.queries, level.failed, level.fallback) == (3, 1, 1)
    assert set(level.correct.values()) == {1}


def test_interrupted_leaves_nothing(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    with pytest.raises(KeyboardInterrupt):
        basin(dataset, FakeLocalizer({"f.jpg": KeyboardInterrupt()}), tmp_path / "out", SIZES)
    assert not (tmp_path / "out").exists()


def test_sizes_from_words() -> None:
    assert parse_sizes("1m/2deg, 3.5m/5deg") == (Size(1, 2), Size(3.5, 5))
    assert parse_sizes(",".join(str(size) for size in DEFAULT_SIZES)) == DEFAULT_SIZES
    for words, message in [
        ("1m", "errors are listed as"),
        ("", "errors are listed as"),
        ("-1m/2deg", "errors are listed as"),
        ("1m/2deg,1m/2deg", "listed twice"),
        ("1m/200deg", "cannot be wrong by 200 degrees"),
    ]:
        with pytest.raises(InputError, match=message):
            parse_sizes(words)


@pytest.mark.parametrize(
    "change", [{"queries": 0}, {"correct": {}}, {"failed": 3}, {"prior_t_m": -1}, {"colour": 1}]
)
def test_counts_that_contradict_themselves(
    made_flight: Path, tmp_path: Path, change: dict[str, object]
) -> None:
    (dataset,) = open_datasets(made_flight)
    basin(dataset, Believer({}), tmp_path, SIZES)
    path = tmp_path / "meadow" / "fake.basin.json"
    stored = json.loads(path.read_text())
    stored["levels"][1] |= change
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError, match=r"levels\.1.* in .*fake\.basin\.json"):
        load_basin(path)
