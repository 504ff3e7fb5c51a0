from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames, Layer, dense_layers, read_frames, write_frames
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.scene.made_cameras import CAMERAS

ALL: tuple[Layer, ...] = ("depth", "instance", "semantic", "normal")


def make_frames(n: int, seed: int = 0) -> Frames:
    rng = np.random.default_rng(seed)
    poses = Pose.exp(torch.from_numpy(rng.normal(0, 3, (n, 6))))
    cameras = list(CAMERAS.values())
    return Frames(
        names=tuple(f"summer-noon-nadir/images/{k:06d}.jpg" for k in range(n)),
        cameras=tuple(cameras[k % 2] for k in range(n)),
        cam_from_world=poses.matrix().numpy(),
        time=1.7e9 + rng.uniform(0, 100, n),
        gps_prior=rng.normal(0, 100, (n, 3)),
        gps_sigma=rng.uniform(1, 2, (n, 3)),
        attitude_prior=poses.quaternion().numpy(),
        attitude_sigma_deg=rng.uniform(1, 2, n),
    )


def make_layers(k: int) -> dict[Layer, NDArray[Any]]:
    rng = np.random.default_rng(k)
    return {
        "depth": rng.uniform(0, 80, (6, 8)).astype(np.float32),
        "instance": rng.integers(0, 65536, (6, 8), dtype=np.uint16),
        "semantic": rng.integers(0, 256, (6, 8), dtype=np.uint8),
        "normal": rng.integers(-127, 128, (6, 8, 3), dtype=np.int8),
    }


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Write a session of three frames with every layer."""
    path = tmp_path / "frames.h5"
    write_frames(path, make_frames(3), ALL, (make_layers(k) for k in range(3)))
    return path


def assert_equal(a: Frames, b: Frames) -> None:
    assert a.names == b.names
    assert a.cameras == b.cameras
    for key in (
        "cam_from_world",
        "time",
        "gps_prior",
        "gps_sigma",
        "attitude_prior",
        "attitude_sigma_deg",
    ):
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key))


@pytest.mark.parametrize("n", [0, 1, 5])
def test_frames_survive_writing_and_reading(tmp_path: Path, n: int) -> None:
    frames = make_frames(n)
    write_frames(tmp_path / "frames.h5", frames, (), iter([{}] * n))
    again = read_frames(tmp_path / "frames.h5")
    assert_equal(again, frames)
    assert len(again) == n
    torch.testing.assert_close(again.poses.matrix(), torch.from_numpy(frames.cam_from_world))


coordinate = st.floats(-1e6, 1e6)


@settings(max_examples=25)
@given(
    st.lists(
        st.tuples(st.tuples(*[st.floats(-3, 3)] * 3), st.tuples(*[coordinate] * 3)),
        min_size=1,
        max_size=4,
    )
)
def test_any_pose_comes_back_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, tangents: list[tuple[tuple[float, ...], ...]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "poses.h5"
    delta = torch.tensor([[*omega, *v] for omega, v in tangents], dtype=torch.float64)
    frames = replace(make_frames(len(delta)), cam_from_world=Pose.exp(delta).matrix().numpy())
    write_frames(path, frames, (), iter([{}] * len(delta)))
    assert_equal(read_frames(path), frames)


def test_layers_come_back(path: Path) -> None:
    with dense_layers(path) as dense:
        for k in range(3):
            for layer, image in make_layers(k).items():
                again = dense.read(layer, k)
                np.testing.assert_array_equal(again, image)
                assert again.dtype == image.dtype


def test_a_layer_that_was_not_rendered(tmp_path: Path) -> None:
    path = tmp_path / "frames.h5"
    write_frames(path, make_frames(1), ("depth",), iter([make_layers(0)]))
    with dense_layers(path) as dense:
        assert dense.has("depth")
        assert not dense.has("normal")
        with pytest.raises(InputError, match=r"frames\.h5 has no normal layer"):
            dense.read("normal", 0)


def test_a_frame_that_is_not_there(path: Path) -> None:
    with dense_layers(path) as dense, pytest.raises(InputError, match="depth of frame number 4"):
        dense.read("depth", 3)


def test_a_session_that_fails_half_way_leaves_nothing(tmp_path: Path) -> None:
    def layers() -> Any:
        yield make_layers(0)
        raise RuntimeError("the renderer died")

    with pytest.raises(RuntimeError, match="the renderer died"):
        write_frames(tmp_path / "frames.h5", make_frames(2), ALL, layers())
    assert not list(tmp_path.iterdir())


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"frames\.h5 does not exist"):
        read_frames(tmp_path / "frames.h5")
    with (
        pytest.raises(InputError, match=r"frames\.h5 does not exist"),
        dense_layers(tmp_path / "frames.h5"),
    ):
        pytest.fail("the block must not start")


def test_a_file_that_is_not_hdf5_is_refused(tmp_path: Path) -> None:
    (tmp_path / "frames.h5").write_text("poses")
    with pytest.raises(InputError, match="damaged or not an HDF5 file"):
        read_frames(tmp_path / "frames.h5")


@given(st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_refused(
    tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "truncated.h5"
    write_frames(path, make_frames(2), ALL, (make_layers(k) for k in range(2)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"truncated\.h5"):
        read_frames(path)


@settings(max_examples=200)
@given(data=st.data())
def test_flipped_bytes_are_refused_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "flipped.h5"
    write_frames(path, make_frames(2), ("depth",), (make_layers(k) for k in range(2)))
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(whole)
    try:
        assert np.isfinite(read_frames(path).cam_from_world).all()
        with dense_layers(path) as dense:
            dense.read("depth", 0)
    except InputError as error:
        assert "flipped.h5" in str(error)


@pytest.mark.parametrize(
    "key", ["cam_from_world", "time", "gps_prior", "gps_sigma", "attitude_prior"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_names_its_frame(path: Path, key: str, value: float) -> None:
    if key == "time":
        value = np.inf  # a time that is NaN was not measured
    with h5py.File(path, "r+") as file:
        row = np.atleast_1d(file[key][1])
        row.flat[0] = value
        file[key][1] = row.reshape(file[key].shape[1:])
    with pytest.raises(InputError, match=f"{key} of frame .*000001.jpg is not finite"):
        read_frames(path)


def test_what_was_not_measured_is_nan(path: Path) -> None:
    frames = make_frames(3)
    for key in ("time", "gps_prior", "gps_sigma", "attitude_prior", "attitude_sigma_deg"):
        getattr(frames, key)[1] = np.nan
    write_frames(path, frames, (), iter([{}] * 3))
    again = read_frames(path)
    assert_equal(again, frames)
    assert again.has_gps.tolist() == again.has_attitude.tolist() == [True, False, True]
    frames.gps_sigma[1] = 1.0
    write_frames(path, frames, (), iter([{}] * 3))
    with pytest.raises(InputError, match=r"gps_prior of frame .*000001.jpg is not finite"):
        read_frames(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("cam_from_world", np.zeros((3, 3, 4))),
        ("cam_from_world", np.zeros((2, 4, 4))),
        ("time", np.zeros((3, 1))),
        ("gps_prior", np.zeros(9)),
        ("attitude_prior", np.zeros((3, 3))),
        ("camera_index", np.zeros(2, int)),
        ("camera_index", np.array([0, 1, 9])),
        ("camera_index", np.array([0, 1, -1])),
        ("names", np.zeros(3)),
        ("names", [b"\xff"] * 3),
        ("time", [b"noon"] * 3),
    ],
)
def test_wrong_shapes_and_kinds(path: Path, key: str, value: object) -> None:
    with h5py.File(path, "r+") as file:
        del file[key]
        file[key] = value
    with pytest.raises(InputError, match=r"frames\.h5"):
        read_frames(path)


@pytest.mark.parametrize("key", ["names", "cameras", "cam_from_world", "camera_index", "gps_sigma"])
def test_a_file_with_missing_parts_is_refused(path: Path, key: str) -> None:
    with h5py.File(path, "r+") as file:
        del file[key]
    with pytest.raises(InputError, match="damaged or incomplete"):
        read_frames(path)


@pytest.mark.parametrize("text", [b"", b"\xff\xfe", b"PINHOLE 1", b"PINHOLE 8 6 x 7 4 3"])
def test_bad_cameras_are_refused(path: Path, text: bytes) -> None:
    with h5py.File(path, "r+") as file:
        count = len(file["cameras"])
        del file["cameras"]
        file["cameras"] = np.array([text] * count, "S")
    with pytest.raises(InputError, match=r"frames\.h5"):
        read_frames(path)


def test_one_camera_is_stored_once(tmp_path: Path) -> None:
    camera = Camera("PINHOLE", 8, 6, (0.1 + 0.2, 7.0, 4.0, 3.0))
    frames = replace(make_frames(4), cameras=(camera,) * 4)
    write_frames(tmp_path / "frames.h5", frames, (), iter([{}] * 4))
    with h5py.File(tmp_path / "frames.h5") as file:
        assert len(file["cameras"]) == 1
    assert read_frames(tmp_path / "frames.h5").cameras == (camera,) * 4


def test_too_few_images_leave_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="3 frames but images of 2"):
        write_frames(
            tmp_path / "frames.h5", make_frames(3), ALL, (make_layers(k) for k in range(2))
        )
    assert not list(tmp_path.iterdir())
