"""Ratios of made runs: which are kept, and which change is more than chance."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from experiments import ratio_picture
from experiments.ratios import KIND, Ratio, Ratios, main, ratios_of
from objconnect.scene.bundle.manifest import read_json

OPTIONS = Path(__file__).parents[2] / "pyproject.toml"


def run(path: Path, medians: dict[str, float], iqr: float = 0.02, group: str = "match") -> Path:
    """Write what pytest-benchmark writes, as far as it is read."""
    benchmarks = [
        {"group": group, "name": name, "stats": {"median": median, "iqr": iqr * median}}
        for name, median in medians.items()
    ]
    made = {
        "benchmarks": benchmarks,
        "machine_info": {"cpu": {"brand_raw": "A processor"}, "node": "a-name-of-a-machine"},
        "commit_info": {"id": "abc"},
    }
    path.write_text(json.dumps(made))
    return path


def test_ours_is_measured_by_every_peer_and_bound(tmp_path: Path) -> None:
    medians = {"test_ours": 3.0, "test_opencv": 6.0, "test_bare_product": 1.5, "test_way[two]": 4.5}
    found = ratios_of(run(tmp_path / "run.json", medians))
    assert {(each.name, each.over): each.ratio for each in found.ratios} == {
        ("test_ours", "test_opencv"): 0.5,
        ("test_ours", "test_bare_product"): 2.0,
        ("test_way[two]", "test_opencv"): 0.75,
        ("test_way[two]", "test_bare_product"): 3.0,
    }
    assert found.ratios[0].spread == pytest.approx(0.5 * 0.02 * 2**0.5)


def test_a_group_without_a_peer_is_measured_by_its_first(tmp_path: Path) -> None:
    found = ratios_of(run(tmp_path / "run.json", {"test_query[100]": 0.4, "test_query[1000]": 0.5}))
    (only,) = found.ratios
    assert (only.name, only.over, only.ratio) == ("test_query[1000]", "test_query[100]", 1.25)


def write(folder: Path, name: str, ours: float, iqr: float = 0.02) -> Path:
    """Write the ratios of a run in which ours takes so many times what a peer takes."""
    made = run(folder / f"{name}-run.json", {"test_ours": ours, "test_opencv": 1.0}, iqr)
    path = folder / f"{name}.json"
    assert main(["write", str(made), str(path)]) == 0
    return path


@pytest.mark.parametrize(
    ("ours", "iqr", "worse"),
    [(1.0, 0.02, 0), (0.5, 0.02, 0), (1.08, 0.02, 0), (1.2, 0.02, 1), (1.2, 0.2, 0), (3, 0.2, 1)],
)
def test_a_ratio_that_grew_by_more_than_its_spread_fails(
    tmp_path: Path, ours: float, iqr: float, worse: int, capsys: pytest.CaptureFixture[str]
) -> None:
    before, now = write(tmp_path, "before", 1.0, iqr), write(tmp_path, "now", ours, iqr)
    assert main(["check", str(now), "--against", str(before)]) == worse
    assert ("WORSE" in capsys.readouterr().out) == bool(worse)


def test_the_file_names_processor_and_commit_and_not_the_machine(tmp_path: Path) -> None:
    text = write(tmp_path, "now", 1.0).read_text()
    assert "A processor" in text and "abc" in text and "a-name-of-a-machine" not in text


def test_files_that_are_none_are_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other, good = tmp_path / "other.json", write(tmp_path, "good", 1.0)
    other.write_text('{"benchmarks": [{"name": "no numbers"}]}')
    assert main(["write", str(other), str(tmp_path / "out.json")]) == 2
    assert main(["check", str(good), "--against", str(tmp_path / "missing.json")]) == 2
    assert main(["check", str(other), "--against", str(good)]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 3 and all(line.startswith("error: ") for line in errors)
    assert str(other) in errors[0] and not (tmp_path / "out.json").exists()


def test_runs_that_share_nothing_are_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = run(tmp_path / "run.json", {"test_ours": 1.0, "test_bare": 1.0}, group="another")
    assert main(["write", str(made), str(tmp_path / "other.json")]) == 0
    before = write(tmp_path, "before", 1.0)
    assert main(["check", str(tmp_path / "other.json"), "--against", str(before)]) == 2
    assert "share no ratio" in capsys.readouterr().err


def test_the_order_of_the_tests_does_not_matter(tmp_path: Path) -> None:
    medians = {"test_query[100]": 1.0, "test_query[1000]": 1.5}
    there = ratios_of(run(tmp_path / "there.json", medians))
    back = ratios_of(run(tmp_path / "back.json", dict(reversed(medians.items()))))
    assert there == back
    assert [(each.name, each.over) for each in there.ratios] == [
        ("test_query[1000]", "test_query[100]")
    ]


def test_our_options_of_pytest_let_benchmarks_run(tmp_path: Path) -> None:
    """Options that spread tests over processes switch benchmarks off without a word."""
    made, out = tmp_path / "test_made.py", tmp_path / "run.json"
    made.write_text("def test_ours(benchmark): benchmark(sum, range(10))\n")
    words = [sys.executable, "-m", "pytest", "-c", str(OPTIONS), str(made), "--benchmark-enable"]
    apart = {key: value for key, value in os.environ.items() if "XDIST" not in key}
    done = subprocess.run(
        [*words, f"--benchmark-json={out}"],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=apart,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert [each["name"] for each in json.loads(out.read_text())["benchmarks"]] == ["test_ours"]


def test_versions_are_drawn_in_order(tmp_path: Path) -> None:
    first, second = write(tmp_path, "v2", 2.0), write(tmp_path, "v1", 0.5)
    out = tmp_path / "ratios.png"
    assert ratio_picture.main([str(first), str(second), "--out", str(out)]) == 0
    assert out.stat().st_size > 1000
    figure = ratio_picture.figure_of(
        {path.stem: read_json(path, Ratios, KIND) for path in (first, second)}
    )
    (panel,) = [axes for axes in figure.axes if axes.get_visible()]
    assert [label.get_text() for label in panel.get_xticklabels()] == ["v2", "v1"]
    assert panel.lines[0].get_ydata().tolist() == [2.0, 0.5]  # type: ignore[union-attr]


def test_legends_are_in_words_and_readable() -> None:
    pairs = {
        ("test_by_prior[True-10000]", "test_by_prior[False-100]"):
            "tilted, 10,000 photographs / level, 100 photographs",
        ("test_linearise[compiled]", "test_linearise[by_torch]"): "compiled / by torch",
        ("test_network[folded]", "test_network_bare_product"):
            "network folded / network bare product",
    }  # fmt: skip
    ratios = tuple(
        Ratio(group="all", name=name, over=over, ratio=0.5, spread=0.1) for name, over in pairs
    )
    versions = {"v1": Ratios(commit="0" * 40, processor="any", ratios=ratios)}
    (panel,) = [axes for axes in ratio_picture.figure_of(versions).axes if axes.get_visible()]
    legend = panel.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(pairs.values())
    # Points at 100 dpi; the site shows the picture at its size.
    assert min(text.get_fontsize() for text in legend.get_texts()) * 100 / 72 >= 11


def test_what_is_no_file_of_ratios_is_not_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "ratios.png"
    assert ratio_picture.main([str(tmp_path / "none.json"), "--out", str(out)]) == 2
    assert capsys.readouterr().err.startswith("error: ") and not out.exists()
