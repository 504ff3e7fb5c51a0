"""Surveys and orbits: poses, spacing, overlap, wind and impossible flights."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from simulate.flight.config import NadirFlight, ObliqueFlight
from simulate.flight.context import FlightContext, Wind
from simulate.flight.flights import plan_nadir, plan_oblique
from simulate.flight.gimbal import camera_centres

CAMERA = {"width": 512, "height": 384, "focal": 443.0}


def hills(x, y):
    return 3.0 * np.sin(0.02 * np.asarray(x)) + 2.0 * np.cos(0.03 * np.asarray(y))


def level(x, y):
    return 0.0 * np.asarray(x)


def pinhole(width: int, height: int, focal: float) -> Camera:
    return Camera("PINHOLE", width, height, (focal, focal, 0.5 * width, 0.5 * height))


def nadir(
    area=200.0,
    ground=hills,
    seed=0,
    frames=None,
    alternate=True,
    position_jitter_m=0.0,
    attitude_jitter_deg=0.0,
    **numbers,
):
    flight = load_config(NadirFlight, None, {"altitude_m": 60.0, **numbers})
    wind = Wind(position_jitter_m, attitude_jitter_deg)
    context = FlightContext(area, ground, pinhole(**CAMERA), wind=wind)
    return plan_nadir(flight, context, frames, np.random.default_rng(seed), alternate=alternate)


def assert_rigid(poses):
    rotation = poses[:, :3, :3]
    eye = np.broadcast_to(np.eye(3), rotation.shape)
    assert_allclose(rotation @ rotation.transpose(0, 2, 1), eye, atol=1e-12)
    assert_allclose(np.linalg.det(rotation), 1, atol=1e-12)
    assert_allclose(poses[:, 3], np.broadcast_to([0, 0, 0, 1.0], (len(poses), 4)))


@settings(max_examples=40, deadline=None)
@given(
    area=st.floats(100, 600),
    frames=st.integers(1, 200),
    heading=st.floats(-360, 360),
    pitch=st.floats(-90, -20),
    jitter=st.floats(0, 5),
    seed=st.integers(0, 1000),
)
def test_nadir_gives_the_frames_asked_for_as_rigid_poses(
    area, frames, heading, pitch, jitter, seed
):
    options = {"position_jitter_m": jitter, "attitude_jitter_deg": jitter}
    poses = nadir(area, frames=frames, heading_deg=heading, pitch_deg=pitch, seed=seed, **options)
    assert poses.shape == (frames, 4, 4)
    assert poses.dtype == np.float64
    assert_rigid(poses)


@settings(max_examples=30, deadline=None)
@given(altitude=st.floats(20, 120), heading=st.floats(0, 360), frames=st.integers(1, 60))
def test_nadir_looks_down_from_the_altitude_asked_for(altitude, heading, frames):
    poses = nadir(altitude_m=altitude, heading_deg=heading, frames=frames)
    x, y, z = camera_centres(poses).T
    assert_allclose(z - hills(x, y), altitude, atol=1e-9)
    assert_allclose(poses[:, 2, :3], np.broadcast_to([0, 0, -1.0], (frames, 3)), atol=1e-12)
    assert np.abs([x, y]).max() <= 100


@settings(max_examples=30, deadline=None)
@given(
    forward=st.floats(0.2, 0.85),
    side=st.floats(0.2, 0.85),
    heading=st.floats(0, 360),
    altitude=st.floats(30, 90),
)
def test_nadir_overlap_is_at_least_what_was_asked(forward, side, heading, altitude):
    options = {"forward_overlap": forward, "side_overlap": side, "altitude_m": altitude}
    poses = nadir(ground=level, heading_deg=heading, **options)
    xy = camera_centres(poses)[:, :2]
    angle = np.radians(heading)
    along = xy @ [np.sin(angle), np.cos(angle)]
    across = xy @ [np.cos(angle), -np.sin(angle)]
    height_m = CAMERA["height"] * altitude / CAMERA["focal"]
    width_m = CAMERA["width"] * altitude / CAMERA["focal"]
    lines = np.unique(across.round(6))
    if len(lines) > 1:
        assert np.diff(lines).max() <= (1 - side) * width_m + 1e-6
    for line in lines:
        steps = np.diff(np.sort(along[np.abs(across - line) < 1e-5]))
        assert steps.max(initial=0) <= (1 - forward) * height_m + 1e-6


@pytest.mark.parametrize("heading", [0.0, 30.0, 45.0, 90.0])
@pytest.mark.parametrize(("frames", "share"), [(None, 0.999), (40, 0.97)])
def test_nadir_footprints_cover_the_area(heading, frames, share):
    poses = nadir(180.0, level, heading_deg=heading, frames=frames)
    axis = np.linspace(-89, 89, 60)
    points = np.stack([*np.meshgrid(axis, axis), np.zeros((60, 60))], -1).reshape(-1, 3)
    seen = np.zeros(len(points), bool)
    for pose in poses:
        local = points @ pose[:3, :3].T + pose[:3, 3]
        uv = CAMERA["focal"] * local[:, :2] / local[:, 2:]
        seen |= (np.abs(uv) <= [0.5 * CAMERA["width"], 0.5 * CAMERA["height"]]).all(1)
    assert seen.mean() > share


def test_frames_are_spaced_evenly():
    poses = nadir(240.0, level, frames=36)
    xy = camera_centres(poses)[:, :2]
    gaps = np.linalg.norm(xy[:, None] - xy, axis=-1) + 1e9 * np.eye(36)
    nearest = gaps.min(1)
    assert nearest.max() < 1.5 * nearest.min()


def test_every_second_line_is_flown_back():
    there = nadir(alternate=True, ground=level)
    x = camera_centres(there)[:, 0].round(6)
    first, second = np.unique(x)[:2]
    for line, sign in ((first, 1), (second, -1)):
        on_line = x == line
        assert_allclose(there[on_line][:, 1, :3], [[0, -sign, 0]] * on_line.sum(), atol=1e-12)
        north = camera_centres(there[on_line])[:, 1]
        assert (sign * np.diff(north) > 0).all()
    same = nadir(alternate=False, ground=level)
    assert_allclose(same[:, :3, :3], np.broadcast_to(same[0, :3, :3], (len(same), 3, 3)))


def test_heading_is_clockwise_from_north():
    east = nadir(heading_deg=90.0, frames=1)
    assert_allclose(-east[0, 1, :3], [1, 0, 0], atol=1e-12)  # the top of the image points east


def test_jitter_comes_from_the_generator():
    options = {"position_jitter_m": 1.0, "attitude_jitter_deg": 2.0, "frames": 20}
    assert np.array_equal(nadir(seed=1, **options), nadir(seed=1, **options))
    assert not np.array_equal(nadir(seed=1, **options), nadir(seed=2, **options))
    off = np.degrees(np.arccos(np.clip(-nadir(seed=1, **options)[:, 2, 2], -1, 1)))
    assert 0.5 < off.mean() < 6


@settings(max_examples=30, deadline=None)
@given(
    radius=st.floats(20, 150),
    altitude=st.floats(20, 100),
    pitch=st.floats(-80, -20),
    frames=st.integers(1, 50),
    start=st.floats(0, 360),
)
def test_oblique_orbits_and_looks_inwards(radius, altitude, pitch, frames, start):
    flight = ObliqueFlight(
        radius_m=radius,
        altitude_m=altitude,
        pitch_deg=pitch,
        centre=(10.0, -5.0),
        start_deg=start,
    )
    context = FlightContext(200.0, hills, pinhole(**CAMERA))
    poses = plan_oblique(flight, context, frames, np.random.default_rng(0))
    assert poses.shape == (frames, 4, 4)
    assert_rigid(poses)
    offset = camera_centres(poses) - [10.0, -5.0, hills(10.0, -5.0)]
    assert_allclose(np.linalg.norm(offset[:, :2], axis=1), radius, rtol=1e-9)
    assert_allclose(offset[:, 2], altitude, rtol=1e-9)
    forward = poses[:, 2, :3]
    assert_allclose(np.degrees(np.arcsin(forward[:, 2])), pitch, atol=1e-6)
    inwards = -offset[:, :2] / radius
    assert_allclose((forward[:, :2] * inwards).sum(1), np.cos(np.radians(pitch)), rtol=1e-9)
    assert_allclose(poses[:, 0, 2], 0, atol=1e-12)  # the horizon is level


@pytest.mark.parametrize(
    "options",
    [{"altitude_m": 0.0}, {"frames": 0}, {"forward_overlap": 1.0}, {"side_overlap": -0.1}],
)
def test_impossible_flights_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        nadir(**options)
