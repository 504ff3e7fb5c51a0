from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import NONE, PRIOR, Start
from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from objconnect.localization.pipeline.journal import Journal
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status
from tests.benchmark.made_data import FakeLocalizer, make_scored_query, move, pose_at


def run(path: Path, localizer: FakeLocalizer, start: Start = PRIOR) -> Results:
    (dataset,) = open_datasets(path)
    return evaluate(dataset, localizer, path.parent / "out", start)


def write(path: Path) -> list[str]:
    out = path.parent / "out"
    return sorted(file.relative_to(out).as_posix() for file in out.rglob("*") if file.is_file())


def test_journal_keeps_answers_that_replace_others(tmp_path: Path) -> None:
    """The second run asks again with other photographs, and is interrupted, too."""

    def run_queries(names: dict[str, float]) -> dict[str, float | None]:
        journal = Journal(tmp_path / "j", "key", QueryResult)
        with pytest.raises(KeyboardInterrupt), journal:
            before = {name: result.t_err_m for name, result in journal.done.items()}
            for name, error in names.items():
                journal.add(make_scored_query(name, error))
            raise KeyboardInterrupt
        return before

    run_queries({"a": 1.0, "b": 1.0})
    run_queries({"a": 2.0, "b": 2.0, "c": 2.0})
    assert run_queries({}) == {"a": 2.0, "b": 2.0, "c": 2.0}


def test_evaluate_scores_queries_and_writes_files(made_flight: Path) -> None:
    covariance = np.diag([0, 0, 0, 0.01, 0.04, 0.04])
    answers = {
        "b.jpg": Estimate(
            Status.OK,
            move(pose_at(1), 0.1),
            covariance,
            inliers=7,
            iterations=3,
            seconds={"matching": 0.5},
        ),
        "d.jpg": Estimate(Status.OK, move(pose_at(3), 0.3), seconds={"matching": 0.1}),
    }
    results = run(made_flight, FakeLocalizer(answers))
    assert write(made_flight) == [
        "meadow/album.h5",
        "meadow/fake-query.png",
        "meadow/fake.json",
    ]
    assert load(made_flight.parent / "out/meadow/fake.json") == results

    first, second, third = results.queries
    assert first.t_err_m == pytest.approx(0.1)
    assert first.r_err_deg == pytest.approx(0, abs=1e-6)
    assert first.sigma_t_m == pytest.approx(0.3)
    assert (first.inliers, first.iterations) == (7, 3)
    assert second.sigma_t_m is None
    assert (third.status, third.reason) == (Status.FAILED, "nothing found")
    assert third.cam_from_world is None

    summary = results.summary
    assert [recall.value for recall in summary.recall.values()] == pytest.approx(
        [100 / 3, 200 / 3, 200 / 3]
    )
    assert (summary.queries, summary.failed, summary.fallback) == (3, 1, 0)
    assert summary.median_t_m == pytest.approx(0.2)
    assert summary.seconds.per_query["matching"] == pytest.approx(0.2)
    assert summary.seconds.per_query["total"] > 0
    assert summary.peak_memory_mb is None or summary.peak_memory_mb > 10
    assert results.method.config == {"strength": 1.0}


def test_written_pose_is_the_scored_pose(made_flight: Path) -> None:
    single = move(pose_at(1), 0.1).to(dtype=torch.float32)
    result = run(made_flight, FakeLocalizer({"b.jpg": Estimate(Status.OK, single)})).queries[0]
    assert result.cam_from_world is not None
    pose = Pose.from_quaternion(result.cam_from_world[:4], result.cam_from_world[4:])
    metres, degrees = pose.error_to(pose_at(1))
    assert (result.t_err_m, result.r_err_deg) == (float(metres), float(degrees))


def test_a_crash_on_one_query_is_one_failure(
    made_flight: Path, caplog: pytest.LogCaptureFixture
) -> None:
    answers = {
        "b.jpg": Estimate(Status.OK, pose_at(1)),
        "d.jpg": ZeroDivisionError("no\ninliers"),
        "f.jpg": Estimate(Status.OK, pose_at(5)),
    }
    results = run(made_flight, FakeLocalizer(answers))
    assert [query.status for query in results.queries] == ["ok", "failed", "ok"]
    assert results.queries[1].reason == "ZeroDivisionError: no\ninliers"
    assert "fake failed on d.jpg: ZeroDivisionError: no inliers" in caplog.text
    assert results.summary.recall["0.25m_2deg"].value == pytest.approx(200 / 3)


def test_fallback_at_the_reference_pose_is_wrong(made_flight: Path) -> None:
    answer = Estimate(Status.FALLBACK, pose_at(1), reason="prior")
    results = run(made_flight, FakeLocalizer({"b.jpg": answer}))
    assert results.queries[0].t_err_m == pytest.approx(0, abs=1e-9)
    assert [recall.value for recall in results.summary.recall.values()] == [0, 0, 0]
    assert (results.summary.failed, results.summary.fallback) == (2, 1)
    # No query is localized: there is no median one to draw.
    assert write(made_flight) == ["meadow/album.h5", "meadow/fake.json"]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (Estimate(Status.OK), "answered 'ok' without a pose"),
        (
            Estimate(Status.OK, Pose(pose_at(1).rotation * float("nan"), pose_at(1).translation)),
            "the pose is not finite",
        ),
    ],
)
def test_an_answer_that_is_no_pose_is_a_failure(
    made_flight: Path, answer: Estimate, reason: str
) -> None:
    results = run(made_flight, FakeLocalizer({"b.jpg": answer}))
    assert (results.queries[0].status, results.queries[0].reason) == (Status.FAILED, reason)
    text = (made_flight.parent / "out/meadow/fake.json").read_text()
    json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in the results"))


def test_start_is_declared_and_kept(made_flight: Path) -> None:
    with_prior, without = FakeLocalizer({}), FakeLocalizer({})
    assert run(made_flight, with_prior).start == "prior"
    assert all(query.prior is not None for query in with_prior.seen)
    assert run(made_flight, without, NONE).start == "none"
    assert all(query.prior is None for query in without.seen)


def test_results_of_another_start_are_not_replaced_in_silence(
    made_flight: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run(made_flight, FakeLocalizer({}), NONE)
    run(made_flight, FakeLocalizer({}), NONE)
    assert not caplog.records
    run(made_flight, FakeLocalizer({}))
    (said,) = (record.getMessage() for record in caplog.records)
    assert said.endswith(
        "meadow/fake.json holds results with start none and will be replaced: "
        "choose another --out to keep both"
    )


def test_start_is_none_where_the_data_set_has_no_prior(made_flight: Path) -> None:
    (made_flight / "gps.csv").unlink()
    assert run(made_flight, FakeLocalizer({})).start == "none"


def test_conditions_are_scored_apart(scene: Path) -> None:
    answers = {
        f"summer-grid/images/{k:06d}.jpg": Estimate(Status.OK, pose_at(k + 1)) for k in range(3)
    }
    results = run(scene, FakeLocalizer(answers))
    by_condition = {name: part.recall["5m_10deg"] for name, part in results.by_condition.items()}
    assert by_condition["summer-noon"].value == 100
    assert by_condition["winter-dusk"].value == 0
    assert results.summary.recall["5m_10deg"].value == 50


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("the map is not mine")])
def test_a_run_interrupted_at_its_first_query_leaves_nothing(
    made_flight: Path, error: BaseException
) -> None:
    with pytest.raises(type(error)):
        run(made_flight, FakeLocalizer({"b.jpg": error}))
    assert not (made_flight.parent / "out").exists()


@pytest.fixture
def interrupted(made_flight: Path) -> Path:
    """A flight whose evaluation was interrupted at the last of its three queries."""
    answers = {"b.jpg": Estimate(Status.OK, pose_at(1)), "f.jpg": KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        run(made_flight, FakeLocalizer(answers))
    assert write(made_flight) == ["meadow/.objconnect-fake.journal"]
    return made_flight


def run_queries(path: Path, **config: float) -> list[str]:
    """The queries that another run puts to the method."""
    localizer = FakeLocalizer({})
    localizer.config = localizer.config.model_copy(update=config)
    results = run(path, localizer)
    assert [query.name for query in results.queries] == ["b.jpg", "d.jpg", "f.jpg"]
    assert "meadow/.objconnect-fake.journal" not in write(path)
    return [query.name for query in localizer.seen]


def test_an_interrupted_run_goes_on(interrupted: Path) -> None:
    assert run_queries(interrupted) == ["f.jpg"]
    again = load(interrupted.parent / "out/meadow/fake.json")
    assert [query.status for query in again.queries] == ["ok", "failed", "failed"]


def test_a_line_cut_short_is_asked_again(interrupted: Path) -> None:
    partial = interrupted.parent / "out/meadow/.objconnect-fake.journal"
    partial.write_text(partial.read_text()[:-40])
    assert run_queries(interrupted) == ["d.jpg", "f.jpg"]


@pytest.mark.parametrize("rubbish", ["", "{", "[]\n", '{"key": "other"}\n{}\n', "\x00\x00"])
def test_a_damaged_journal_starts_over(interrupted: Path, rubbish: str) -> None:
    (interrupted.parent / "out/meadow/.objconnect-fake.journal").write_text(rubbish)
    assert run_queries(interrupted) == ["b.jpg", "d.jpg", "f.jpg"]


def test_another_configuration_starts_over(interrupted: Path) -> None:
    assert run_queries(interrupted, strength=2.0) == ["b.jpg", "d.jpg", "f.jpg"]


def test_two_runs_do_not_write_the_same_results(interrupted: Path) -> None:
    journal = interrupted.parent / "out/meadow/.objconnect-fake.journal"
    before = journal.read_text()
    key = json.loads(before.splitlines()[0])["key"]
    with Journal(journal, key, QueryResult) as open_elsewhere:
        assert set(open_elsewhere.done) == {"b.jpg", "d.jpg"}
        with pytest.raises(InputError, match="another run is writing"):
            run(interrupted, FakeLocalizer({}))
        assert journal.read_text() == before


@pytest.mark.usefixtures("extracted_once")
def test_jobs_change_nothing_but_seconds(rendered: Scene, cache: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(rendered.path)
    answers = []
    for jobs in (1, 3):
        results = evaluate(
            dataset, create("sift", {}), tmp_path / str(jobs), cache=cache, jobs=jobs
        )
        answers.append([query.model_copy(update={"seconds": {}}) for query in results.queries])
    assert answers[0] == answers[1]
    assert any(query.status is Status.OK for query in answers[0])


def test_an_output_path_that_is_a_file_is_refused(made_flight: Path) -> None:
    (made_flight.parent / "out").write_text("mine")
    with pytest.raises(InputError, match="it is not a folder"):
        run(made_flight, FakeLocalizer({}))
