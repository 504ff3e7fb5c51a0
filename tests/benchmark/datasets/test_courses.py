from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.datasets.courses import SAME_COURSE_M, find_courses
from benchmark.datasets.open import open_datasets
from benchmark.tracks.courses import track_courses
from benchmark.tracks.description import TRACKS_FOLDER, load_track
from tests.benchmark.made_data import write_scene


def fly(seed: int, count: int = 30) -> NDArray[np.float64]:
    """Camera centres over 200 m x 200 m."""
    return np.random.default_rng(seed).uniform(-100, 100, (count, 3))


def test_flights_along_one_path_are_on_one_course() -> None:
    course = fly(1)
    wind = np.random.default_rng(2).normal(0, 0.7, course.shape)
    flights = {
        "summer": course,
        "random": fly(3),
        "winter": course + wind,
        "higher": course + np.array([0, 0, 40]),
        "aside": course + np.array([SAME_COURSE_M + 0.1, 0, 0]),
        "fewer": course[:-1],
    }
    found = find_courses(flights)
    assert found == {
        "summer": "summer",
        "random": "random",
        "winter": "summer",
        "higher": "summer",
        "aside": "aside",
        "fewer": "fewer",
    }


def test_a_third_flight_joins_two() -> None:
    course = fly(1)
    flights = {name: course + np.array([9.0 * k, 0, 0]) for k, name in enumerate("acb")}
    assert set(find_courses(flights).values()) == {"a"}
    del flights["c"]
    assert find_courses(flights) == {"a": "a", "b": "b"}


def test_a_data_set_knows_its_courses(tmp_path: Path) -> None:
    """Both flights of the made scene have the same poses."""
    (dataset,) = open_datasets(write_scene(tmp_path / "hamlet"))
    assert len({query.group for query in dataset.queries}) == 2
    assert len(set(dataset.courses.values())) == 1


@pytest.mark.parametrize(
    ("name", "flights", "courses"), [("uav-seasons", 90, 17), ("street-seasons", 36, 6)]
)
def test_stored_tracks_share_courses(name: str, flights: int, courses: int) -> None:
    """Aircraft: eight query flights of two seeds, one map. Streets: map and queries of three."""
    found = track_courses(TRACKS_FOLDER / name, load_track(name))
    assert len(found) == flights
    assert len(set(found.values())) == courses
    if name == "uav-seasons":
        assert all(
            (found[f"town-{seed}/snow"] == found[f"{place}-{seed}/snow"])
            for seed in (1, 2)
            for place in ("suburb", "park", "farmland", "industrial")
        )
