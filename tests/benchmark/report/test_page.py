"""The page in a real headless Chromium, opened as a file."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.basin import PriorError, basin
from benchmark.report.album import ALBUM, SIDE, Album, read_album, write_album
from benchmark.report.leaderboard import leaderboard
from benchmark.report.page import PICTURE_BYTES
from benchmark.report.self_contained import embed
from benchmark.results.results import Results, rescore
from benchmark.results.results_files import load
from objconnect.scene.flights.reference_error import REFERENCE_ERROR
from objconnect.scene.localizer import Status
from tests.benchmark.made_data import FakeLocalizer, write_flight, write_scene
from tests.benchmark.report.test_leaderboard import run
from tests.browser import Browser

HOSTILE = "</script><script>window.harm = 1</script><img src=x onerror='window.harm = 1'>"
PHONE = 390


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as started:
        yield started


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two methods on a scene and on a flight, and one basin."""
    folder = tmp_path_factory.mktemp("page")
    scene, flight = write_scene(folder / "hamlet"), write_flight(folder / "meadow")
    for method in ("sift", "zzz"):
        run(scene, folder / "out", method)
        run(flight, folder / "out", method)
    worse = folder / "out" / "hamlet" / "zzz.json"
    _without(worse, "summer-grid/images/000000.jpg")
    (dataset,) = open_datasets(scene)
    localizer = FakeLocalizer({})
    localizer.name = "sift"
    basin(dataset, localizer, folder / "out", [PriorError(0, 0), PriorError(3, 5)])
    return folder / "out"


def _without(path: Path, name: str) -> None:
    """The method fails on one query more."""
    results = load(path)
    lost = {"status": Status.FAILED, "t_err_m": None, "r_err_deg": None, "cam_from_world": None}
    queries = [q.model_copy(update=lost) if q.name == name else q for q in results.queries]
    rescore(results.model_copy(update={"queries": tuple(queries)})).write(path)


@pytest.fixture(scope="module")
def page(out: Path) -> Path:
    leaderboard([out], out.parent / "board")
    return out.parent / "board" / "leaderboard.html"


def methods(browser: Browser) -> list[tuple[str, ...]]:
    rows = browser.run("[...document.querySelectorAll('#rows tr')].map(r => r.innerText)")
    return [tuple(row.split("\n")[0].split("\t")[:2]) for row in rows]


def choose_board(browser: Browser, number: int) -> None:
    browser.click(f"#boards button:nth-child({number})")


def is_clean(browser: Browser) -> bool:
    assert not browser.errors
    asked = [url for url in browser.requests if not url.startswith("data:")]
    assert len(asked) == 1
    assert asked[0].startswith("file:///")
    return True


def test_it_opens_as_a_file_and_asks_for_nothing(page: Path, browser: Browser) -> None:
    browser.open(page)
    assert is_clean(browser)
    assert browser.texts("#boards button") == [
        "meadow\nflight, start: each query's own prior",
        "hamlet\nuav-sim, start: each query's own prior",
    ]
    choose_board(browser, 2)
    assert browser.texts("h2") == ["uav-sim: hamlet"]
    assert browser.texts(".note")[0].startswith("Saturated: under summer-noon, the map")
    assert browser.texts(".note code") == ["summer-noon", "sift"]
    assert "(first digits of its SHA-256 digest)" in browser.texts(".card > .quiet")[0]
    for card in ("curves", "speed", "basin"):
        browser.wait(f"document.querySelectorAll('#{card} svg.chart path').length > 1")
    assert is_clean(browser)


def test_what_the_reference_poses_do_not_judge_is_a_dash(tmp_path: Path, browser: Browser) -> None:
    """No threshold is judged: no card fails, and none has a figure."""
    flight = write_flight(tmp_path / "meadow")
    (flight / REFERENCE_ERROR).write_text('{"metres": null, "source": "unknown"}')
    for method in ("sift", "zzz"):
        run(flight, tmp_path / "out", method)
    (dataset,) = open_datasets(flight)
    localizer = FakeLocalizer({})
    localizer.name = "sift"
    basin(dataset, localizer, tmp_path / "out", [PriorError(0, 0), PriorError(3, 5)])
    leaderboard([tmp_path / "out"], tmp_path / "board")
    browser.open(tmp_path / "board" / "leaderboard.html")
    browser.settle()
    cells = browser.texts("#rows tr:nth-child(1) td")
    assert cells[3:6] == cells[8:11] == ["–"] * 3
    assert set(browser.texts(".heat tbody td")) == {"–"}
    assert set(browser.texts("#pairs tbody td")) == {""}
    assert browser.run("document.querySelectorAll('#surest svg.chart path').length") == 0
    assert is_clean(browser)


def test_figures_are_those_of_the_results(out: Path, page: Path, browser: Browser) -> None:
    browser.open(page)
    choose_board(browser, 2)
    cells = browser.texts("#rows tr:nth-child(6) td")
    results = load(out / "hamlet" / "zzz.json")
    part = results.by_condition["winter-dusk"].recall["5m_10deg"]
    assert cells[:3] == ["winter-dusk", "3", "1"]
    assert cells[5].split() == [f"{part.value:.1f}", "[–]"], "one course"
    # Rows minus columns: zzz has lost one query of six, at every threshold.
    matrix = browser.texts("#pairs td")
    assert [cell.split("\n")[0] for cell in matrix] == ["", "+16.7", "−16.7", ""]
    assert "[–]\np unknown" in matrix[1]
    assert browser.texts("#heat td") == ["100.0", "0.0", "66.7", "0.0"]
    browser.click("[data-of=threshold][data-value='2']")
    assert browser.texts("#heat td") == ["100.0", "33.3", "66.7", "33.3"]
    browser.run("document.querySelector('#condition').value = 1")
    browser.run("document.querySelector('#condition').dispatchEvent(new Event('change'))")
    assert browser.texts("#pairs td")[1].startswith("±0.0")
    assert is_clean(browser)


def test_the_surest_queries_come_first(out: Path, page: Path, browser: Browser) -> None:
    """Nobody states a sigma here: the curve ends at the recall of all queries."""
    browser.open(page)
    choose_board(browser, 2)
    ends = browser.run(
        "JSON.stringify(Array.from(document.querySelectorAll('#surest path[fill=none]'), "
        "(path) => path.getAttribute('d').split('L').length))"
    )
    assert json.loads(ends)[-2:] == [6, 6]
    assert "no covariance" in browser.texts("#surest p")[-1]
    assert is_clean(browser)


def test_the_papers_table_is_labelled(page: Path, browser: Browser) -> None:
    browser.open(page)
    rows = [text.split("\t") for text in browser.texts("#paper-table tbody tr")]
    assert rows[1] == ["PixLoc", "as reported by the paper", "90.4", "81.1", "62.5", "93.8"]
    assert [row[1] for row in rows[3:]] == ["measured here, start: each query's own prior"] * 2
    assert rows[3][5] == "50.0 [–] of 6"


def test_sorting_by_mouse_and_by_key(page: Path, browser: Browser) -> None:
    browser.open(page)
    choose_board(browser, 2)
    before = methods(browser)
    assert before[0] == ("sift", "all")
    heading = "#results thead th:nth-child(1)"
    browser.click(f"{heading} button")
    browser.click(f"{heading} button")
    assert browser.run(f"document.querySelector('{heading}').ariaSort") == "descending"
    assert [row[0] for row in methods(browser)] == ["zzz"] * 3 + ["sift"] * 3
    loose = "#results thead th:nth-child(7)"
    browser.run(f"document.querySelector('{loose} button').focus()")
    browser.press("Enter")
    recalls = [float(text.split()[0]) for text in browser.texts("#rows td:nth-child(7)")]
    assert recalls == sorted(recalls, reverse=True)
    assert recalls[0] > recalls[-1]
    browser.press("Enter")
    assert [float(text.split()[0]) for text in browser.texts("#rows td:nth-child(7)")] == recalls[
        ::-1
    ]
    assert is_clean(browser)


def test_worst_and_best_are_one_click_away(out: Path, page: Path, browser: Browser) -> None:
    browser.open(page)
    choose_board(browser, 2)
    names = browser.run(
        "[...document.querySelectorAll('#rows button')].map(b => b.getAttribute('aria-label'))"
    )
    worst = names.index("worst query of sift, all") + 1
    assert names[worst] == "best query of sift, all"
    browser.click("#rows tr:first-child .acts button:first-child")
    shown = browser.texts("#query .facts dd")
    assert shown[0] == "winter-grid/images/000002.jpg"
    assert shown[2] == "failed"
    # The drill-down has come into view, and the true pose is drawn without an estimate.
    assert browser.run("document.querySelector('#queries').getBoundingClientRect().top") < 200
    drawn = "document.querySelectorAll('#query-picture {}').length"
    assert browser.run(drawn.format(".truth")) > 8
    assert browser.run(drawn.format("path.guess")) == 0

    browser.click("#rows tr:first-child .acts button:last-child")
    shown = browser.texts("#query .facts dd")
    assert shown[0].startswith("summer-grid/")
    assert shown[2:4] == ["ok", "0.100 m"]
    assert browser.run(drawn.format("path.guess")) > 8
    album = read_album(out / "hamlet" / ALBUM, load(out / "hamlet" / "sift.json").dataset.sha256)
    assert album is not None
    entry = album.entries[shown[0]]
    assert browser.run(drawn.format(".truth")) == len(entry.truth)
    assert entry.neighbour is not None
    assert entry.neighbour in browser.texts("#map-picture figcaption")[0]
    for picture in ("query-picture", "map-picture"):
        size = browser.run(
            f"""(async () => {{
            const image = new Image();
            image.src = document.querySelector('#{picture} image').getAttribute('href');
            await image.decode();
            return [image.naturalWidth, image.naturalHeight];
            }})()"""
        )
        assert size == [96, 64]

    places = []
    for button in ("to-worse", "to-worse", "to-better", "to-worst"):
        browser.click(f"#{button}")
        places.append(browser.texts("#query .place")[0])
    assert places == [f"{k} of 6, best first" for k in (2, 3, 2, 6)]
    assert is_clean(browser)


@pytest.mark.parametrize("width", [320, PHONE, 768, 1280])
def test_nothing_sticks_out(page: Path, browser: Browser, width: int) -> None:
    browser.open(page, width)
    for board in (1, 2):
        choose_board(browser, board)
        browser.click("#rows tr:first-child .acts button")
        browser.settle()
        assert browser.run("document.documentElement.scrollWidth") == width
    if width >= 1280:
        # On a desk the whole table is there without scrolling.
        assert browser.run(
            "(e => e.scrollWidth <= e.clientWidth)(document.querySelector('#board .scroll'))"
        )
    assert is_clean(browser)


@pytest.mark.parametrize("dark", [False, True])
def test_text_can_be_read(page: Path, browser: Browser, dark: bool) -> None:
    """Contrast of text on its ground, 4.5 as WCAG 2.2 AA asks for."""
    browser.open(page, dark=dark)
    choose_board(browser, 2)
    assert browser.run("matchMedia('(prefers-color-scheme: dark)').matches") is dark
    pairs = browser.run(
        """[...document.querySelectorAll('h2, .quiet, .note, td, td small, th, button, dd, dt')]
        .filter(e => e.innerText && !e.disabled).map(e => {
            const grounds = [];
            for (let n = e; n; n = n.parentElement)
                grounds.push(getComputedStyle(n).backgroundColor);
            return [e.innerText.slice(0, 30), getComputedStyle(e).color, grounds];
        })"""
    )
    assert len(pairs) > 50
    worst = min((_contrast(colour, grounds), text) for text, colour, grounds in pairs)
    assert worst[0] >= 4.5, worst


def _contrast(colour: str, grounds: Sequence[str]) -> float:
    def channels(css: str) -> tuple[np.ndarray, float]:
        scale = 1.0 if css.startswith("color(") else 255.0
        inner = css[css.index("(") + 1 : -1].replace("srgb", "").replace("/", " ").replace(",", " ")
        numbers = [float(word) for word in inner.split()]
        return np.array(numbers[:3]) / scale, numbers[3] if len(numbers) > 3 else 1.0

    def luminance(rgb: np.ndarray) -> float:
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    below = np.ones(3)
    for ground in reversed(grounds):
        rgb, alpha = channels(ground)
        below = alpha * rgb + (1 - alpha) * below
    high, low = sorted((luminance(channels(colour)[0]), luminance(below)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_names_cannot_do_harm(out: Path, tmp_path: Path, browser: Browser) -> None:
    results = load(out / "meadow" / "sift.json")
    album = read_album(out / "meadow" / ALBUM, results.dataset.sha256)
    assert album is not None
    queries = [
        query.model_copy(
            update={"name": f"{HOSTILE}{query.name}", "condition": HOSTILE, "reason": HOSTILE}
        )
        for query in results.queries
    ]
    hostile = rescore(
        results.model_copy(
            update={
                "method": results.method.model_copy(update={"name": HOSTILE}),
                "dataset": results.dataset.model_copy(
                    update={
                        "name": HOSTILE + "__proto__\u2028${data}",
                        "map_conditions": (HOSTILE,),
                    }
                ),
                "queries": tuple(queries),
            }
        )
    )
    hostile.write(tmp_path / "out" / "x.json")
    entries = {f"{HOSTILE}{name}": entry for name, entry in album.entries.items()}
    write_album(tmp_path / "out" / ALBUM, replace(album, entries=entries))
    leaderboard([tmp_path / "out"], tmp_path / "board")
    browser.open(tmp_path / "board" / "leaderboard.html", PHONE)
    assert is_clean(browser)
    assert browser.run("window.harm") is None
    assert browser.run("document.scripts.length") == 2
    assert browser.texts("h2")[0].startswith(f"flight: {HOSTILE}")
    assert browser.texts("#query .facts dd")[0].startswith(HOSTILE)
    assert browser.run("document.documentElement.scrollWidth") == PHONE


def test_nothing_ends_the_block_of_data() -> None:
    data = {"name": "</script><!-- & \u2028\u2029 \udcff"}
    text = embed(data)
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == {"name": "</script><!-- & \u2028\u2029 ?"}


def test_a_script_of_somebody_else_does_not_run(
    page: Path, tmp_path: Path, browser: Browser
) -> None:
    """Even where one got into the page, its policy names another one's digest."""
    text = page.read_text().replace("</body>", "<script>window.harm = 1</script></body>")
    (tmp_path / "changed.html").write_text(text)
    browser.open(tmp_path / "changed.html")
    assert browser.run("window.harm") is None
    assert any("Content Security Policy" in error for error in browser.errors)


def test_results_without_an_album_are_shown(out: Path, tmp_path: Path, browser: Browser) -> None:
    load(out / "meadow" / "sift.json").write(tmp_path / "sift.json")
    leaderboard([tmp_path / "sift.json"], tmp_path)
    browser.open(tmp_path / "leaderboard.html")
    assert "No album lies beside these results" in browser.texts("#query-picture")[0]
    assert "Nothing is measured yet" in browser.texts("#basin")[0]
    assert browser.run("document.querySelector('#pairs')") is None
    assert "null" not in browser.texts("#charts")[0]
    assert is_clean(browser)


def test_a_query_off_the_map_is_shown(out: Path, tmp_path: Path, browser: Browser) -> None:
    results = load(out / "meadow" / "sift.json")
    album = read_album(out / "meadow" / ALBUM, results.dataset.sha256)
    assert album is not None
    nothing = {"world": np.zeros((0, 3)), "truth": np.zeros((0, 2)), "seen": np.zeros((0, 2))}
    entries = {
        name: replace(entry, neighbour=None, **nothing) for name, entry in album.entries.items()
    }
    results.write(tmp_path / "sift.json")
    write_album(tmp_path / ALBUM, replace(album, entries=entries))
    leaderboard([tmp_path / "sift.json"], tmp_path)
    browser.open(tmp_path / "leaderboard.html")
    assert browser.run("document.querySelectorAll('#query-picture image').length") == 1
    assert "No photograph of the map shows this ground." in browser.texts("#map-picture")[0]
    assert is_clean(browser)


def four_by_five_hundred(out: Path, target: Path) -> Results:
    """Every query has photographs of its own, which compress worse than any ground does."""
    results = load(out / "hamlet" / "sift.json")
    album = read_album(out / "hamlet" / ALBUM, results.dataset.sha256)
    assert album is not None
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (SIDE * 2 // 3, SIDE, 3), dtype=np.uint8)
    stream = io.BytesIO()
    Image.fromarray(noise).save(stream, "WEBP", quality=20, method=0)
    photograph = stream.getvalue()
    sources = [(q, album.entries[q.name]) for q in results.queries if q.status is Status.OK]
    entries, neighbours = {}, {}
    for k in range(500):
        _, entry = sources[k % len(sources)]
        name = f"images/{k:06d}.jpg"
        assert entry.neighbour is not None
        neighbours[name] = replace(
            album.neighbours[entry.neighbour], photograph=photograph + b"m%03d" % k
        )
        entries[name] = replace(entry, photograph=photograph + b"q%03d" % k, neighbour=name)
    write_album(target / ALBUM, Album(album.sha256, entries, neighbours))
    for method in ("a", "b", "c", "d"):
        errors = np.exp(rng.normal(-1, 1.5, len(entries)))
        queries = tuple(
            sources[k % len(sources)][0].model_copy(
                update={
                    "name": name,
                    "group": f"flight {k % 9}",
                    "t_err_m": float(error),
                    "r_err_deg": float(error),
                }
            )
            for k, (name, error) in enumerate(zip(entries, errors, strict=True))
        )
        named = results.method.model_copy(update={"name": method})
        results = rescore(results.model_copy(update={"method": named, "queries": queries}))
        results.write(target / f"{method}.json")
    return results


@pytest.mark.thorough
def test_a_large_page_stays_small_and_quick(out: Path, tmp_path: Path, browser: Browser) -> None:
    last = four_by_five_hundred(out, tmp_path / "out")
    leaderboard([tmp_path / "out"], tmp_path)
    page = tmp_path / "leaderboard.html"
    assert PICTURE_BYTES / 2 < page.stat().st_size < 15_000_000
    browser.open(page, PHONE)
    assert len(browser.texts("#rows tr")) == 12
    # The worst query of the last method has its pictures.
    browser.click("#rows tr:nth-child(10) .acts button:first-child")
    worst = max(last.queries, key=lambda query: query.t_err_m or 0)
    assert browser.texts("#query .facts dd")[0] == worst.name
    assert browser.run("document.querySelectorAll('#query image').length") == 2
    assert browser.texts("#query .place") == ["500 of 500, best first"]
    assert "All queries are of one course" in browser.texts("#pairs .quiet")[0]
    assert browser.run("document.documentElement.scrollWidth") == PHONE
    assert is_clean(browser)
