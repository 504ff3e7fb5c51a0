"""Every way to misread a scene is named, and a scene as rendered is exact."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from objconnect.scene.bundle.frames import LAYERS, Frames, Layer, write_frames
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.checks.conventions import shift_principal_point
from objconnect.scene.checks.validate import validate
from objconnect.scene.errors import InputError

Depths = Callable[[Frames, NDArray[Any]], NDArray[Any]]


@pytest.fixture
def queries_copy(rendered: Scene, tmp_path: Path) -> Path:
    """A copy of the rendered scene to break: its queries alone, which take a third of the time."""
    path = tmp_path / "copy"
    shutil.copytree(rendered.path, path, ignore=shutil.ignore_patterns("map", "*-map"))
    sessions = {name: of for name, of in rendered.sessions.items() if of.role == "query"}
    finish_scene(path, rendered.manifest.model_copy(update={"sessions": sessions}))
    return path


def rewrite(
    path: Path, change: Callable[[Frames], Frames], depth: Depths = lambda _, image: image
) -> None:
    """Rewrite every session of a scene in other conventions."""
    scene = Scene.open(path)
    for session in scene.sessions:
        frames = scene.frames(session)
        with scene.layers(session) as dense:
            layers = [{name: dense.read(name, k) for name in LAYERS} for k in range(len(frames))]

        def images(
            frames: Frames = frames, layers: list[dict[Layer, Any]] = layers
        ) -> Iterator[dict[Layer, Any]]:
            for frame in layers:
                yield frame | {"depth": depth(frames, frame["depth"])}

        target = scene.images_root / session / "frames.h5"
        write_frames(target, change(frames), tuple(LAYERS), images())
    # The digests are made to match again, so that only the conventions are wrong.
    finish_scene(path, scene.manifest)


@pytest.fixture
def no_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Depth is what takes long to check: it is left out where the fault is of another kind."""
    monkeypatch.setattr("objconnect.scene.checks.validate._check_geometry", lambda *_: iter(()))


def faults(path: Path) -> str:
    report = validate(path)
    assert not report.ok
    return "\n".join(check.detail for check in report.checks if not check.ok)


def with_poses(change: Callable[[NDArray[Any]], NDArray[Any]]) -> Callable[[Frames], Frames]:
    return lambda frames: replace(frames, cam_from_world=change(frames.cam_from_world.copy()))


def transpose(poses: NDArray[Any]) -> NDArray[Any]:
    poses[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1).copy()
    return poses


def centre(poses: NDArray[Any]) -> NDArray[Any]:
    poses[:, :3, 3] = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return poses


def opengl(poses: NDArray[Any]) -> NDArray[Any]:
    poses[:, 1:3] *= -1
    return poses


def along_the_ray(frames: Frames, depth: NDArray[Any]) -> NDArray[Any]:
    rays, _ = frames.cameras[0].unproject(frames.cameras[0].pixel_grid())
    return depth * rays.norm(dim=-1).numpy()


def test_rendered_truth_is_exact(rendered: Scene) -> None:
    report = validate(rendered.path)
    assert report.ok, report.text()
    depth = [check for check in report.checks if check.name.endswith("depth and poses agree")]
    assert len(depth) == len(rendered.sessions) + 1
    assert max(check.figures["median_px"] for check in depth) < 0.05
    assert min(check.figures["pixels"] for check in depth) > 1000
    assert "all checks hold" in report.text()


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (with_poses(np.linalg.inv), "poses are inverted"),
        pytest.param(with_poses(transpose), "rotations are transposed", marks=pytest.mark.thorough),
        (with_poses(centre), "translations are camera centres"),
        (with_poses(opengl), "camera axes are OpenGL's"),
    ],
)
def test_pose_conventions_are_named(
    queries_copy: Path, change: Callable[[Frames], Frames], fault: str
) -> None:
    rewrite(queries_copy, change)
    assert fault in faults(queries_copy)


@pytest.mark.parametrize(
    ("pixels", "fault"), [(-0.5, "half a pixel too small"), (0.5, "pixel too large")]
)
def test_half_a_pixel_is_named(queries_copy: Path, pixels: float, fault: str) -> None:
    rewrite(
        queries_copy,
        lambda frames: replace(
            frames, cameras=tuple(shift_principal_point(c, pixels) for c in frames.cameras)
        ),
    )
    assert fault in faults(queries_copy)


def test_depth_along_the_ray_is_named(queries_copy: Path) -> None:
    rewrite(queries_copy, lambda frames: frames, along_the_ray)
    assert "distance along the ray" in faults(queries_copy)


def test_depth_of_a_wrong_scale_is_noticed(queries_copy: Path) -> None:
    rewrite(queries_copy, lambda frames: frames, lambda _, depth: depth * np.float32(1.02))
    assert "expected under 0.05 px" in faults(queries_copy)


def test_depth_of_a_wrong_resolution_is_named(queries_copy: Path) -> None:
    rewrite(queries_copy, lambda frames: frames, lambda _, depth: depth[::2, ::2])
    assert "depth is (160, 160) pixels" in faults(queries_copy)


@pytest.mark.usefixtures("no_depth")
def test_attitude_of_another_order_is_named(queries_copy: Path) -> None:
    rewrite(
        queries_copy,
        lambda frames: replace(frames, attitude_prior=np.roll(frames.attitude_prior, -1, axis=1)),
    )
    assert "x y z w" in faults(queries_copy)


@pytest.mark.usefixtures("no_depth")
def test_position_prior_of_another_origin_is_noticed(queries_copy: Path) -> None:
    rewrite(queries_copy, lambda frames: replace(frames, gps_prior=frames.gps_prior + 30))
    assert "standard deviations off" in faults(queries_copy)


@pytest.mark.usefixtures("no_depth")
def test_mirrored_rotation_is_noticed(queries_copy: Path) -> None:
    def mirror(poses: NDArray[Any]) -> NDArray[Any]:
        poses[:, 0] *= -1
        return poses

    rewrite(queries_copy, with_poses(mirror))
    assert "mirrored" in faults(queries_copy)


@pytest.mark.usefixtures("no_depth")
def test_world_upside_down_is_noticed(queries_copy: Path) -> None:
    def flip(poses: NDArray[Any]) -> NDArray[Any]:
        return poses @ np.diag([1.0, -1.0, -1.0, 1.0])

    rewrite(queries_copy, with_poses(flip))
    assert "look at the sky" in faults(queries_copy)


def test_pose_that_is_not_finite_is_one_line(queries_copy: Path) -> None:
    def broken(poses: NDArray[Any]) -> NDArray[Any]:
        poses[1, 0, 0] = np.nan
        return poses

    rewrite(queries_copy, with_poses(broken))
    with pytest.raises(InputError, match=r"cam_from_world of frame .*000001.jpg is not finite"):
        validate(queries_copy)


@pytest.mark.usefixtures("no_depth")
def test_changed_files_are_named(queries_copy: Path) -> None:
    (queries_copy / "splits.json").write_text("{}")
    (queries_copy / "sessions" / "note.txt").write_text("new")
    found = faults(queries_copy)
    assert "splits.json" in found
    assert "note.txt" in found


@pytest.mark.usefixtures("no_depth")
def test_truncated_photograph_is_named(queries_copy: Path) -> None:
    photograph = next(queries_copy.rglob("000002.jpg"))
    photograph.write_bytes(photograph.read_bytes()[:5000])
    assert f"{photograph} is damaged" in faults(queries_copy)


@pytest.mark.usefixtures("no_depth")
def test_photograph_of_another_size_is_named(queries_copy: Path) -> None:
    photograph = next(queries_copy.rglob("000002.jpg"))
    Image.new("RGB", (100, 80)).save(photograph)
    assert "is 100 x 80 pixels but its camera is 320 x 320" in faults(queries_copy)
