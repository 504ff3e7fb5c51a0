"""The page of all tracks in a real headless Chromium, opened as a file."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.evaluation.starts import NONE
from benchmark.report.album import read_album
from benchmark.report.board.command import BoardReport, board
from benchmark.report.board.pictures import keep_pictures, main
from benchmark.results.results_files import load
from benchmark.scoring.clustered import permutation_p
from benchmark.scoring.score import THRESHOLDS, is_correct
from benchmark.tracks.compact import store, targets_of
from benchmark.tracks.description import Track, TrackPlace, load_track, write_track
from benchmark.tracks.difficulty import Difficulty, QueryRow, write_queries
from objconnect.scene.bundle.held_out import HeldOut
from objconnect.scene.errors import InputError
from objconnect.scene.flights.reference_error import ReferencePoseError
from tests.benchmark.made_data import write_scene
from tests.benchmark.report.board.made_board import write_board
from tests.benchmark.report.test_leaderboard import run
from tests.browser import Browser

HOSTILE = "</script><script>window.harm = 1</script><img src=x onerror='window.harm = 1'>"
PHONE = 390


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as started:
        yield started


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A track with results, and one without."""
    folder = write_board(tmp_path_factory.mktemp("board") / "tracks")
    track = load_track("uav-seasons", folder)
    write_track(track.model_copy(update={"name": "yet-to-come", "title": HOSTILE}), folder)
    return folder


@pytest.fixture(scope="module")
def report(made: Path) -> BoardReport:
    return board(made, made.parent / "out")


@pytest.fixture
def page(made: Path, report: BoardReport, browser: Browser) -> Browser:
    browser.open(made.parent / "out" / "leaderboard.html")
    browser.run("location.hash = ''")
    return browser


def choose(browser: Browser, name: str, text: str) -> None:
    """Choose an option of a list by what it says."""
    chosen = browser.run(
        f"""(() => {{
        const list = document.getElementById({json.dumps(name)});
        list.value = [...list.options].find((o) => o.text === {json.dumps(text)}).value;
        list.dispatchEvent(new Event("change"));
        return document.getElementById({json.dumps(name)}).selectedOptions[0].text;
    }})()"""
    )
    assert chosen == text
    browser.settle()


def methods(browser: Browser) -> list[str]:
    return browser.texts("#rows th")


def is_clean(browser: Browser) -> bool:
    asked = [url for url in browser.requests if not url.startswith("data:")]
    return not browser.errors and len(asked) == 1 and asked[0].startswith("file:///")


def row(report: BoardReport, **wanted: Any) -> Any:
    (found,) = (
        row for row in report.rows[0] if all(getattr(row, k) == v for k, v in wanted.items())
    )
    return found


def test_it_opens_as_a_file_and_asks_for_nothing(page: Browser) -> None:
    assert page.texts("#tracks button")[0] == "uav-seasons\n72 queries, 3 methods, 2 starts"
    assert page.texts("#where") == ["uav-seasons: changed, all places"]
    for card in ("difficulty", "surest"):
        page.wait(f"document.querySelectorAll('#{card} svg.chart path').length > 1")
    assert len(page.texts("#difficulty h4")) == 4
    assert page.run("document.querySelectorAll('[id]').length") == page.run(
        "new Set([...document.querySelectorAll('[id]')].map(e => e.id)).size"
    )
    assert is_clean(page)


def test_figures_are_those_of_the_results(page: Browser, report: BoardReport) -> None:
    pixloc = row(report, start="error=3m,5deg", season="changed", part="all", method="pixloc")
    recall = pixloc.summary.recall["0.5m_5deg"]
    cells = page.texts("#rows tr:nth-child(2) td")
    shown = f"{recall.value:.1f}", f"[{recall.low:.1f},", f"{recall.high:.1f}]"
    assert tuple(cells[3].split()) == shown
    assert cells[:2] == ["48", "6\nin 3 places"]
    assert "48 queries of 6 courses over 3 places" in page.texts("#facts")[0]
    assert page.texts("#bounded tbody tr:nth-child(2) td")[1].split("\n")[0] == (
        f"{pixloc.surest.value:.1f}"
    )
    assert page.texts("#consistency tbody tr:nth-child(1) td")[0] == "–"
    nees = pixloc.summary.uncertainty.nees_mean
    shown = page.texts("#consistency tbody tr:nth-child(7) td")[0]
    assert float(shown.split("\n")[0]) == pytest.approx(nees, rel=0.01)
    assert shown.split("\n")[1].startswith("[")
    texts = page.run("[1000, 1000.1, 1e100, null].map(neesText)")
    assert texts == ["1000", "> 1000", "> 1000", "–"]


def test_errors_share_a_column_so_that_the_table_fits_a_desk(
    page: Browser, report: BoardReport
) -> None:
    pixloc = row(report, start="error=3m,5deg", season="changed", part="all", method="pixloc")
    (error,) = (text for text in page.texts("#rows tr:nth-child(2) td") if "°" in text)
    metres, degrees = error.split("\n")
    assert float(metres.removesuffix(" m")) == pytest.approx(pixloc.summary.median_t_m, rel=0.01)
    assert float(degrees.removesuffix("°")) == pytest.approx(pixloc.summary.median_r_deg, rel=0.01)
    names = page.texts("#results thead th")
    assert names.count("median error") == 1 and len(names) == 14


def test_figures_are_rounded_as_in_the_table(page: Browser) -> None:
    """Ties go to the even digit in Python; JavaScript alone would round them up."""
    values = [81.25, 91.75, 42.75, 0.35, 100.0, 0.25]
    assert page.run(f"{values}.map(tenths)") == [f"{value:.1f}" for value in values]


def test_a_method_that_was_asked_a_part_of_the_queries_says_so(
    tmp_path: Path, browser: Browser
) -> None:
    made = write_board(tmp_path / "tracks", starts=["none"])
    (made / "uav-seasons" / "results" / "none" / "town-2" / "pixloc.json").unlink()
    board(made, tmp_path / "out")
    assert "| changed | all | pixloc | 32 of 48 |" in (tmp_path / "out/leaderboard.md").read_text()
    browser.open(tmp_path / "out" / "leaderboard.html")
    first = [browser.texts(f"#rows tr:nth-child({k}) td")[0] for k in (1, 2, 3)]
    assert first == ["48", "32\nof 48", "48"]
    courses = [browser.texts(f"#rows tr:nth-child({k}) td")[1] for k in (1, 2)]
    assert [text.split("\n")[1] for text in courses] == ["in 3 places", "in 2 places"]
    heat = [browser.texts(f".heat tbody tr:nth-child({k}) td:nth-child(2) small") for k in (1, 2)]
    assert heat == [[], ["of 32"]]


def test_methods_are_compared_on_the_places_that_all_were_run_on(
    tmp_path: Path, browser: Browser
) -> None:
    made = write_board(tmp_path / "tracks")
    (made / "uav-seasons" / "results" / "none" / "town-2" / "pixloc.json").unlink()
    found = board(made, tmp_path / "out").boards[0]
    (run,) = (r for r in found.runs if (r.start, r.method) == ("none", "objconnect"))
    shared = [k for k, q in enumerate(found.queries) if q.dataset != "town-2" and not q.same]
    right = 100 * run.correct[1, shared].mean()
    browser.open(tmp_path / "out" / "leaderboard.html")
    assert not browser.texts("[data-of=shared]"), "from 3 m all methods have the same queries"
    choose(browser, "start", "no prior")
    browser.click("[data-of=shared][data-value='1']")
    facts = [browser.texts(f"#rows tr:nth-child({k}) td")[:2] for k in (1, 2, 3)]
    assert facts == [["32", "4\nin 2 places"]] * 3
    shown = browser.texts("#rows tr:nth-child(3) td")[3].split()[0]
    assert float(shown) == pytest.approx(right, abs=0.06)
    assert "32 queries of 4 courses over 2 places" in browser.texts("#facts")[0]
    assert "of 32 queries" in browser.texts("#worst-queries div .quiet")[0]
    assert browser.run("location.hash").endswith("/1/shared")
    browser.reload()
    assert browser.texts("#rows tr:nth-child(1) td")[0] == "32"
    choose(browser, "part", "town")
    assert "16 queries of 2 courses over 1 place." in browser.texts("#facts")[0]
    assert not browser.errors


def test_a_track_measured_in_part_says_which_places(tmp_path: Path, browser: Browser) -> None:
    made = write_board(tmp_path / "tracks")
    track = load_track("uav-seasons", made)
    later = TrackPlace(dataset="park-2", preset="park", seed=2)
    write_track(track.model_copy(update={"places": (later, *track.places)}), made)
    report = board(made, tmp_path / "out")
    missing = ("1 of 4 places are not rendered yet: park-2",)
    assert report.boards[0].missing == missing
    browser.open(tmp_path / "out" / "leaderboard.html")
    said = "3 of 4 places, 72 queries, 3 methods, 2 starts"
    assert browser.texts("#tracks button small") == [said]
    assert browser.texts("#measured") == [
        "Measured so far: 3 of 4 places, namely park-1, town-1, town-2."
    ]
    assert is_clean(browser)


def test_filters_change_the_table(page: Browser, report: BoardReport) -> None:
    for start, words in (("none", "no prior"), ("error=3m,5deg", "a prior wrong by 3 m and 5°")):
        choose(page, "start", words)
        for season, part, named in (
            ("changed", "town", ("changed", "town")),
            ("same", "park", ("same season", "park")),
            ("snow-dusk", "all", ("snow-dusk", "all places")),
        ):
            choose(page, "season", named[0])
            choose(page, "part", named[1])
            assert page.texts("#where") == [f"uav-seasons: {', '.join(named)}"]
            best = row(report, start=start, season=season, part=part, method="objconnect").summary
            cells = page.texts("#rows tr:nth-child(3) td")
            assert [cells[0], cells[1].split("\n")[0]] == [str(best.queries), str(best.courses)]
            assert cells[4].split("\n")[0] == f"{best.recall['5m_10deg'].value:.1f}"
    # A single condition is of all places only.
    assert page.texts("#part option") == ["all places"]
    assert is_clean(page)


def test_what_the_reference_poses_do_not_judge_is_a_dash(tmp_path: Path, browser: Browser) -> None:
    """At 0.5 m no card has a figure; at 5 m all have one."""
    made = write_board(tmp_path / "tracks")
    track = load_track("uav-seasons", made)
    inexact = {"reference_error": ReferencePoseError(metres=0.6, source="stated")}
    places = tuple(place.model_copy(update=inexact) for place in track.places)
    write_track(track.model_copy(update={"places": places}), made)
    board(made, tmp_path / "out")
    browser.open(tmp_path / "out" / "leaderboard.html")
    cells = browser.texts("#rows tr:nth-child(3) td")
    assert [cell == "–" for cell in cells[2:9]] == [True, True, False, True, False, True, True]
    assert browser.texts(".heat tbody td") == ["–"] * 3 * len(browser.texts(".heat thead th small"))
    assert "too inexact to judge 0.5 m 5°" in browser.texts("#pairs")[0]
    browser.click("[data-of=threshold]:nth-of-type(3)")
    assert "–" not in browser.texts(".heat tbody td")
    assert is_clean(browser)


def test_cells_of_what_is_held_out_are_shown(tmp_path: Path, browser: Browser) -> None:
    made = write_board(tmp_path / "tracks")
    held = HeldOut(conditions=("snow",), presets=("park",))
    track = load_track("uav-seasons", made)
    write_track(track.model_copy(update={"held_out": held}), made)
    board(made, tmp_path / "out")
    browser.open(tmp_path / "out" / "leaderboard.html")
    for name, queries, courses in (("unseen condition", 16, 2), ("unseen both", 8, 1)):
        choose(browser, "season", name)
        assert browser.texts("#where") == [f"uav-seasons: {name}, all places"]
        assert f"{queries} queries of {courses} course" in browser.texts("#facts")[0]
        listed = browser.texts("#worst-queries .choice .quiet")[0]
        assert f"of {queries} queries" in listed
    # One course: no interval, no p.
    assert "[–]" in browser.texts("#rows td:nth-child(4)")[0]
    assert "p unknown" in browser.texts("#pairs tbody tr:nth-child(3) td")[0]
    assert "changed, by what training may use" in browser.texts("#overview thead th")
    assert is_clean(browser)


def test_the_table_can_be_sorted(page: Browser) -> None:
    assert methods(page) == ["sift", "pixloc", "objconnect"]
    page.click("#results thead th:nth-child(1) button")
    assert methods(page) == ["objconnect", "pixloc", "sift"]
    page.click("#results thead th:nth-child(4) button")
    values = [float(text.split("\n")[0]) for text in page.texts("#rows td:nth-child(4)")]
    assert values == sorted(values, reverse=True)
    page.click("#results thead th:nth-child(4) button")
    assert page.run("document.querySelector('#results th:nth-child(4)').ariaSort") == "ascending"
    values = [float(text.split("\n")[0]) for text in page.texts("#rows td:nth-child(4)")]
    assert values == sorted(values)
    # The order outlives another cell.
    choose(page, "season", "same season")
    assert page.run("document.querySelector('#results th:nth-child(4)').ariaSort") == "ascending"
    assert is_clean(page)


def test_the_paired_comparison_is_shown(page: Browser, report: BoardReport) -> None:
    page.click("[data-of=threshold][data-value='0']")
    runs = {run.method: run for run in report.boards[0].runs if run.start == "error=3m,5deg"}
    changed = [k for k, query in enumerate(report.boards[0].queries) if not query.same]
    before, after = (runs[name].correct[0, changed] for name in ("sift", "objconnect"))
    lost, won = int((before & ~after).sum()), int((~before & after).sum())
    # Row objconnect, column sift.
    cell = page.texts("#pairs tbody tr:nth-child(3) td")[0].split("\n")
    assert cell[0] == f"+{100 * (won - lost) / len(changed):.1f}"
    p = permutation_p(before.tolist(), after.tolist(), report.boards[0].courses[changed].tolist())
    assert p is not None
    assert cell[-1] == ("p < 0.001" if p < 0.001 else f"p = {p:.{3 if p < 0.1 else 2}f}")
    title = page.run("document.querySelector('#pairs tbody tr:nth-child(3) td').title")
    assert title == f"right where the other is wrong: {won}; wrong where it is right: {lost}"
    assert "by course (6 courses here)" in page.texts("#pairs .quiet")[0]


def test_a_cell_of_the_overview_is_shown(page: Browser) -> None:
    page.click("#overview tbody tr:nth-child(1) td:nth-child(6) button")
    assert page.texts("#where") == ["uav-seasons: same season, park"]
    assert page.run("document.querySelectorAll('#overview [aria-current=true]').length") == 3
    assert page.run("location.hash") == "#uav-seasons/error%3D3m%2C5deg/same/park/1"


def test_the_address_names_the_cell(made: Path, page: Browser) -> None:
    choose(page, "season", "snow-dusk")
    choose(page, "start", "no prior")
    address = page.run("location.hash")
    page.open(made.parent / "out" / "leaderboard.html")
    page.run(f"location.hash = {json.dumps(address)}")
    page.reload()
    assert page.texts("#where") == ["uav-seasons: snow-dusk, all places"]
    assert page.run("document.getElementById('start').selectedOptions[0].text") == "no prior"


def test_worst_queries_come_first(page: Browser, report: BoardReport) -> None:
    choose(page, "start", "no prior")
    page.click("#rows tr:nth-child(1) button")
    assert page.run("document.getElementById('run').selectedOptions[0].text") == "sift"
    (run,) = (r for r in report.boards[0].runs if (r.start, r.method) == ("none", "sift"))
    changed = [k for k, query in enumerate(report.boards[0].queries) if not query.same]
    errors = {
        k: answer.t_err_m
        for k in changed
        if (answer := run.answers[k]) is not None and answer.t_err_m is not None
    }
    worst = max(errors, key=lambda k: errors[k])
    query = report.boards[0].queries[worst]
    said = page.texts("#worst-rows tr:first-child th")[0].split("\n")
    assert said == [query.dataset, query.row.name]
    shown = page.texts("#worst-rows tr:first-child td")
    assert float(shown[2].removesuffix(" m")) == pytest.approx(errors[worst], rel=0.01)
    assert float(shown[5]) == pytest.approx(query.row.difficulty.overlap, abs=1e-3)
    lost = len(changed) - len(errors)
    assert page.texts("#worst-queries div .quiet") == [
        f"10 of {len(changed)} queries; {lost} failed"
    ]
    page.click("#more")
    assert len(page.texts("#worst-rows tr")) == 20
    assert is_clean(page)


def test_difficulty_counts_every_query(page: Browser) -> None:
    page.click("#difficulty summary")
    counts = [int(text) for text in page.texts("#difficulty tbody td:nth-child(3)")]
    assert [sum(counts[:5]), sum(counts[5:11]), sum(counts[11:17]), sum(counts[17:])] == [48] * 4


def test_a_hostile_title_without_results_is_harmless(page: Browser) -> None:
    page.click("#tracks button:nth-child(2)")
    assert page.texts("#board .lede") == [HOSTILE]
    assert page.texts("#board .note") == ["Nothing is measured on this track yet."]
    assert not page.run("'harm' in window")
    page.click("#tracks button:nth-child(1)")
    assert page.texts("#where") == ["uav-seasons: changed, all places"]
    assert is_clean(page)


def test_the_papers_table_is_labelled(page: Browser) -> None:
    sources = page.texts("#paper-table tbody td:nth-child(2)")
    assert sources[:3] == ["as reported by the paper"] * 3
    assert len(sources) == 3 + 6
    assert all(source.startswith("measured here, start:") for source in sources[3:])


@pytest.mark.parametrize("dark", [False, True])
def test_it_fits_a_phone(made: Path, page: Browser, dark: bool) -> None:
    page.open(made.parent / "out" / "leaderboard.html", PHONE, 844, dark)
    page.wait("document.querySelectorAll('#difficulty svg.chart').length === 4")
    assert page.run("document.documentElement.scrollWidth") == PHONE
    ground = page.run("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(20, 23, 26)") == dark
    assert is_clean(page)


def test_the_command_writes_page_and_markdown(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    answer = CliRunner().invoke(app, ["leaderboard", "--board", str(made), "--out", str(out)])
    assert answer.exit_code == 0
    assert (out / "leaderboard.md").read_text() == answer.stdout
    assert sorted(path.name for path in out.iterdir()) == ["leaderboard.html", "leaderboard.md"]
    answer = CliRunner().invoke(app, ["leaderboard", "--board", str(made), "--json"])
    first = json.loads(answer.stdout)["tracks"][0]["rows"][0]
    assert (first["season"], first["part"], first["method"]) == ("changed", "all", "sift")
    assert first["summary"]["queries"] == 48
    for given in ([], [str(made), "--board", str(made)]):
        answer = CliRunner().invoke(app, ["leaderboard", *given])
        assert answer.exit_code == 2
        assert isinstance(answer.exception, SystemExit | InputError)


def test_worst_queries_have_pictures_where_an_album_is_kept(
    tmp_path: Path, browser: Browser
) -> None:
    """A scene's own results, kept in a track with what ``evaluate`` wrote beside them."""
    scene = write_scene(tmp_path / "hamlet")
    path = run(scene, tmp_path / "results", "sift", NONE)
    results = load(path)
    place = TrackPlace(dataset="hamlet", preset="town", seed=1, renders=(results.dataset.sha256,))
    track = Track(
        name="one", title="One", config="x", places=(place,), starts=("none",), methods=("sift",)
    )
    folder = tmp_path / "tracks" / "one"
    write_track(track, folder.parent)
    rows = [
        QueryRow(q.name, q.condition, q.group, "town", Difficulty(0.5, 1, 1, 1))
        for q in results.queries
    ]
    write_queries(folder / "queries" / "hamlet.csv", rows)
    store(targets_of([path], folder))
    (kept,) = keep_pictures([tmp_path / "results"], folder)
    album = read_album(kept, results.dataset.sha256)
    wrong = {q.name for q in results.queries if not is_correct(q, THRESHOLDS[1])}
    assert album is not None
    assert set(album.entries) == wrong
    board(folder.parent, tmp_path / "out")
    browser.open(tmp_path / "out" / "leaderboard.html")
    assert len(wrong) == browser.run("document.querySelectorAll('#worst-rows tr:has(img)').length")
    browser.wait("[...document.querySelectorAll('#worst-rows img')].every(i => i.naturalWidth)")
    assert browser.run("document.querySelector('#worst-rows img').naturalWidth") == 96
    assert is_clean(browser)
    with pytest.raises(InputError, match="belongs to the data of"):
        keep_pictures([tmp_path], folder)
    assert main(["--track", str(folder), str(tmp_path / "results")]) == 0
    assert main(["--track", str(folder), str(tmp_path)]) == 2


@pytest.mark.thorough
def test_a_large_board_stays_small_and_quick(tmp_path: Path, browser: Browser) -> None:
    presets = ("town", "suburb", "park", "farmland", "industrial")
    methods = tuple(f"method-{k}" for k in range(8))
    starts = ("error=3m,5deg", "error=10m,10deg", "gps=50m", "none")
    places = [(preset, seed) for preset in presets for seed in (1, 2)]
    write_board(tmp_path / "tracks", 107, places, methods, starts)
    began = time.process_time()
    board(tmp_path / "tracks", tmp_path / "out")
    assert time.process_time() - began < 60
    path = tmp_path / "out" / "leaderboard.html"
    assert path.stat().st_size < 15_000_000
    browser.open(path, PHONE)
    assert browser.texts("#tracks button small") == ["3210 queries, 8 methods, 4 starts"]
    assert len(methods) == len(browser.texts("#rows tr"))
    choose(browser, "start", "the position alone, wrong by 50 m")
    choose(browser, "part", "farmland")
    assert browser.texts("#rows td:nth-child(2)") == ["428"] * 8
    assert browser.run("document.documentElement.scrollWidth") == PHONE
    assert is_clean(browser)
