"""Photographs of cameras with distortion: all layers stay aligned, and depth stays exact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from objconnect.scene.checks.depth_check import DepthFrames, check_depth
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from simulate.camera.lens import PRESETS, cover_by_pinhole
from simulate.camera.resample import resample
from simulate.config import SimulateConfig
from simulate.flight.config import NadirFlight, ObliqueFlight
from simulate.flight.context import FlightContext, Wind
from simulate.flight.flights import plan_nadir, plan_oblique
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import render
from tests.objconnect.scene.made_cameras import CAMERAS
from tests.simulate.blender_checks import check_rays, dot_errors
from tests.simulate.ground_error import ground_error
from tests.simulate.test_flights import pinhole as made_pinhole
from tests.simulate.towns import cached_town

SEED, AREA = 5, 120.0
# Off-centre, not square, and with unequal focal lengths, so that a mistaken axis shows.
LENSES = {
    "opencv": Camera("OPENCV", 128, 96, (100, 102, 61.5, 50.25, -0.1, 0.02, 1e-3, -2e-3)),
    "fisheye": Camera("OPENCV_FISHEYE", 128, 96, (70, 71, 62, 47, 0.05, -0.01, 2e-3, -5e-4)),
}


def rays_of(camera: Camera) -> np.ndarray:
    """Rays (H, W, 3) with z = 1 through the pixels' centres."""
    return camera.unproject(camera.pixel_grid())[0].numpy()


@pytest.mark.parametrize("name", LENSES)
def test_depth_is_exact_at_edges_and_on_planes(name: str) -> None:
    """A box on a tilted ground, of which the truth is known at every pixel."""
    camera = LENSES[name]
    pinhole, distorted_camera = cover_by_pinhole(camera)
    assert distorted_camera is not None

    def ground(rays: np.ndarray) -> np.ndarray:
        return 60 / (1 + 0.3 * rays[..., 0] - 0.2 * rays[..., 1])

    def box(rays: np.ndarray) -> np.ndarray:
        """Its top and one side; infinite beside it."""
        x, y = rays[..., 0], rays[..., 1]
        inside = (x > -0.31) & (x < 0.17) & (y > -0.23) & (y < 0.21)
        return np.where(inside, np.where(x < 0.1, 40.0, 40 / (1 + 6 * (x - 0.1))), np.inf)

    def surface(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high = ground(rays), box(rays)
        return np.minimum(low, high), np.where(high < low, 7, 0)

    v, u = np.mgrid[: pinhole.height, : pinhole.width] + 0.5
    source = np.stack([(u - pinhole.cx) / pinhole.f, (v - pinhole.cy) / pinhole.f], -1)
    depth, instance = surface(source)
    layers = {
        "rgb": np.zeros((*depth.shape, 3), np.uint8),
        "depth": depth.astype(np.float32),
        "instance": instance.astype(np.uint16),
        "normal": np.repeat(instance[..., None], 3, -1).astype(np.int8),
    }
    rays = rays_of(camera)[..., :2]
    xy = pinhole.f * rays + [pinhole.cx, pinhole.cy]
    asked = []

    def cast(number: int, rays: np.ndarray) -> np.ndarray:
        asked.append(len(rays))
        return box(rays) if number == 7 else ground(rays)

    out = resample(layers, xy, rays, cast, {})
    truth, objects = surface(rays)
    assert np.array_equal(out["instance"], objects)
    assert np.array_equal(out["normal"][..., 0], objects)
    error = np.abs(out["depth"] - truth)
    assert np.median(error) < 1e-4
    assert error.max() < 1e-3
    assert sum(asked) < 0.4 * error.size


def test_colours_are_taken_from_where_they_are() -> None:
    """A smooth pattern, sampled at fractions of a pixel."""

    def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 128 + 60 * np.sin(0.5 * x) + 60 * np.cos(0.4 * y)

    v, u = np.mgrid[:60, :80] + 0.5
    layers = {
        "rgb": np.rint(np.repeat(pattern(u, v)[..., None], 3, -1)).astype(np.uint8),
        "depth": np.full((60, 80), 10, np.float32),
        "instance": np.zeros((60, 80), np.uint16),
        "normal": np.zeros((60, 80, 3), np.int8),
    }
    xy = np.stack(np.meshgrid(np.linspace(4, 75, 50), np.linspace(4, 55, 40)), -1)
    out = resample(layers, xy, 0 * xy, lambda number, rays: np.zeros(len(rays)), {})
    assert np.abs(out["rgb"][..., 1] - pattern(xy[..., 0], xy[..., 1])).max() < 2


# Not the fisheye, of 160 degrees; one lens of each slow model is in the default part.
COVERED = [
    pytest.param(name, marks=pytest.mark.thorough)
    if name in ("full_opencv_polynomial", "opencv_tangential")
    else name
    for name in CAMERAS
    if name != "fisheye"
]


@pytest.mark.parametrize("name", COVERED)
def test_the_pinhole_covers_the_view_as_finely(name: str) -> None:
    camera = CAMERAS[name].resize(320, 240)
    pinhole, distorted_camera = cover_by_pinhole(camera)
    if camera.model == "SIMPLE_PINHOLE":
        assert distorted_camera is None
        assert (pinhole.width, pinhole.height) == (camera.width, camera.height)
        return
    assert distorted_camera is not None
    assert Camera.parse(distorted_camera.split()) == camera
    xy = pinhole.f * rays_of(camera)[..., :2] + [pinhole.cx, pinhole.cy]
    assert xy.min() >= 3.5
    assert (xy.max((0, 1)) <= [pinhole.width - 3.5, pinhole.height - 3.5]).all()
    assert np.linalg.norm(np.diff(xy, axis=1), axis=-1).min() > 0.999


# A fisheye bends most: the other lens is rendered in the thorough part.
LENS_NAMES = [
    name if name == "fisheye" else pytest.param(name, marks=pytest.mark.thorough) for name in LENSES
]


@pytest.fixture(scope="module", params=LENS_NAMES)
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    """A camera, its job, poses, and its frames."""
    camera = LENSES[request.param]
    town = cached_town(SEED, AREA)
    rng = np.random.default_rng(0)
    context = FlightContext(AREA, town.terrain.height, made_pinhole(128, 96, 90.0))
    windy = replace(context, wind=Wind(attitude_jitter_deg=3.0))
    down = plan_nadir(NadirFlight(altitude_m=50.0), windy, 6, rng)[2:4]
    oblique = plan_oblique(ObliqueFlight(radius_m=45.0, altitude_m=40.0), context, 12, rng)
    poses = np.concatenate([down, oblique[:2]])
    pinhole, distorted_camera = cover_by_pinhole(camera)
    job = RenderJob(
        seed=SEED, side_m=AREA, condition="summer-noon", camera=pinhole,
        distorted_camera=distorted_camera, samples=1,
        poses={i: pose.tolist() for i, pose in enumerate(poses)},
    )  # fmt: skip
    out: Path = tmp_path_factory.mktemp(request.param)
    render(job, out)
    frames = []
    for i in range(len(poses)):
        with np.load(frame_path(out, i)) as arrays:
            frames.append(dict(arrays))
    return camera, job, poses, frames


@pytest.mark.thorough
def test_depth_is_what_rays_through_the_lens_meet(flown, tmp_path: Path) -> None:
    _, job, _, frames = flown
    check_rays(job, frames, tmp_path)


# In the default part corners of a board are where they are projected (``test_shutter``).
@pytest.mark.thorough
@pytest.mark.parametrize(
    "camera",
    [
        pytest.param(Camera("PINHOLE", 128, 96, (100, 100, 61.5, 50.25)), id="pinhole"),
        pytest.param(Camera("PINHOLE", 128, 96, (100, 102, 61.5, 50.25)), id="resampled"),
        pytest.param(LENSES["opencv"], id="opencv"),
        pytest.param(LENSES["fisheye"], id="fisheye"),
    ],
)
def test_known_points_appear_where_they_are_projected(camera: Camera, tmp_path: Path) -> None:
    length = np.linalg.norm(dot_errors(camera, tmp_path), axis=-1)
    print(f"{len(length)} points: median {np.median(length):.4f} px, most {length.max():.4f} px")
    assert len(length) == 30
    assert length.max() < 0.02


def test_frames_agree_through_the_lens(flown) -> None:
    camera, _, poses, frames = flown
    check = check_depth(
        "lens",
        DepthFrames(
            [camera] * len(poses),
            poses,
            [f["depth"] for f in frames],
            [f["instance"] for f in frames],
        ),
    )
    assert check.ok, check.detail
    assert check.figures["median_px"] < 0.01


def test_ground_and_objects_are_where_they_stand(flown) -> None:
    camera, _, poses, frames = flown
    town = cached_town(SEED, AREA)
    by_id = {o.id: o for o in town.objects}
    for pose, arrays in zip(poses, frames, strict=True):
        assert {a.shape[:2] for a in arrays.values()} == {(96, 128)}
        local = rays_of(camera) * arrays["depth"][..., None]
        world = (local - pose[:3, 3]) @ pose[:3, :3]
        instance = arrays["instance"]
        x, y, z = world[(instance == 0) & (arrays["depth"] > 0)].T
        inside = np.maximum(np.abs(x), np.abs(y)) < 0.5 * AREA
        error = ground_error(town, x, y, z)[inside]
        assert np.median(error) < 0.002  # the triangulation of the terrain
        assert np.percentile(error, 99) < 0.02
        for number in set(np.unique(instance).tolist()) - {0}:
            item = by_id[number]
            seen = world[instance == number] - item.centre
            cos, sin = np.cos(item.yaw), np.sin(item.yaw)
            seen[:, :2] = seen[:, :2] @ np.array([[cos, -sin], [sin, cos]])
            foundation = 1.5 if item.class_name == "building" else 0.0
            assert (np.abs(seen[:, :2]) <= 0.5 * item.size[:2] + 0.03).all(), item
            assert (np.abs(seen[:, 2]) <= 0.5 * item.size[2] + foundation + 0.03).all(), item


def test_presets_are_drones_of_the_size_asked_for() -> None:
    for name, (width, height, fov_deg, _) in PRESETS.items():
        config = SimulateConfig.load(None, {"size": 640, "camera": {"preset": name}})
        camera = config.photo_camera()
        assert camera.width == 640
        assert camera.height == round(640 * height / width)
        corners = torch.tensor([[0.0, 0.0], [camera.width, camera.height]], dtype=torch.float64)
        if not any(camera.distortion):
            a, b = camera.unproject(corners)[0].numpy()
            angle = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
            assert_allclose(angle, fov_deg, atol=0.1)
    sized = SimulateConfig.load(None, {"camera": {"preset": "mini-2", "size": 96}})
    assert sized.photo_camera().width == 96
    assert SimulateConfig().photo_camera().params[2:] == (256.0, 256.0)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"preset": "kite"}, "unknown camera 'kite'; known: mini-2"),
        ({"preset": "mini-2", "width": 640}, "give a preset, or model"),
        ({"model": "PINHOLE", "width": 640}, "model, width, height and params"),
        ({"model": "OPENCV", "width": 64, "height": 48, "params": [50, 50]}, "takes 8 parameters"),
        (
            {"model": "SIMPLE_RADIAL", "width": 64, "height": 64, "params": [30, 32, 32, -0.5]},
            "not invertible",
        ),
        (
            {"model": "OPENCV_FISHEYE", "width": 64, "height": 64,
             "params": [32, 32, 32, 32, 0, 0, 0, 0]},
            "a field of view of 160 degrees, at most 140",
        ),
        ({"lens": "fish"}, "unknown key 'camera.lens'"),
    ],
)  # fmt: skip
def test_cameras_that_cannot_be_are_one_line(camera: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        SimulateConfig.load(None, {"camera": camera})
    assert "\n" not in str(caught.value)
