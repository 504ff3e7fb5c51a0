"""Grid, corridor, street and free flights, and how configurations state them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.flight.clearance import check_flight, is_free
from simulate.flight.config import CorridorFlight, FreeFlight
from simulate.flight.context import FlightContext
from simulate.flight.gimbal import camera_centres
from simulate.flight.routes import corridor_aims, free_aims, offset_line
from simulate.place.town import TOWN
from simulate.place.world import World
from simulate.planner import plan_session
from tests.simulate.test_flights import CAMERA, assert_rigid, hills, level, nadir, pinhole

Array = NDArray[np.float64]
AREA = 160.0
BENT = np.array([[-80.0, -40.0], [-10.0, -30.0], [20.0, 30.0], [75.0, 35.0]])
KINDS = ["nadir", "grid", "oblique", "corridor", "free", "street"]


@pytest.fixture(scope="module")
def town() -> World:
    return TOWN.build(7, AREA)


def configure(flight: object, role: str = "map", **fields: Any) -> SimulateConfig:
    session = {"condition": "summer-noon", "flight": flight, "role": role}
    count = fields.pop("session_frames", None)
    sessions = [session | {"frames": count}, {"condition": "summer-noon", "flight": "nadir"}]
    sessions[1]["role"] = "map"
    fields = {"area": AREA, "seed": 7, "frames": 12, "sessions": sessions} | fields
    return SimulateConfig.load(None, fields)


def fly(world: World, flight: object, role: str = "map", **fields: Any) -> Array:
    config = configure(flight, role, **fields)
    rng = np.random.default_rng([config.seed, 0])
    return plan_session(config.sessions[0], config, config.photo_camera(), world, rng)


def fly_without_wind(world: World, flight: object, role: str = "map", **fields: Any) -> Array:
    return fly(world, flight, role, position_jitter_m=0, attitude_jitter_deg=0, **fields)


def distance(points: Array, line: Array) -> Array:
    """Distance of (N, 2) points from a (K, 2) line."""
    a, step = line[:-1], np.diff(line, axis=0)
    share = ((points[:, None] - a) * step).sum(-1) / (step**2).sum(-1)
    foot = a + np.clip(share, 0, 1)[..., None] * step
    return np.asarray(np.linalg.norm(points[:, None] - foot, axis=-1).min(1))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("role", ["map", "query"])
def test_one_word_is_a_flight(town: World, kind: str, role: str) -> None:
    poses = fly(town, kind, role)
    assert poses.shape == (12, 4, 4)
    assert_rigid(poses)
    config = configure(kind, role)
    check_flight("s", poses, config.photo_camera(), town)
    assert config.session_names()[0] == f"summer-noon-{kind}-{role}"


@pytest.mark.parametrize("kind", ["nadir", "grid", "oblique", "corridor", "street"])
def test_map_and_query_fly_differently(town: World, kind: str) -> None:
    mapped, query = fly_without_wind(town, kind, "map"), fly_without_wind(town, kind, "query")
    gaps = np.linalg.norm(camera_centres(mapped)[:, None] - camera_centres(query), axis=-1)
    assert np.median(gaps.min(0)) > 2


@pytest.mark.parametrize("kind", [*KINDS, {"kind": "free", "pitch_deg": [-80, -50]}])
def test_seed_zero_is_a_seed(town: World, kind: object) -> None:
    fields = {"attitude_jitter_deg": 1.5}
    zero, again, one = (fly(town, kind, seed=seed, **fields) for seed in (0, 0, 1))
    assert np.array_equal(zero, again)
    if kind != "street":  # a road has no wind
        assert not np.array_equal(zero, one)


@given(gsd=st.floats(5, 25), fov=st.floats(20, 100), size=st.integers(64, 2000))
def test_gsd_is_what_was_asked(town: World, gsd: float, fov: float, size: int) -> None:
    flight = {"kind": "nadir", "gsd_cm": gsd}
    poses = fly_without_wind(town, flight, fov_deg=fov, size=size)
    focal = configure(flight, fov_deg=fov, size=size).photo_camera().focal[0]
    x, y, z = camera_centres(poses).T
    assert_allclose(100 * (z - town.terrain.height(x, y)) / focal, gsd, rtol=1e-9)


@pytest.mark.parametrize("kind", ["nadir", "grid", "corridor"])
def test_without_terrain_following_flights_are_level(town: World, kind: str) -> None:
    flight = {"kind": kind, "altitude_m": 60}
    x, y, z = camera_centres(fly_without_wind(town, flight)).T
    assert_allclose(z - town.terrain.height(x, y), 60, atol=1e-9)
    assert (
        np.ptp(camera_centres(fly_without_wind(town, flight | {"terrain_following": False}))[:, 2])
        < 1e-9
    )


@given(forward=st.floats(0.3, 0.85), altitude=st.floats(40, 120))
def test_overlap_counts_the_photographs(town: World, forward: float, altitude: float) -> None:
    flight = {"kind": "nadir", "forward_overlap": forward, "altitude_m": altitude}
    xy = camera_centres(fly_without_wind(town, flight))[:, :2]
    side_m = 2 * altitude * np.tan(np.radians(30))
    for line in np.unique(xy[:, 0].round(6)):
        steps = np.diff(np.sort(xy[np.abs(xy[:, 0] - line) < 1e-5, 1]))
        assert steps.max() <= (1 - forward) * side_m + 1e-6
        assert steps.max() > 0.4 * (1 - forward) * side_m  # and not many more than needed


@given(heading=st.floats(-180, 180), frames=st.integers(2, 60))
def test_grid_is_perpendicular(town: World, heading: float, frames: int) -> None:
    flight = {"kind": "grid", "heading_deg": heading, "pitch_deg": -75}
    poses = fly_without_wind(town, flight, frames=frames)
    assert len(poses) == frames
    first, second = np.split(poses, [(frames + 1) // 2])
    assert_allclose(first[:, 0, :3] @ second[:, 0, :3].T, 0, atol=1e-9)
    assert_allclose(np.degrees(np.arcsin(poses[:, 2, 2])), -75, atol=1e-6)


@given(
    width=st.floats(1, 120),
    lines=st.one_of(st.none(), st.integers(1, 6)),
    frames=st.one_of(st.none(), st.integers(1, 40)),
    altitude=st.floats(20, 80),
)
def test_corridor_stays_in_its_width(
    width: float, lines: int | None, frames: int | None, altitude: float
) -> None:
    flight = CorridorFlight(
        line=tuple((x, y) for x, y in BENT.tolist()),
        altitude_m=altitude,
        width_m=width,
        lines=lines,
        forward_overlap=0.7,
        side_overlap=0.6,
    )
    context = FlightContext(AREA, hills, pinhole(1150, 900, 1000.0))
    aims = corridor_aims(flight, context, frames)
    x, y, z = aims.centres.T
    assert frames is None or len(x) == frames
    assert distance(aims.centres[:, :2], BENT).max() <= 0.5 * width + 1e-9
    assert_allclose(z - hills(x, y), altitude, atol=1e-9)


def test_corridor_overlaps_as_asked() -> None:
    flight = CorridorFlight(
        line=((-50.0, 0.0), (70.0, 0.0)),
        altitude_m=50,
        width_m=100,
        forward_overlap=0.8,
        side_overlap=0.5,
    )
    context = FlightContext(AREA, level, pinhole(800, 600, 1000.0))
    assert context.footprint_m(50) == (40, 30)
    aims = corridor_aims(flight, context, None)
    lines = np.unique(aims.centres[:, 1].round(6))
    assert len(lines) > 2
    assert np.diff(lines).max() <= 0.5 * 40
    assert lines.max() + 20 >= 50, "the strip's edge is photographed"
    for line in lines:
        on_line = np.abs(aims.centres[:, 1] - line) < 1e-5
        x = aims.centres[on_line, 0]
        assert np.abs(np.diff(x)).max() <= 0.2 * 30 + 1e-9
        assert (x.min(), x.max()) == (-50, 70)
        assert_allclose(np.sin(aims.heading[on_line]), np.sign(x[-1] - x[0]), atol=1e-12)


def test_routes_that_turn_back_or_lead_nowhere_are_refused() -> None:
    at = np.zeros(1)
    with pytest.raises(InputError, match=r"turns by more than 150 degrees at \(10, 0\)"):
        offset_line(np.array([[0.0, 0], [10, 0], [0, 1]]), at, 0.0)
    with pytest.raises(InputError, match="two different points"):
        offset_line(np.array([[3.0, 3], [3, 3]]), at, 0.0)


@given(seed=st.integers(0, 10_000), frames=st.integers(1, 100))
def test_free_flight_stays_in_its_ranges_and_is_smooth(seed: int, frames: int) -> None:
    flight = FreeFlight(altitude_m=(40, 90), pitch_deg=(-85, -50))
    context = FlightContext(200.0, hills, pinhole(**CAMERA))
    aims = free_aims(flight, context, frames, np.random.default_rng(seed))
    x, y, z = aims.centres.T
    assert np.abs(aims.centres[:, :2]).max() <= 100
    agl = z - hills(x, y)
    assert agl.min() >= 40
    assert agl.max() <= 90
    assert np.degrees(aims.pitch.min()) >= -85
    assert np.degrees(aims.pitch.max()) <= -50
    # No jump: the course is a sum of slow waves.
    steps = np.linalg.norm(np.diff(aims.centres[:, :2], axis=0), axis=1)
    assert steps.max(initial=0) <= 2 * np.pi * 4 * 90 * np.sqrt(2) / frames


def test_street_keeps_to_the_right_and_looks_to_both_sides(town: World) -> None:
    poses = fly_without_wind(town, "street", frames=60)
    centres = camera_centres(poses)
    assert_allclose(centres[::2], centres[1::2], atol=1e-9)
    assert_allclose(centres[:, 2] - town.terrain.height(*centres[:, :2].T), 1.7, atol=1e-9)
    assert_allclose(poses[:, 2, 2], 0, atol=1e-12)
    assert_allclose((poses[::2, 2, :3] * poses[1::2, 2, :3]).sum(1), 0, atol=1e-9)
    assert is_free(centres, town).all()
    assert np.abs(centres[:, :2]).max() <= 0.5 * AREA
    for k in range(0, 60, 2):
        ahead = poses[k, 2, :2] + poses[k + 1, 2, :2]
        ahead /= np.linalg.norm(ahead)
        offsets = []
        for road in town.roads:
            along = np.diff(road.line, axis=0)
            foot = road.line[:-1] + 0.5 * along
            nearest = np.linalg.norm(foot - centres[k, :2], axis=1).argmin()
            direction = along[nearest] / np.linalg.norm(along[nearest])
            to_camera = centres[k, :2] - foot[nearest]
            right = direction[1] * to_camera[0] - direction[0] * to_camera[1]
            offsets.append((abs(right - 0.25 * road.width_m), float(direction @ ahead)))
        off, cosine = min(offsets)
        assert off < 0.3
        assert cosine > 0.97


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        ({"kind": "nadir", "altitude_m": 0}, "altitude_m"),
        ({"kind": "nadir", "altitude_m": float("inf")}, "altitude_m"),
        ({"kind": "nadir", "gsd_cm": -1}, "gsd_cm"),
        ({"kind": "nadir", "gsd_cm": 4, "altitude_m": 50}, "not both"),
        ({"kind": "nadir", "forward_overlap": 1}, "forward_overlap"),
        ({"kind": "grid", "side_overlap": 1.5}, "side_overlap"),
        ({"kind": "corridor", "line": [[0, 0]]}, "at least 2 items"),
        ({"kind": "free", "altitude_m": [90, 40]}, "minimum, then maximum"),
        ({"kind": "orbit"}, "orbit"),
        ({"kind": "nadir", "height": 3}, "unknown key"),
        ("barrel-roll", "barrel-roll"),
    ],
)
def test_impossible_numbers_are_one_line(flight: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        configure(flight)
    assert "\n" not in str(caught.value)


def test_a_flight_that_counts_itself_takes_no_frames() -> None:
    with pytest.raises(InputError, match="leave frames out"):
        configure({"kind": "nadir", "side_overlap": 0.5}, session_frames=3)


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        ({"kind": "oblique", "altitude_m": 4, "radius_m": 40}, "in or under (building|tree)"),
        ({"kind": "oblique", "centre": [5000, 0]}, "does not show the place"),
        ({"kind": "oblique", "pitch_deg": 50}, "does not show the place"),
        ({"kind": "corridor", "line": [[900, 0], [900, 90]]}, "does not show the place"),
        ({"kind": "nadir", "altitude_m": 0.1}, "below the minimum clearance"),
    ],
)
def test_impossible_flights_leave_nothing_behind(
    town: World, tmp_path: Path, flight: object, message: str
) -> None:
    out = tmp_path / "scene"
    still_air = {"position_jitter_m": 0, "attitude_jitter_deg": 0}
    with pytest.raises(InputError, match=f"session summer-noon-.*{message}") as caught:
        simulate(configure(flight, frames=40, **still_air), out)
    assert "\n" not in str(caught.value)
    assert not out.exists(), "nothing is written for a flight that cannot be flown"


def test_a_flight_of_millions_is_refused() -> None:
    with pytest.raises(InputError, match="more than 20000 photographs"):
        nadir(600.0, level, altitude_m=1.0, forward_overlap=0.95, side_overlap=0.95)
