"""Rendered thermal pictures: beside equal photographs with equal truth, checked and resumed."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from objconnect.scene.bundle.frames import LAYERS
from objconnect.scene.bundle.manifest import Session
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.bundle.thermal import Thermal, counts_path, picture_path, write_thermal
from objconnect.scene.checks.validate import validate
from objconnect.scene.errors import InputError
from simulate.camera.resample import resample_values
from simulate.command import _dump, render_job, simulate
from simulate.config import SimulateConfig
from simulate.render.disk import estimate_bytes
from simulate.render.pool import render
from tests.blender import require_blender
from tests.simulate.blender_checks import check_rays

CONFIG = SimulateConfig.model_validate(
    {
        "seed": 5, "area": 120, "size": 96, "spp": 1, "thermal": True,
        "sessions": [
            {"condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 2},
            {"condition": "summer-night", "flight": "oblique", "role": "query", "frames": 1},
        ],
    }
)  # fmt: skip
WITHOUT = CONFIG.model_copy(update={"thermal": False})
RECORD = Thermal(kelvin_per_count=0.01, netd_k=0.05, air_c=20.0, low_c=10.0, high_c=60.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, NDArray[np.float32]]:
    """A scene with thermal pictures, interrupted before the first is written and resumed.

    Returns:
        The scene, and the radiance of its second frame, rendered by the process of the first.
    """
    require_blender()
    out = tmp_path_factory.mktemp("thermal") / "scene"
    with pytest.MonkeyPatch.context() as patch:

        def interrupt(*_: object) -> None:
            raise KeyboardInterrupt

        patch.setattr("simulate.command.write_thermal", interrupt)
        with pytest.raises(KeyboardInterrupt):
            simulate(CONFIG, out)
    (second,) = out.rglob("000001.npz")
    with np.load(second) as layers:
        radiance = layers["thermal"]
    assert not (out / "scene.json").exists()
    return simulate(CONFIG, out), radiance


@pytest.fixture(scope="module")
def thermal(made: tuple[Scene, NDArray[np.float32]]) -> Scene:
    return made[0]


@pytest.fixture
def broken(thermal: Scene, tmp_path: Path) -> Scene:
    """A copy of the scene to break."""
    return Scene.open(Path(shutil.copytree(thermal.path, tmp_path / "copy")))


def fault(scene: Scene) -> str:
    """Return what ``validate`` finds after the digests were made to match again."""
    finish_scene(scene.path, scene.manifest)
    (detail,) = (check.detail for check in validate(scene.path).checks if not check.ok)
    return detail


def test_photographs_and_truth_are_those_without_thermal(thermal: Scene, tmp_path: Path) -> None:
    """Bit for bit, and the manifest of a scene without thermal does not mention it."""
    plain = simulate(WITHOUT, tmp_path / "plain")
    expected = {k: v for k, v in thermal.manifest.sha256.items() if "/thermal" not in k}
    assert plain.manifest.sha256 == expected
    for name, digests in plain.manifest.pixels_sha256.items():
        assert set(digests) == {"image", *LAYERS}
        assert {**thermal.manifest.pixels_sha256[name], **digests} == (
            thermal.manifest.pixels_sha256[name]
        )
    assert "thermal" not in (plain.path / "scene.json").read_text()
    with pytest.raises(InputError, match="has no thermal pictures"):
        plain.thermal(plain.splits.map[0])


def test_depth_is_what_rays_meet(thermal: Scene, tmp_path: Path) -> None:
    session = "summer-noon-nadir-map"
    frames = thermal.frames(session)
    with thermal.layers(session) as layers:
        arrays = [
            {"depth": layers.read("depth", k), "instance": layers.read("instance", k)}
            for k in range(len(frames))
        ]
    job = render_job(CONFIG, CONFIG.sessions[0], frames.cam_from_world)
    check_rays(job, arrays, tmp_path)


def test_pictures_are_read_and_valid(thermal: Scene) -> None:
    report = validate(thermal.path)
    assert report.ok, report.text()
    assert sum("thermal pictures are whole" in check.name for check in report.checks) == 2
    for session in thermal.sessions:
        record = thermal.sessions[session].thermal
        assert record is not None
        for name in thermal.frames(session).names:
            kelvin = thermal.thermal(name)
            assert kelvin.shape == (96, 96)
            assert kelvin.dtype == np.float32
            assert 250 < kelvin.min() < record.air_c + 273.15 < kelvin.max() < 380
            assert kelvin.std() > 1
            assert "thermal" in thermal.manifest.pixels_sha256[name]
            grey = np.asarray(Image.open(picture_path(thermal.images_root, name)))
            assert grey.dtype == np.uint8
            assert grey.std() > 10


def test_a_render_is_repeated_bit_for_bit(
    made: tuple[Scene, NDArray[np.float32]], tmp_path: Path
) -> None:
    """The radiance does not depend on which frames a process rendered before."""
    scene, radiance = made
    poses = scene.frames("summer-noon-nadir-map").cam_from_world
    job = render_job(CONFIG, CONFIG.sessions[0], poses)
    alone = job.model_copy(update={"poses": {1: job.poses[1]}})
    render(alone, tmp_path)
    assert radiance.dtype == np.float32
    with np.load(tmp_path / "000001.npz") as layers:
        assert np.array_equal(layers["thermal"], radiance)


def test_a_missing_picture_is_found(broken: Scene) -> None:
    counts_path(broken.images_root, broken.splits.map[1]).unlink()
    assert "does not exist" in fault(broken)


def test_a_picture_of_another_size_is_found(broken: Scene) -> None:
    path = counts_path(broken.images_root, broken.splits.map[0])
    Image.open(path).crop((0, 0, 96, 95)).save(path)
    assert "is 96 x 95 pixels but its camera is 96 x 96" in fault(broken)


def test_a_picture_of_another_depth_is_found(broken: Scene) -> None:
    path = picture_path(broken.images_root, broken.splits.map[0])
    shutil.copyfile(counts_path(broken.images_root, broken.splits.map[0]), path)
    assert "expected grey of 8 bits" in fault(broken)


def test_pictures_that_differ_are_found(broken: Scene) -> None:
    first, second = broken.splits.map
    root = broken.images_root
    shutil.copyfile(picture_path(root, first), picture_path(root, second))
    assert "does not agree with" in fault(broken)


def test_counts_survive_the_file(tmp_path: Path) -> None:
    counts = np.random.default_rng(0).integers(0, 65536, (30, 40)).astype(np.uint16)
    name = "day/images/000003.jpg"
    write_thermal(tmp_path, name, counts, RECORD)
    stored = np.asarray(Image.open(counts_path(tmp_path, name)))
    assert np.array_equal(stored, counts)
    assert RECORD.kelvin(counts)[0, 0] == pytest.approx(0.01 * counts[0, 0], abs=1e-4)
    grey = RECORD.stretch(np.array([0, 28315, 30815, 33315, 65535], np.uint16))
    assert grey.tolist() == [0, 0, 128, 255, 255]


def test_a_range_must_be_one() -> None:
    with pytest.raises(ValueError, match="low_c must be below high_c"):
        Thermal(kelvin_per_count=0.01, netd_k=0.05, air_c=20.0, low_c=10.0, high_c=10.0)


def test_records_without_thermal_are_those_of_older_releases() -> None:
    session = Session(condition="summer-noon", flight="nadir", role="map")
    assert "thermal" not in session.model_dump(mode="json")
    assert "thermal" not in _dump(WITHOUT)
    assert _dump(CONFIG)["thermal"] is True


def test_the_disk_needs_room_for_thermal() -> None:
    left = {"day": (2, 3)}
    assert estimate_bytes(left, 100, thermal=True) == estimate_bytes(left, 100) + 100 * (9 + 8)


def test_values_are_interpolated_between_pixels() -> None:
    values = np.arange(20, dtype=np.float32).reshape(4, 5)
    xy = np.array([[[1.0, 0.5], [2.5, 1.5]]])
    assert resample_values(values, xy).tolist() == [[0.5, 7.0]]
