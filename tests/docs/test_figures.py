"""The demo's figures in the documents are those of a run, and say of which."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.benchmark.made_data import write_flight
from tests.benchmark.test_cli import invoke
from tests.docs.documents import ROOT

PAGE = ROOT / "docs" / "demo.md"
RUN = ROOT / "runs" / "demo" / "leaderboard" / "leaderboard.md"
# Medians of 16 errors that are centimetres; another processor rounds otherwise.
TOLERANCE = 0.3
_BEGIN, _END = "<!-- figures: make demo -->", "<!-- end -->"


@dataclass(frozen=True)
class Figures:
    """Recalls as they are printed, at 0.25 m and 0.5 m, and median errors in metres and degrees."""

    recall: tuple[str, str]
    median: tuple[float, float]


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def read_page_figures(text: str) -> dict[tuple[str, str], Figures]:
    """Return the figures by method and condition, as ``winter-dusk``."""
    block = text.split(_BEGIN)[1].split(_END)[0]
    found = {}
    for line in block.strip().splitlines()[2:]:
        method, condition, close, wide, median = cells(line)
        metres, degrees = re.findall(r"[\d.]+", median)
        key = method.strip("`"), "-".join(condition.split(",")[0].split())
        found[key] = Figures((close, wide), (float(metres), float(degrees)))
    return found


def read_run_figures(text: str) -> dict[tuple[str, str], Figures]:
    """Return the figures of the first table of a leaderboard by method and condition."""
    rows = [cells(line) for line in text.split("## ")[1].splitlines() if line.startswith("| ")]
    head, found = rows[0], {}
    columns = [
        head.index(name) for name in ("0.25 m 2° (%)", "0.5 m 5° (%)", "median m", "median °")
    ]
    for row in rows[2:]:
        close, wide, metres, degrees = (row[column] for column in columns)
        if metres != "–":
            found[row[0], row[1]] = Figures((close, wide), (float(metres), float(degrees)))
    return found


def dataset_of(text: str) -> str:
    """Return the first digits of the data set's digest that a text names."""
    found = re.search(r"[Dd]ata set ([0-9a-f]{12})\b", text)
    assert found is not None
    return found[1]


def differences(page: str, run: str) -> list[str]:
    """Return where the page differs from a run: recalls must be equal, medians much the same."""
    stated, measured = read_page_figures(page), read_run_figures(run)
    wrong = []
    for key, figures in stated.items():
        if key not in measured:
            wrong.append(f"{key}: not in the run")
            continue
        if figures.recall != measured[key].recall:
            wrong.append(f"{key}: {figures.recall}, measured {measured[key].recall}")
        for said, is_ in zip(figures.median, measured[key].median, strict=True):
            if abs(said - is_) > TOLERANCE * is_ + 0.001:
                wrong.append(f"{key}: median {said}, measured {is_}")
    return wrong


def test_the_figures_are_those_of_the_run() -> None:
    if not RUN.is_file():
        pytest.skip("make demo was not run in this checkout")
    page, run = PAGE.read_text(encoding="utf-8"), RUN.read_text(encoding="utf-8")
    if dataset_of(page) != dataset_of(run):
        pytest.skip("this machine renders another data set than that of the page's figures")
    assert not differences(page, run)


def test_the_figures_name_machine_and_commit() -> None:
    text = PAGE.read_text(encoding="utf-8").split(_BEGIN)[0].split("## What it measures")[1]
    assert "`make demo`" in text
    assert re.search(r"commit [0-9a-f]{7}\b", text)
    assert re.search(r"cores of an? [A-Z]", text)
    assert dataset_of(text)


def test_every_row_of_the_demo_is_read() -> None:
    stated = read_page_figures(PAGE.read_text(encoding="utf-8"))
    assert list(stated) == [
        ("sift", "summer-noon"),
        ("sift", "winter-dusk"),
        ("pixloc", "winter-dusk"),
        ("objconnect", "winter-dusk"),
    ]


def leaderboard(page: str) -> str:
    """Return the leaderboard of a run that measured what the page says."""
    head = "| method | condition | queries | 0.25 m 2° (%) | 0.5 m 5° (%) | median m | median ° |"
    rows = [
        f"| {method} | {condition} | 16 | {f.recall[0]} | {f.recall[1]} | {f.median[0]} | "
        f"{f.median[1]} |"
        for (method, condition), f in read_page_figures(page).items()
    ]
    return "\n".join(["# Leaderboard", "", "## uav-sim: scene", "", head, "| --- |", *rows])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("62.5 [3.6, 98.7]", "81.2 [6.0, 99.7]"),
        ("| 0.218 |", "| 0.118 |"),
        ("| 0.015 |", "| 0.03 |"),
        ("| pixloc |", "| pixlok |"),
    ],
)
def test_another_figure_is_noticed(before: str, after: str) -> None:
    page = PAGE.read_text(encoding="utf-8")
    run = leaderboard(page)
    assert not differences(page, run)
    assert before in run
    assert len(differences(page, run.replace(before, after, 1))) == 1


def test_a_table_that_is_printed_today_is_read(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / "meadow")
    printed = invoke("evaluate", flight, "--method", "prior", "--out", tmp_path / "out").stdout
    ((key, figures),) = read_run_figures(printed).items()
    assert key == ("prior", "same-flight")
    assert figures.recall == ("0.0 [–]", "0.0 [–]"), "the queries are of one flight"
    assert figures.median[0] > 0
    assert len(dataset_of(printed)) == 12
