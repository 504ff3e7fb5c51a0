"""Courses of flights: shared by all presets of a seed, or drawn for each preset."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.datasets.courses import find_courses
from benchmark.tracks.description import TRACKS_FOLDER, load_track
from benchmark.tracks.renders import read_render, render_path
from simulate.command import _dump
from simulate.config import SimulateConfig
from simulate.flight.gimbal import camera_centres
from simulate.place.world import Ground, Heightfield, World
from simulate.planner import plan_session, session_generator

Array = NDArray[np.float64]
FEATURELESS = np.zeros((2, 2), np.uint8)


def make_plain(side_m: float) -> World:
    """A plain without roads and objects: the ground of a place moves its courses up and down."""
    ground = Ground(side_m / 2, FEATURELESS, FEATURELESS, ())
    return World(0, side_m, Heightfield(np.zeros((2, 2)), side_m), (), ground, ())


def fly(config: SimulateConfig) -> Iterator[tuple[str, Array]]:
    """The name and the camera centres (N, 3) of each query flight."""
    world = make_plain(config.area)
    for index, (name, session) in enumerate(
        zip(config.session_names(), config.sessions, strict=True)
    ):
        if session.role == "query":
            rng = session_generator(config, index)
            camera = config.photo_camera(session)
            yield name, camera_centres(plan_session(session, config, camera, world, rng))


def fly_track(name: str, **given: str) -> dict[str, dict[str, Array]]:
    """The query flights of each place of a track, by name."""
    track = load_track(name)
    return {
        place.dataset: dict(
            fly(
                SimulateConfig.load(
                    Path(track.config), {"preset": place.preset, "seed": place.seed, **given}
                )
            )
        )
        for place in track.places
    }


def centre_flights(flights: dict[str, Array]) -> Array:
    """Offsets (N, 2) of the cameras of all flights from the middle of each flight, metres."""
    return np.concatenate([c[:, :2] - c[:, :2].mean(0) for c in flights.values()])


def measure_similarity(places: dict[str, dict[str, Array]]) -> tuple[float, float]:
    """How alike the courses of any two places are.

    Returns:
        The largest correlation of the offsets of same-named cameras of two places, and the least
        median distance (m) of the cameras of two same-named flights.
    """
    correlations, distances = [], []
    for one, other in combinations(places.values(), 2):
        a, b = centre_flights(one), centre_flights(other)
        correlations.append((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))
        for name in one:
            apart = np.linalg.norm((one[name] - other[name])[:, :2], axis=1)
            distances.append(float(np.median(apart)))
    return float(max(correlations)), min(distances)


def test_no_two_places_of_a_new_track_have_correlated_courses() -> None:
    places = fly_track("uav-surprise")
    assert len(places) == 42
    most, nearest = measure_similarity(places)
    assert most < 0.5
    assert nearest > 20
    flights = {f"{place}/{n}": c for place, of in places.items() for n, c in of.items()}
    assert len(set(find_courses(flights).values())) == len(flights) == 42 * 12


def test_shared_courses_are_found_out() -> None:
    """The same measures on the same track, drawn by seed and session alone."""
    places = fly_track("uav-surprise", courses="shared")
    most, nearest = measure_similarity(places)
    assert most == pytest.approx(1)
    assert nearest == pytest.approx(0, abs=1e-9)
    flights = {f"{place}/{n}": c for place, of in places.items() for n, c in of.items()}
    # Six seeds.
    assert len(set(find_courses(flights).values())) == 6 * 12


def test_the_stored_track_flies_as_recorded() -> None:
    """Horizontal positions of the record, which the ground does not change, to a micrometre."""
    flown = fly_track("uav-seasons")
    for dataset in ("town-1", "farmland-2"):
        render = read_render(render_path(TRACKS_FOLDER / "uav-seasons", dataset))
        poses = {
            frame.name: np.array(frame.cam_from_world).reshape(3, 4) for frame in render.frames
        }
        for session, centres in flown[dataset].items():
            recorded = [poses[f"{session}/images/{k:06d}.jpg"] for k in range(len(centres))]
            there = np.array([-pose[:, :3].T @ pose[:, 3] for pose in recorded])
            assert np.abs(centres - there)[:, :2].max() < 2e-4


def test_manifests_of_shared_courses_say_nothing_new() -> None:
    """Digests of stored scenes hold their configuration."""
    shared, own = (SimulateConfig.load(None, {"courses": kind}) for kind in ("shared", "own"))
    assert not {"courses", "change_share"} & set(_dump(shared))
    assert _dump(own)["courses"] == "own"
    assert _dump(SimulateConfig.load(None, {"change_share": 0.5}))["change_share"] == 0.5
    assert shared == SimulateConfig.load(None, {})


@pytest.mark.parametrize("flight", ["nadir", "grid", "oblique"])
def test_surveys_and_orbits_differ_too(flight: str) -> None:
    sessions = [
        {"condition": "summer-noon", "flight": flight, "role": role, "name": role}
        for role in ("map", "query")
    ]
    flown = {
        preset: dict(fly(SimulateConfig.load(None, given | {"preset": preset})))
        for preset in ("town", "park", "suburb")
        for given in [{"courses": "own", "sessions": sessions}]
    }
    most, nearest = measure_similarity(flown)
    assert most < 0.9
    assert nearest > 20
    again = dict(
        fly(SimulateConfig.load(None, {"preset": "park", "courses": "own", "sessions": sessions}))
    )
    assert (again["query"] == flown["park"]["query"]).all()


def test_what_a_flight_states_is_kept() -> None:
    """Own courses draw the defaults of a role alone."""
    flight = {"kind": "nadir", "altitude_m": 50, "heading_deg": 10}
    sessions = [
        {"condition": "summer-noon", "flight": flight, "role": role, "name": role}
        for role in ("map", "query")
    ]
    calm = {"position_jitter_m": 0, "attitude_jitter_deg": 0, "sessions": sessions}
    own, shared = (
        dict(fly(SimulateConfig.load(None, calm | {"courses": kind})))["query"]
        for kind in ("own", "shared")
    )
    assert np.allclose(own, shared)
    assert np.allclose(own[:, 2], 50)


def list_changes(config: SimulateConfig) -> list[bool]:
    return [session.change.cars_moved > 0 for session in config.drawn_sessions()]


def test_objects_move_apart_from_the_season() -> None:
    """Each condition of the track is shown with and without moved objects, about half each."""
    track = load_track("uav-surprise")
    drawn: dict[str, list[bool]] = {}
    for place in track.places:
        given = {"preset": place.preset, "seed": place.seed}
        config = SimulateConfig.load(Path(track.config), given)
        for session, moved in zip(config.sessions, list_changes(config), strict=True):
            if session.role == "query":
                drawn.setdefault(session.condition, []).append(moved)
        assert list_changes(config) == list_changes(config)
        # Leaves fall with the season.
        bare = [s.world_change.bare_trees for s in config.drawn_sessions()]
        assert bare == ["leafoff" in s.condition for s in config.sessions]
    assert len(drawn) == 12
    for moved in drawn.values():
        assert 12 <= sum(moved) <= 30
    assert 217 <= sum(sum(moved) for moved in drawn.values()) <= 287


def test_all_changes_happen_by_default() -> None:
    config = SimulateConfig.load(Path("uav-seasons"), {"seed": 3})
    assert config.drawn_sessions() == config.sessions
    none = SimulateConfig.load(Path("uav-seasons"), {"seed": 3, "change_share": 0})
    assert not any(list_changes(none))
    assert any(list_changes(config))
