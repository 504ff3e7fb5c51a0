from __future__ import annotations

import json
import lzma
import math
import random
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmark.regression import regress, update
from benchmark.report.leaderboard import leaderboard
from benchmark.results.query_result import QueryResult
from benchmark.results.results import DatasetId, Results
from benchmark.results.results_files import load, method_in
from benchmark.scoring.score import THRESHOLDS, is_correct, is_false_fix
from benchmark.tracks.compact import compact, store, targets_of, write_compact
from objconnect.localization.provenance import Method
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.localizer import Status
from tests.benchmark.made_data import make_scored_query

DIGEST = "ab" * 32
CONDITIONS = ("summer-noon", "snow-noon", "snow-dusk", "leafoff-noon")


def make(name: str, rng: random.Random) -> QueryResult:
    """A query of whatever outcome, with all the digits that measurements have."""
    status = rng.choices([Status.OK, Status.FALLBACK, Status.FAILED], [8, 1, 1])[0]
    located = status is not Status.FAILED
    certain = status is Status.OK
    turn = [rng.gauss(0, 1) for _ in range(4)]
    length = math.hypot(*turn)
    pose = (*(x / length for x in turn), *(rng.uniform(-150, 150) for _ in range(3)))
    query = make_scored_query(
        name,
        math.exp(rng.gauss(-2, 2)) if located else None,
        rng.choice(CONDITIONS),
        status,
        group=name.split("/")[0],
        altitude_m=rng.uniform(30, 120),
        reason="" if certain else "too few inliers",
        r_err_deg=min(180.0, math.exp(rng.gauss(-1, 2))) if located else None,
        sigma_t_m=math.exp(rng.gauss(-2, 1)) if certain else None,
        nees=math.exp(rng.gauss(1.7, 1)) if certain else None,
        iterations=rng.randrange(40),
        inliers=rng.randrange(900),
        seconds={s: rng.uniform(1e-4, 1) for s in ("features", "points", "alignment", "total")},
    )
    return query.model_copy(update={"cam_from_world": pose if located else None})


def run_of(queries: list[QueryResult], start: str = "none", **config: float) -> Results:
    return Results.of(
        Method(name="sift", config=config, weights_sha256=None),
        DatasetId(name="park-1", track="uav-sim", sha256=DIGEST, map_conditions=("summer-noon",)),
        start,
        queries,
        1 / 3,
        1234.5678901234567,
    )


@pytest.fixture(scope="module")
def results() -> Results:
    """As many queries as a data set of a track has."""
    rng = random.Random(0)
    return run_of([make(f"s{k // 40}/images/{k % 40:06d}.jpg", rng) for k in range(320)])


def figures(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from figures(inner, f"{where}.{key}")
    else:
        yield where, value


def test_a_compact_file_is_small_and_has_the_same_figures(results: Results, tmp_path: Path) -> None:
    path = tmp_path / "sift.json.xz"
    write_compact(path, results)
    assert path.stat().st_size < 120 * len(results.queries)
    back = load(path)
    assert back == compact(results) == compact(back)
    for part in ("summary", "by_condition", "by_group", "by_altitude"):
        before = dict(figures(results.model_dump()[part]))
        after = dict(figures(back.model_dump()[part]))
        assert before.keys() == after.keys()
        for where, value in before.items():
            if isinstance(value, float):
                tolerance = 1e-3 if ".seconds.per_query" in where else 1e-9
                assert after[where] == pytest.approx(value, rel=tolerance, abs=0), where
            else:
                assert after[where] == value, where


def test_numbers_are_rounded_as_documented(results: Results) -> None:
    for query, short in zip(results.queries, compact(results).queries, strict=True):
        rest = {"t_err_m", "r_err_deg", "sigma_t_m", "nees", "altitude_m", "cam_from_world"}
        assert query.model_dump(exclude=rest | {"seconds"}) == short.model_dump(
            exclude=rest | {"seconds"}
        )
        for key in ("t_err_m", "r_err_deg", "sigma_t_m", "nees"):
            exact = getattr(query, key)
            assert getattr(short, key) == (exact and pytest.approx(exact, rel=1e-9, abs=0))
        assert short.altitude_m == pytest.approx(query.altitude_m, abs=0.0051)
        for stage, seconds in query.seconds.items():
            assert short.seconds[stage] == pytest.approx(seconds, rel=0.0051)
        if query.cam_from_world is not None and short.cam_from_world is not None:
            for k, (whole, rounded) in enumerate(
                zip(query.cam_from_world, short.cam_from_world, strict=True)
            ):
                assert rounded == pytest.approx(whole, abs=0.51e-7 if k < 4 else 0.51e-4)


def test_rounding_moves_no_query_across_a_threshold() -> None:
    """Numbers beside every threshold on both sides, nearer than the digits that are kept."""
    queries = []
    for metres, degrees in THRESHOLDS:
        for sign in (-1, 0, 1):
            queries += [
                make_scored_query(f"t{len(queries)}", metres * (1 + sign * 1e-14)),
                make_scored_query(f"r{len(queries)}", 0.1, r_err_deg=degrees * (1 + sign * 1e-14)),
            ]
    # The 95 % quantile of chi-square with 6 degrees of freedom, and the edge of a band of heights.
    edge = 12.591587243743977
    queries += [make_scored_query(f"n{k}", 0.1, nees=edge * (1 + k * 1e-14)) for k in (-1, 0, 1)]
    queries += [make_scored_query(f"a{k}", 0.1, altitude_m=60 + k * 1e-6) for k in (-1, 0, 1)]
    results = run_of(queries)
    short = compact(results)
    for query, rounded in zip(queries, short.queries, strict=True):
        for threshold in THRESHOLDS:
            assert is_correct(query, threshold) == is_correct(rounded, threshold), query
        assert is_false_fix(query) == is_false_fix(rounded), query
    assert short.summary.uncertainty is not None
    assert results.summary.uncertainty is not None
    assert short.summary.uncertainty.within_95 == results.summary.uncertainty.within_95
    assert {name: part.queries for name, part in short.by_altitude.items()} == {
        name: part.queries for name, part in results.by_altitude.items()
    }


def test_the_configuration_keeps_its_digits(tmp_path: Path) -> None:
    """It tells methods apart; it is not a figure."""
    results = run_of([make_scored_query("a", 0.1)], ratio=1 / 3)
    write_compact(tmp_path / "sift.json.xz", results)
    assert load(tmp_path / "sift.json.xz").method == results.method


@pytest.mark.skipif(shutil.which("xz") is None, reason="xz is not installed")
def test_xz_makes_an_ordinary_file_of_it(results: Results, tmp_path: Path) -> None:
    write_compact(tmp_path / "sift.json.xz", results)
    subprocess.run(["xz", "-dk", str(tmp_path / "sift.json.xz")], check=True)
    assert load(tmp_path / "sift.json") == load(tmp_path / "sift.json.xz")
    assert json.loads((tmp_path / "sift.json").read_text())["schema"] == 1


# ---------------------------------------------------------------- commands that read results


@pytest.fixture
def track(tmp_path: Path) -> Path:
    folder = tmp_path / "board" / "parks"
    folder.mkdir(parents=True)
    place = {"dataset": "park-1", "preset": "park", "seed": 1, "renders": [DIGEST]}
    lists: dict[str, Any] = {"places": [place], "starts": ["none"], "methods": ["sift"]}
    description = {"name": "parks", "title": "Parks", "config": "uav-seasons", **lists}
    (folder / "track.yaml").write_text(yaml.safe_dump(description))
    return folder


@pytest.fixture
def run(results: Results, tmp_path: Path) -> Path:
    results.write(tmp_path / "run" / "park-1" / "sift.json")
    return tmp_path / "run"


def test_results_are_stored(run: Path, track: Path, results: Results) -> None:
    (path,) = store(targets_of([run], track))
    assert path == track / "results" / "none" / "park-1" / "sift.json.xz"
    assert load(path) == compact(results)
    # Better results of the same name take their place; the same ones change nothing.
    content = path.read_bytes()
    assert store(targets_of([track / "results" / "none"], track)) == [path]
    assert path.read_bytes() == content
    assert method_in(path) == results.method


def test_commands_read_both_forms(run: Path, track: Path, tmp_path: Path) -> None:
    store(targets_of([run], track))
    compacted = track / "results" / "none"
    # Seconds have three digits there and one or two in the table.
    assert leaderboard([compacted]) == leaderboard([run])
    baseline = tmp_path / "baseline"
    assert update(compacted, baseline) == [baseline / "park-1" / "sift.json.xz"]
    assert not any(comparison.dropped for comparison in regress(compacted, baseline))
    assert update(compacted, baseline), "a baseline is replaced"


def test_results_of_other_data_are_not_stored(
    run: Path, track: Path, results: Results, tmp_path: Path
) -> None:
    other = results.dataset.model_copy(update={"sha256": "cd" * 32})
    results.model_copy(update={"dataset": other}).write(tmp_path / "other" / "park-1" / "sift.json")
    with pytest.raises(InputError, match=r"park-1 \(cdcdcdcdcdcd\) is not a render that the"):
        targets_of([tmp_path / "other"], track)
    unknown = results.dataset.model_copy(update={"name": "../../park-2"})
    results.model_copy(update={"dataset": unknown}).write(tmp_path / "x" / "a" / "sift.json")
    with pytest.raises(InputError, match="no place '../../park-2'"):
        targets_of([tmp_path / "x"], track)
    run_of([make_scored_query("a", 0.1)]).write(tmp_path / "again" / "park-1" / "sift.json")
    with pytest.raises(InputError, match="has results of sift on park-1 from start none"):
        targets_of([run, tmp_path / "again"], track)
    with pytest.raises(InputError, match="folder of the track .*none does not exist"):
        targets_of([run], track.with_name("none"))
    with pytest.raises(InputError, match="is not the folder of a track"):
        targets_of([run], tmp_path)
    foreign = track / "results" / "none" / "park-1" / "sift.json.xz"
    foreign.parent.mkdir(parents=True)
    foreign.write_text("mine")
    with pytest.raises(WriteError, match="sift.json.xz"):
        targets_of([run], track)
    assert foreign.read_text() == "mine"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not one whole xz file"),
        (b"{}", "not one whole xz file"),
        (bytes(40), "not a whole xz file"),
        (lzma.compress(b"{}" * 99)[:-7], "not one whole xz file"),
        (lzma.compress(b"{}") + b"more", "not one whole xz file"),
        (lzma.compress(b"\xff\xfe"), "not a UTF-8 text"),
        (lzma.compress(b"[1"), "not valid JSON"),
        (None, "at most 64 MiB"),
        (lzma.compress(b"{}", preset=9 | lzma.PRESET_EXTREME), "missing key 'method'"),
    ],
    ids=["empty", "plain", "zeroed", "cut", "two", "no text", "no JSON", "bomb", "no keys"],
)
def test_a_damaged_file_is_refused(content: bytes | None, says: str, tmp_path: Path) -> None:
    path = tmp_path / "sift.json.xz"
    # The large file is compressed here: collection, which every process does, would take a second.
    large = b" " * (1 << 26) + b"{}"
    path.write_bytes(lzma.compress(large, preset=0) if content is None else content)
    with pytest.raises(InputError, match=says):
        load(path)
