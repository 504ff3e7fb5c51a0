"""The gate: losses beyond chance stop the build, noise and gains do not."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from benchmark.cli import app
from benchmark.results.results import DatasetId, Results
from benchmark.scoring.paired import compare
from objconnect.localization.provenance import Method
from tests.benchmark.made_data import make_scored_query


def write(
    folder: Path,
    errors: dict[str, float | None],
    sha256: str = "a" * 64,
    start: str = "prior",
    unjudged: tuple[str, ...] = (),
) -> None:
    """Results whose queries have these errors (m); None is a failure, names begin with s or w."""
    queries = [
        make_scored_query(name, error, "summer" if name.startswith("s") else "winter")
        for name, error in errors.items()
    ]
    Results.of(
        Method(name="sift", config={}, weights_sha256=None),
        DatasetId(
            name="d",
            track="uav-sim",
            sha256=sha256,
            map_conditions=("summer",),
            unjudged=unjudged,
        ),
        start,
        queries,
    ).write(folder / "d" / "sift.json")


def regress(new: Path, old: Path, *more: str) -> Result:
    return CliRunner().invoke(app, ["regress", str(new), "--against", str(old), *more])


GOOD: dict[str, float | None] = {f"{season}{k}": 0.1 for season in "sw" for k in range(50)}


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    write(tmp_path / "old", GOOD)
    return tmp_path / "old"


@pytest.fixture
def again(baseline: Path, tmp_path: Path) -> Path:
    """The results of the baseline in another folder."""
    return shutil.copytree(baseline, tmp_path / "again")


def test_a_folder_is_not_compared_with_itself(
    baseline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "link").symlink_to(baseline)
    monkeypatch.chdir(tmp_path)
    for same in (baseline, tmp_path / "link", Path("old/../old")):
        answer = regress(same, baseline)
        assert answer.exit_code == 2
        assert answer.stderr == (
            f"objconnect: error: {same} is compared with itself: name the baseline with --against\n"
        )


def test_the_same_results_pass(baseline: Path, again: Path) -> None:
    answer = regress(again, baseline)
    assert answer.exit_code == 0
    # Three thresholds, false fixes and wrong answers over all queries, summer's and winter's.
    assert len(answer.stdout.splitlines()) == 15
    assert "DROP" not in answer.stdout


def test_a_baseline_that_cannot_drop_is_named(
    baseline: Path, again: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert regress(again, baseline).exit_code == 0
    assert not caplog.records
    # Winter has six queries that are right at 0.5 m: all lost, p = 1 / 64, above 0.05 / 9.
    few = {n: (e if n.startswith("s") or n in {f"w{k}" for k in range(6)} else 9.0)
           for n, e in GOOD.items()}  # fmt: skip
    write(tmp_path / "few", few)
    lost = {n: (e if n.startswith("s") else 9.0) for n, e in few.items()}
    write(tmp_path / "lost", lost)
    answer = regress(tmp_path / "lost", tmp_path / "few")
    assert answer.exit_code == 0, "it is blind, and says so"
    said = [record.getMessage() for record in caplog.records]
    # Three thresholds, false fixes and wrong answers.
    assert len(said) == 5
    assert all("sift on d (uav-sim), winter, " in line for line in said)
    assert any("0.5m_5deg: no loss could be significant" in line for line in said)


def test_one_query_in_ten_lost_is_caught(baseline: Path, tmp_path: Path) -> None:
    write(tmp_path / "new", {n: None if n.endswith("3") else e for n, e in GOOD.items()})
    answer = regress(tmp_path / "new", baseline)
    assert answer.exit_code == 1
    drops = [line for line in answer.stdout.splitlines() if line.startswith("DROP")]
    assert any("sift on d (uav-sim), all, 0.5m_5deg: -10.0 points" in line for line in drops)


@pytest.mark.parametrize(
    ("before", "after", "dropped"),
    [
        (0.8, 1.2, {"not_wrong_1m"}),
        (2.9, 3.1, {"not_worse_than_prior"}),
        (4.0, 6.0, {"5m_10deg", "not_false_fix"}),
    ],
)
def test_integrity_that_drops_is_caught(
    tmp_path: Path, before: float, after: float, dropped: set[str]
) -> None:
    """Ten of 50 winter queries get worse; recall alone shows only the last of the three."""
    start = "error=3m,5deg"
    for folder, metres in (("old", before), ("new", after)):
        write(tmp_path / folder, GOOD | {f"w{k}": metres for k in range(10)}, start=start)
    answer = regress(tmp_path / "new", tmp_path / "old")
    assert answer.exit_code == 1
    lines = [line for line in answer.stdout.splitlines() if line.startswith("DROP")]
    winter = [line for line in lines if ", winter, " in line]
    assert {line.split(", ")[2].split(":")[0] for line in winter} == dropped


def test_what_the_reference_poses_do_not_judge_is_not_compared(
    baseline: Path, tmp_path: Path
) -> None:
    """Errors of 0.3 m are losses at 0.25 m, which these reference poses cannot tell."""
    coarse = ("0.25 m 2°",)
    write(tmp_path / "new", GOOD | {f"w{k}": 0.3 for k in range(10)}, unjudged=coarse)
    answer = regress(tmp_path / "new", baseline)
    assert answer.exit_code == 0
    assert "0.25m_2deg" not in answer.stdout
    nothing = ("0.25 m 2°", "0.5 m 5°", "1 m", "5 m 10°")
    write(tmp_path / "blind", GOOD, unjudged=nothing)
    answer = regress(tmp_path / "blind", baseline)
    assert answer.exit_code == 2
    assert "too inexact to judge any metric" in answer.stderr


def test_queries_that_vanished_are_losses(baseline: Path, tmp_path: Path) -> None:
    write(tmp_path / "new", {n: e for n, e in GOOD.items() if not n.endswith("3")})
    answer = regress(tmp_path / "new", baseline)
    assert answer.exit_code == 1
    assert "10 lost and 0 won of 100" in answer.stdout


def test_one_query_that_vanished_is_no_chance(baseline: Path, tmp_path: Path) -> None:
    write(tmp_path / "new", {n: e for n, e in GOOD.items() if n != "s3"})
    answer = regress(tmp_path / "new", baseline)
    assert answer.exit_code == 1
    assert "1 queries vanished" in answer.stdout


def test_a_drop_in_one_condition_alone_is_caught(baseline: Path, tmp_path: Path) -> None:
    """Eight of fifty winter queries, and as many gained nowhere."""
    lost = {f"w{k}": 0.3 for k in range(8)}
    write(tmp_path / "new", GOOD | lost)
    answer = regress(tmp_path / "new", baseline, "--json")
    assert answer.exit_code == 1
    drops = [c for c in json.loads(answer.stdout)["comparisons"] if c["dropped"]]
    assert {(c["condition"], c["threshold"]) for c in drops} == {
        ("all", "0.25m_2deg"),
        ("winter", "0.25m_2deg"),
    }


def test_noise_is_not_flagged(tmp_path: Path) -> None:
    """Errors redrawn twenty times from one distribution: no alarm in twenty."""
    rng = np.random.default_rng(0)

    def draw() -> dict[str, float | None]:
        # Hard and easy queries, each redrawn about its own difficulty.
        return {
            n: float(0.2 * np.exp(0.01 * k - 0.5 + 0.3 * rng.standard_normal()))
            for k, n in enumerate(GOOD)
        }

    write(tmp_path / "old", draw())
    for _ in range(20):
        write(tmp_path / "new", draw())
        assert regress(tmp_path / "new", tmp_path / "old").exit_code == 0


def test_gains_pass(baseline: Path, tmp_path: Path) -> None:
    write(tmp_path / "worse", dict.fromkeys(GOOD, 0.6))
    assert regress(baseline, tmp_path / "worse").exit_code == 0
    assert regress(tmp_path / "worse", baseline).exit_code == 1


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda new: (new / "d" / "sift.json").unlink(), "lacks d/sift.json"),
        (lambda new: write(new, GOOD, "b" * 64), "record the baseline again with --update"),
        (lambda new: (new / "d" / "sift.json").write_text("{"), "is not valid JSON"),
    ],
)
def test_errors_of_the_input_exit_with_2(
    baseline: Path, tmp_path: Path, fault: object, message: str
) -> None:
    write(tmp_path / "new", GOOD)
    fault(tmp_path / "new")  # type: ignore[operator]
    answer = regress(tmp_path / "new", baseline)
    assert answer.exit_code == 2
    assert message in answer.stderr
    answer = regress(tmp_path / "new", tmp_path / "nowhere")
    assert answer.exit_code == 2
    assert "do not exist" in answer.stderr


def test_update_records_the_baseline(baseline: Path, tmp_path: Path) -> None:
    write(tmp_path / "new", dict.fromkeys(GOOD, 0.6))
    assert regress(tmp_path / "new", baseline).exit_code == 1
    assert regress(tmp_path / "new", baseline, "--update").exit_code == 0
    assert regress(tmp_path / "new", baseline).exit_code == 0
    (tmp_path / "new" / "d" / "sift.json").write_text("{")
    before = (baseline / "d" / "sift.json").read_bytes()
    assert regress(tmp_path / "new", baseline, "--update").exit_code == 2
    assert (baseline / "d" / "sift.json").read_bytes() == before


def test_the_statistics_equal_known_values() -> None:
    """Ten queries, four lost and one won: P(X >= 4 of 5) = 6/32."""
    before = [True] * 8 + [False] * 2
    after = [False] * 4 + [True] * 4 + [True, False]
    change = compare(before, after)
    assert (change.queries, change.lost, change.won) == (10, 4, 1)
    assert change.p_drop == 6 / 32
    assert change.change == pytest.approx(-30)
    # Bonett and Price by hand: p = 5/12, q = 2/12.
    half = 1.959963984540054 * math.sqrt((7 / 12 - (3 / 12) ** 2) / 12)
    assert change.low == pytest.approx(100 * (-3 / 12 - half))
    assert change.high == pytest.approx(100 * (-3 / 12 + half))


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_the_statistics_have_their_properties(pairs: list[tuple[bool, bool]]) -> None:
    before, after = [b for b, _ in pairs], [a for _, a in pairs]
    there, back = compare(before, after), compare(after, before)
    assert there.change == -back.change
    assert there.low == pytest.approx(-back.high)
    assert 0 < there.p_drop <= 1
    assert -100 <= there.low <= there.high <= 100
    # Both tails overlap in the outcome itself.
    changed = there.lost + there.won
    both = math.comb(changed, there.lost) / 2**changed
    assert there.p_drop + back.p_drop == pytest.approx(1 + both)
    if before == after:
        assert there.p_drop == 1
