from __future__ import annotations

import shutil
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap

FILES = ("cameras.bin", "images.bin", "points3D.bin")
# The offsets of the first image's fields in images.bin.
QUATERNION, TRANSLATION, CAMERA, NAME = 12, 44, 68, 72


@pytest.fixture(scope="session")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a small model by COLMAP; tests must not change it."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 2, 3, 25
    pycolmap.set_random_seed(1)
    folder = tmp_path_factory.mktemp("model")
    pycolmap.synthesize_dataset(options).write(folder)
    return folder


@pytest.fixture
def damaged(model: Path, tmp_path: Path) -> Path:
    """Copy the model, to damage it."""
    return Path(shutil.copytree(model, tmp_path / "damaged"))


def patch(path: Path, offset: int, value: bytes) -> None:
    data = bytearray(path.read_bytes())
    data[offset : offset + len(value)] = value
    path.write_bytes(data)


def assert_equal(ours: SparseMap, native: pycolmap.Reconstruction) -> None:
    """Every value the map holds is the one COLMAP reads from the same files."""
    ids = sorted(native.points3D)
    row_of = {point_id: row for row, point_id in enumerate(ids)}
    points = [native.points3D[i] for i in ids]
    np.testing.assert_array_equal(ours.xyz, [p.xyz for p in points])
    np.testing.assert_array_equal(ours.rgb, [p.color for p in points])
    np.testing.assert_array_equal(ours.error, [p.error for p in points])
    np.testing.assert_array_equal(ours.track_length, [p.track.length() for p in points])
    assert ours.names == tuple(sorted(image.name for image in native.images.values()))
    for image in native.images.values():
        mine = ours.images[image.name]
        assert mine.camera.model == image.camera.model.name
        assert (mine.camera.width, mine.camera.height) == (image.camera.width, image.camera.height)
        assert mine.camera.params == tuple(image.camera.params)
        np.testing.assert_allclose(
            mine.cam_from_world[:3], image.cam_from_world().matrix(), atol=1e-12
        )
        np.testing.assert_allclose(mine.centre, image.projection_center(), atol=1e-9)
        np.testing.assert_array_equal(mine.xy, [p.xy for p in image.points2D])
        rows = [row_of[p.point3D_id] if p.has_point3D() else -1 for p in image.points2D]
        np.testing.assert_array_equal(mine.point_rows, rows)


def test_equals_what_colmap_wrote(model: Path) -> None:
    ours = read_model(model)
    assert_equal(ours, pycolmap.Reconstruction(model))
    assert (ours.images[ours.names[0]].point_rows == -1).any()
    assert ours.reprojection_error() < 1e-6  # the synthetic observations are exact


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("SIMPLE_PINHOLE", [900.0, 512, 384]),
        ("PINHOLE", [900.0, 910, 512, 384]),
        ("SIMPLE_RADIAL", [900.0, 512, 384, 0.05]),
        ("RADIAL", [900.0, 512, 384, 0.05, -0.01]),
        ("OPENCV", [900.0, 910, 512, 384, 0.05, -0.01, 1e-3, -2e-3]),
        ("OPENCV_FISHEYE", [900.0, 910, 512, 384, 0.05, -0.01, 1e-3, -2e-3]),
        ("FULL_OPENCV", [900.0, 910, 512, 384, 0.05, -0.01, 1e-3, -2e-3, 0.03, 0.2, 0.01, -0.02]),
    ],
)
def test_every_camera_model(name: str, params: list[float], tmp_path: Path) -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.camera_model_id = getattr(pycolmap.CameraModelId, name)
    options.camera_params = params
    pycolmap.synthesize_dataset(options).write(tmp_path)
    ours = read_model(tmp_path)
    assert_equal(ours, pycolmap.Reconstruction(tmp_path))
    assert ours.reprojection_error() < 1e-6


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("FULL_OPENCV", [900.0, 910, 512, 384, 0.05, -0.01, 1e-3, -2e-3, 0, 0, 0, 0]),
        ("SIMPLE_RADIAL_FISHEYE", [900.0, 512, 384, 0.05]),
        ("RADIAL_FISHEYE", [900.0, 512, 384, 0.05, -0.01]),
        ("THIN_PRISM_FISHEYE", [900.0, 910, 512, 384, 0.05, -0.01, 0, 0, 1e-3, 0, 0, 0]),
    ],
)
def test_models_that_equal_ours(name: str, params: list[float], tmp_path: Path) -> None:
    """Points fall on the synthetic observations, which are exact."""
    options = pycolmap.SyntheticDatasetOptions()
    options.camera_model_id = getattr(pycolmap.CameraModelId, name)
    options.camera_params = params
    pycolmap.synthesize_dataset(options).write(tmp_path)
    assert read_model(tmp_path).reprojection_error() < 1e-6


@pytest.mark.parametrize(
    ("name", "params", "message"),
    [
        ("FOV", [900.0, 900, 512, 384, 0.5], "FOV is supported only where omega is zero"),
        ("EUCM", [900.0, 900, 512, 384, 0.5, 1.0], "model EUCM is not supported; supported: SI"),
    ],
)
def test_other_models_are_named(
    name: str, params: list[float], message: str, tmp_path: Path
) -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.camera_model_id = getattr(pycolmap.CameraModelId, name)
    options.camera_params = params
    pycolmap.synthesize_dataset(options).write(tmp_path)
    with pytest.raises(InputError, match=message):
        read_model(tmp_path)


def test_real_flights_equal_colmap(flights: Path) -> None:
    models = sorted(path.parent for path in flights.glob("*/sparse/*/images.bin"))
    assert models
    for folder in models:
        ours = read_model(folder)
        assert_equal(ours, pycolmap.Reconstruction(folder))
        assert ours.reprojection_error() < 2


@pytest.mark.parametrize("name", FILES)
@given(data=st.data())
def test_a_file_cut_anywhere_is_refused(
    model: Path, tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    folder = Path(shutil.copytree(model, tmp_path_factory.mktemp("cut"), dirs_exist_ok=True))
    whole = (model / name).read_bytes()
    cut = data.draw(st.integers(0, len(whole) - 1))
    (folder / name).write_bytes(whole[:cut])
    with pytest.raises(InputError, match=name):
        read_model(folder)


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=200)
@given(data=st.data())
def test_flipped_bytes_are_refused_or_harmless(
    model: Path, tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    folder = Path(shutil.copytree(model, tmp_path_factory.mktemp("flip"), dirs_exist_ok=True))
    size = (model / name).stat().st_size
    for _ in range(data.draw(st.integers(1, 4))):
        patch(folder / name, data.draw(st.integers(0, size - 1)), data.draw(st.binary(min_size=1)))
    try:
        ours = read_model(folder)
    except InputError as error:
        assert "\n" not in str(error)
        return
    assert all(image.point_rows.max(initial=-1) < len(ours.xyz) for image in ours.images.values())
    assert ours.centres.shape == (len(ours.names), 3)
    assert ours.residuals(ours.names[0]).shape[1] == 2


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("claim", [2**60, 2**64 - 1, 10**6, 1000])
def test_an_enormous_count_is_refused_at_once(damaged: Path, name: str, claim: int) -> None:
    patch(damaged / name, 0, struct.pack("<Q", claim))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=f"{name} is truncated or damaged: it claims {claim}"):
            read_model(damaged)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    whole = sum(path.stat().st_size for path in damaged.iterdir())
    assert peak < 20 * whole + 1_000_000, "not what the count claims"


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        (QUATERNION, struct.pack("<d", np.nan), "pose that is not finite"),
        (TRANSLATION, struct.pack("<d", np.inf), "pose that is not finite"),
        (QUATERNION, struct.pack("<4d", 2, 0, 0, 0), "quaternion of length 2.0000 instead of 1"),
        (QUATERNION, struct.pack("<4d", 0, 0, 0, 0), "quaternion of length 0.0000 instead of 1"),
        (CAMERA, struct.pack("<I", 77), "has the unknown camera 77"),
        (NAME, b"\xff\xfe", "damaged name"),
    ],
)
def test_impossible_images_are_refused(
    damaged: Path, offset: int, value: bytes, message: str
) -> None:
    patch(damaged / "images.bin", offset, value)
    with pytest.raises(InputError, match=message):
        read_model(damaged)


def test_the_message_names_the_image(damaged: Path) -> None:
    data = (damaged / "images.bin").read_bytes()
    name = data[NAME : data.index(b"\0", NAME)].decode()
    patch(damaged / "images.bin", TRANSLATION, struct.pack("<d", np.nan))
    with pytest.raises(InputError, match=f"images.bin: image {name} has a pose"):
        read_model(damaged)


def test_a_name_listed_twice_is_refused(damaged: Path) -> None:
    names = sorted(read_model(damaged).images)
    data = (damaged / "images.bin").read_bytes()
    (damaged / "images.bin").write_bytes(data.replace(names[0].encode(), names[1].encode()))
    with pytest.raises(InputError, match=f"image {names[1]} is listed twice"):
        read_model(damaged)


def test_a_point_that_is_not_finite_is_refused(damaged: Path) -> None:
    patch(damaged / "points3D.bin", 16, struct.pack("<d", np.nan))
    with pytest.raises(InputError, match="coordinate that is not finite"):
        read_model(damaged)


def test_an_observation_of_an_unknown_point_is_refused(damaged: Path) -> None:
    patch(damaged / "points3D.bin", 8, struct.pack("<Q", 999_999))
    with pytest.raises(InputError, match="observes a point that points3D.bin does not have"):
        read_model(damaged)


def test_empty_maps_are_refused(damaged: Path) -> None:
    (damaged / "points3D.bin").write_bytes(bytes(8))
    with pytest.raises(InputError, match="it has no 3D point"):
        read_model(damaged)
    (damaged / "images.bin").write_bytes(bytes(8))
    with pytest.raises(InputError, match="it has no registered image"):
        read_model(damaged)


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file_is_named(damaged: Path, name: str) -> None:
    (damaged / name).unlink()
    with pytest.raises(InputError, match=f"cannot read map file .*{name}: No such file"):
        read_model(damaged)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="map folder .*nowhere does not exist"):
        read_model(tmp_path / "nowhere")


@pytest.mark.parametrize("name", FILES)
def test_text_instead_of_a_binary_file_is_refused(damaged: Path, name: str) -> None:
    (damaged / name).write_text("# Camera list with one line of data per camera:\n" * 20)
    with pytest.raises(InputError, match=f"{name}.*truncated or damaged"):
        read_model(damaged)


@pytest.mark.parametrize("name", [b"/", b"../"])
def test_images_lie_in_their_folder(damaged: Path, name: bytes) -> None:
    patch(damaged / "images.bin", NAME, name)
    with pytest.raises(InputError, match="does not lie in the folder of images"):
        read_model(damaged)


@pytest.mark.parametrize("file", FILES)
def test_a_file_that_claims_2_to_the_60(damaged: Path, file: str) -> None:
    patch(damaged / file, 0, struct.pack("<Q", 2**60))
    with pytest.raises(InputError, match="truncated or damaged: it claims 1152921504606846976"):
        read_model(damaged)
