"""Extended CMU Seasons in its own tree, made small; every trap of its format has a test."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.datasets.cmu import condition, is_cmu, open_cmu
from benchmark.datasets.open import open_datasets
from objconnect.scene.errors import InputError
from objconnect.scene.exports.cmu_names import surroundings
from tests.benchmark.made_data import pose_at, write_jpeg, write_model

INTRINSICS = """\
# camera model w h fx fy cx cy k1 k2 p1 p2

c0 OPENCV 96 64 81.0 80.5 48.5 35.0 -0.399 0.189 0.0002 0.0006
c1 OPENCV 96 64 82.0 82.5 49.0 33.1 -0.397 0.182 0.0002 -0.0006
"""
REFERENCE = ["img_00119_c0_1303398474779439us.jpg", "img_00120_c1_1303398474879439us.jpg"]
SNOW = "img_00042_c1_1292950800000000us.jpg"
AUTUMN = "img_00043_c0_1287503834101037us.jpg"
HIDDEN = "img_00044_c0_1287503834201037us.jpg"


def line(name: str, index: int, last: list[float] | None = None) -> str:
    """A pose as the data set writes it: six decimals, and the camera's centre."""
    pose = pose_at(index)
    numbers = [*pose.quaternion().tolist(), *(last or pose.centre().tolist())]
    return " ".join([name, *(f"{x:.6f}" for x in numbers)]) + "\n"


@pytest.fixture
def cmu(tmp_path: Path) -> Path:
    root = tmp_path / "Extended-CMU-Seasons"
    slice2 = root / "slice2"
    write_model(slice2 / "sparse", {name: pose_at(k) for k, name in enumerate(REFERENCE)})
    for k, name in enumerate(REFERENCE):
        write_jpeg(slice2 / "database" / name, k)
    for k, name in enumerate((SNOW, AUTUMN, HIDDEN)):
        write_jpeg(slice2 / "query" / name, 10 + k)
    poses = slice2 / "camera-poses"
    poses.mkdir()
    (poses / "slice-2-gt-query-images-20101221.txt").write_text(line(SNOW, 3))
    (poses / "slice-2-gt-query-images-20101019.txt").write_text(line(AUTUMN, 4))
    (poses / "slice-2-gt-query-images-20100901.txt").write_text("")
    (slice2 / "test-images-slice2.txt").write_text(f"{HIDDEN}\n")
    shutil.copytree(slice2, root / "slice22")
    for file in (root / "slice22" / "camera-poses").iterdir():
        file.write_text("")
    (root / "intrinsics.txt").write_text(INTRINSICS)
    return root


def pose_file(cmu: Path, day: str = "20101221") -> Path:
    return cmu / "slice2" / "camera-poses" / f"slice-2-gt-query-images-{day}.txt"


def test_the_download_is_read_unchanged(cmu: Path) -> None:
    """Slices without a public pose are left out; empty pose files are not a fault."""
    (dataset,) = open_datasets(cmu)
    assert (dataset.name, dataset.track) == ("cmu-urban-slice2", "cmu")
    assert [query.name for query in dataset.queries] == [SNOW, AUTUMN]
    assert dataset.map_conditions == ("2011-04-21",)
    assert set(dataset.load_map().images) == set(REFERENCE)
    assert all((dataset.images / name).is_file() for name in REFERENCE)


def test_one_slice_opens_alone(cmu: Path) -> None:
    assert is_cmu(cmu / "slice2")
    assert [d.name for d in open_datasets(cmu / "slice2")] == ["cmu-urban-slice2"]
    with pytest.raises(InputError, match="no public query pose"):
        open_cmu(cmu / "slice22")


def test_pose_files_hold_centres(cmu: Path) -> None:
    (dataset,) = open_cmu(cmu)
    for query, index in zip(dataset.queries, (3, 4), strict=True):
        metres, degrees = query.reference.error_to(pose_at(index))
        assert float(metres) < 1e-5
        assert float(degrees) < 1e-4


def test_each_image_has_the_camera_of_its_name(cmu: Path) -> None:
    (dataset,) = open_cmu(cmu)
    snow, autumn = dataset.queries
    assert snow.camera.params[:4] == (82.0, 82.5, 49.0, 33.1)
    assert autumn.camera.params[:4] == (81.0, 80.5, 48.5, 35.0)
    # Intrinsics are COLMAP's pixels already: nothing is added or taken.
    assert snow.camera.principal == (49.0, 33.1)


def test_points_outside_the_field_stay_outside(cmu: Path) -> None:
    """Strong barrel distortion pulls them inwards; none may fold back into the picture."""
    (dataset,) = open_cmu(cmu)
    camera = dataset.queries[0].camera
    angle = torch.deg2rad(torch.linspace(45, 89, 100, dtype=torch.float64))
    far = torch.stack([angle.sin(), torch.zeros(100, dtype=torch.float64), angle.cos()], -1)
    projected = camera.project(far)
    assert not (projected.valid & camera.contains(projected.xy)).any()


def test_quaternions_are_normalised_or_refused(cmu: Path) -> None:
    (dataset,) = open_cmu(cmu)
    rotation = dataset.queries[0].reference.rotation.numpy()
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
    words = pose_file(cmu).read_text().split()
    words[1:5] = ["0.9", "0.9", "0.1", "0.1"]
    pose_file(cmu).write_text(" ".join(words) + "\n")
    with pytest.raises(InputError, match=r"20101221.txt:1: .* quaternion of length"):
        open_cmu(cmu)


def test_the_condition_is_the_local_day_in_pittsburgh() -> None:
    assert condition(SNOW) == "2010-12-21 low sun, no foliage, snow"
    assert condition(AUTUMN) == "2010-10-19 sunny, foliage"
    # Eight in the evening there is the next day in UTC.
    evening = "img_00001_c0_1292979600000000us.jpg"
    assert condition(evening).startswith("2010-12-21")
    with pytest.raises(InputError, match="is not named like"):
        condition("IMG_0001.JPG")


def test_slices_have_their_published_surroundings() -> None:
    assert [surroundings(n) for n in (2, 8, 9, 17, 18, 25)] == [
        "urban", "urban", "suburban", "suburban", "park", "park",
    ]  # fmt: skip


def test_faults_are_named(cmu: Path) -> None:
    (cmu / "slice2" / "query" / SNOW).unlink()
    with pytest.raises(InputError, match=f"{SNOW} does not exist, but"):
        open_cmu(cmu)
    pose_file(cmu).write_text(line(AUTUMN, 3))
    with pytest.raises(InputError, match="has a pose in another file already"):
        open_cmu(cmu)
    (cmu / "intrinsics.txt").write_text(INTRINSICS.replace("c1", "c7"))
    with pytest.raises(InputError, match="expected cameras c0 and c1"):
        open_cmu(cmu)
