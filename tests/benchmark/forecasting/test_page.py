"""The page of a forecast in a real headless Chromium, opened as a file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmark.forecasting.page import MARK, page
from benchmark.forecasting.picture import draw
from objconnect.scene.storage.images import read_rgb
from tests.benchmark.forecasting.made_forecast import report
from tests.browser import Browser

NAME = "<b>ham&let</b>"


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.integers(60, 180, (64, 64, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def shown(
    tmp_path_factory: pytest.TempPathFactory, ground: np.ndarray
) -> Iterator[tuple[Browser, Path]]:
    path = tmp_path_factory.mktemp("page") / "forecast.html"
    path.write_text(page(report(scene=NAME), ground, 160.0), encoding="utf-8")
    with Browser() as browser:
        browser.open(path)
        yield browser, path


def test_the_verdicts_stand_first_and_choose_the_season(shown: tuple[Browser, Path]) -> None:
    browser, path = shown
    browser.open(path)
    summer, snow = browser.texts(".verdicts button")
    assert "summer-noon" in summer and "Fixes all along" in summer
    assert "snow-dusk" in snow and "Too few fixes to navigate by" in snow
    assert browser.texts("#weak tbody tr") == []
    browser.click("[data-season=snow-dusk]")
    (weak,) = browser.texts("#weak tbody tr")
    assert weak.startswith("3 to 5") and "photograph the ground" in weak
    assert browser.run("document.activeElement.dataset.season") == "snow-dusk"
    assert browser.texts("#map h2") == ["The route, snow-dusk"]
    assert browser.errors == []


def test_a_waypoint_tells_its_figures_by_mouse_and_keys(shown: tuple[Browser, Path]) -> None:
    browser, path = shown
    browser.open(path)
    browser.click("[data-season=snow-dusk]")
    browser.click("#map circle:nth-of-type(3)")
    (facts,) = browser.texts("#facts")
    assert "Waypoint 3" in facts and "0 of 2" in facts and "few points" in facts
    browser.run("document.querySelector('#map circle:nth-of-type(5)').focus()")
    browser.press("Enter")
    (facts,) = browser.texts("#facts")
    assert "Waypoint 5" in facts and "the season hides them" in facts


def test_colours_and_bars_follow_the_probability(shown: tuple[Browser, Path]) -> None:
    browser, path = shown
    browser.open(path)
    browser.click("[data-season=snow-dusk]")
    fills = browser.run(
        "[...document.querySelectorAll('#map circle')].map(c => c.getAttribute('fill'))"
    )
    red, blue = ([int(c.split("(")[1].strip(")").split()[k]) for c in fills] for k in (0, 2))
    assert blue[0] > red[0] and red[3] > blue[3], "likely is blue, unlikely is red"
    heights = browser.run(
        "[...document.querySelectorAll('.profile rect')].map(r => +r.getAttribute('height'))"
    )
    assert len(heights) == 5 and heights[0] > 2 * heights[3]


def test_photographs_that_would_help_are_listed(shown: tuple[Browser, Path]) -> None:
    browser, path = shown
    browser.open(path)
    (row,) = browser.texts("#photographs tbody tr")
    assert row.startswith("3 to 4") and "47.0000" in row


def test_names_are_text_and_nothing_is_loaded(shown: tuple[Browser, Path]) -> None:
    browser, path = shown
    browser.open(path)
    assert NAME in browser.texts("#about")[0]
    assert "Not calibrated" in browser.texts("#how")[0]
    assert "within about 20 m count" in browser.texts("#how")[0]
    assert [address for address in browser.requests if not address.startswith("data:")] == [
        path.as_uri()
    ]
    assert browser.errors == []
    assert MARK in path.read_bytes()[:4096]


@pytest.mark.parametrize(("width", "dark"), [(390, False), (1280, True)])
def test_the_page_fits_its_window(shown: tuple[Browser, Path], width: int, dark: bool) -> None:
    browser, path = shown
    browser.open(path, width=width, dark=dark)
    browser.settle()
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.errors == []


def test_the_picture_has_a_panel_for_each_season(tmp_path: Path, ground: np.ndarray) -> None:
    draw(report(), ground, 160.0, tmp_path / "forecast.png")
    picture = read_rgb(tmp_path / "forecast.png")
    assert picture.shape[1] > 1.6 * picture.shape[0]
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200
