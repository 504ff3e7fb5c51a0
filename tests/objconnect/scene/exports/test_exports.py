"""Every export is read back by a reader of its own, and holds the poses of the scene."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from typer.testing import CliRunner

from benchmark.cli import app
from objconnect.scene.bundle.frames import LAYERS, write_frames
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.colmap_files import read_model
from tests.objconnect.scene.made_cameras import CAMERAS

EXACT = 1e-9


def all_frames(scene: Scene) -> dict[str, np.ndarray]:
    """cam_from_world of every frame by its name."""
    return {
        name: pose
        for session in scene.sessions
        for name, pose in zip(
            scene.frames(session).names, scene.frames(session).cam_from_world, strict=True
        )
    }


def with_cameras(path: Path, session: str, cameras: list[Camera]) -> Scene:
    """Give the frames of a session other cameras, in turn."""
    scene = Scene.open(path)
    frames = scene.frames(session)
    turns = tuple(cameras[k % len(cameras)] for k in range(len(frames)))
    with scene.layers(session) as dense:
        layers = [{layer: dense.read(layer, k) for layer in LAYERS} for k in range(len(frames))]
    write_frames(
        path / "sessions" / session / "frames.h5",
        dataclasses.replace(frames, cameras=turns),
        tuple(LAYERS),
        iter(layers),
    )
    return finish_scene(path, scene.manifest)


def test_colmap_holds_all_poses_and_the_map(rendered: Scene, tmp_path: Path) -> None:
    summary = export(rendered.path, "colmap", tmp_path / "out")
    expected = all_frames(rendered)
    assert summary["frames"] == len(expected) == 19
    model = pycolmap.Reconstruction(tmp_path / "out")
    found = {image.name: image for image in model.images.values()}
    assert set(found) == set(expected)
    for name, pose in expected.items():
        assert np.abs(found[name].cam_from_world().matrix() - pose[:3]).max() < EXACT
        camera = rendered.frames(name.split("/")[0]).cameras[0]
        assert found[name].camera.model_name == camera.model
        assert tuple(found[name].camera.params) == camera.params
    # Our reader sees the same map, observations included.
    back, sparse_map = read_model(tmp_path / "out"), rendered.sparse_map()
    order = np.lexsort(sparse_map.xyz.T)
    again = np.lexsort(back.xyz.T)
    np.testing.assert_array_equal(back.xyz[again], sparse_map.xyz[order])
    np.testing.assert_array_equal(back.rgb[again], sparse_map.rgb[order])
    np.testing.assert_array_equal(back.track_length[again], sparse_map.track_length[order])
    assert back.reprojection_error() == pytest.approx(sparse_map.reprojection_error(), abs=1e-6)


def test_colmap_of_some_sessions_and_without_a_map(rendered: Scene, tmp_path: Path) -> None:
    session = "winter-dusk-oblique-query"
    export(rendered.path, "colmap", tmp_path / "out", [session])
    model = pycolmap.Reconstruction(tmp_path / "out")
    assert {i.name for i in model.images.values()} == set(rendered.frames(session).names)
    assert model.num_points3D() == 0


def test_nerfstudio_projects_a_known_point(rendered: Scene, tmp_path: Path) -> None:
    """A surface point of a frame, through the file alone, falls on the pixel it came from."""
    export(rendered.path, "nerfstudio", tmp_path / "out")
    document = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert document["camera_model"] == "OPENCV"
    poses = all_frames(rendered)
    assert len(document["frames"]) == len(poses)
    for session in rendered.sessions:
        frames = rendered.frames(session)
        with rendered.layers(session) as dense:
            depth = dense.read("depth", 0)
        entry = next(f for f in document["frames"] if f["file_path"].endswith(frames.names[0]))
        photograph = (tmp_path / "out" / entry["file_path"]).resolve()
        assert photograph.samefile(rendered.images_root / frames.names[0])
        world_from_gl = np.array(entry["transform_matrix"])
        row, column = np.argwhere(depth > 0)[-1]
        z = float(depth[row, column])
        (fx, fy), (cx, cy) = frames.cameras[0].focal, frames.cameras[0].principal
        local = [(column + 0.5 - cx) / fx * z, (row + 0.5 - cy) / fy * z, z, 1.0]
        point = np.linalg.inv(frames.cam_from_world[0]) @ local
        # OpenGL: x right, y up, looking along -z.
        right, up, back, _ = np.linalg.inv(world_from_gl) @ point
        u = document["cx"] + document["fl_x"] * right / -back
        v = document["cy"] - document["fl_y"] * up / -back
        assert np.allclose([u, v], [column + 0.5, row + 0.5], atol=1e-6)
        assert (document["w"], document["h"]) == (frames.cameras[0].width, frames.cameras[0].height)
    for entry in document["frames"]:
        name = entry["file_path"].split("sessions/")[1]
        flipped = np.array(entry["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        assert np.abs(np.linalg.inv(flipped) - poses[name]).max() < EXACT


@pytest.mark.thorough
def test_nerfstudio_of_several_cameras(rendered_copy: Path, tmp_path: Path) -> None:
    session = "summer-noon-nadir-query"
    pinhole = Scene.open(rendered_copy).frames(session).cameras[0]
    opencv = Camera("OPENCV", 320, 320, (300.0, 301.0, 159.0, 161.0, -0.1, 0.01, 1e-3, -2e-3))
    with_cameras(rendered_copy, session, [pinhole, opencv])
    export(rendered_copy, "nerfstudio", tmp_path / "out", [session])
    document = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert "fl_x" not in document
    second = document["frames"][1]
    keys = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")
    assert tuple(second[key] for key in keys) == opencv.params
    fisheye = CAMERAS["fisheye"]
    with_cameras(rendered_copy, session, [pinhole, fisheye])
    with pytest.raises(InputError, match="perspective and fisheye"):
        export(rendered_copy, "nerfstudio", tmp_path / "mixed", [session])
    assert not (tmp_path / "mixed").exists()


def test_tum_is_world_from_cam(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "tum", tmp_path / "out")
    assert {p.stem for p in (tmp_path / "out").iterdir()} == set(rendered.sessions)
    for session in rendered.sessions:
        frames = rendered.frames(session)
        table = np.loadtxt(tmp_path / "out" / f"{session}.txt", ndmin=2)
        assert table.shape == (len(frames), 8)
        np.testing.assert_allclose(table[:, 0], frames.time, atol=1e-6)
        for row, cam_from_world in zip(table, frames.cam_from_world, strict=True):
            x, y, z, w = row[4:]
            v = np.array([x, y, z])
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            rotation = (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross
            assert np.abs(rotation.T - cam_from_world[:3, :3]).max() < EXACT
            assert np.abs(-rotation.T @ row[1:4] - cam_from_world[:3, 3]).max() < EXACT


def test_hloc_lists_queries_and_covisible_pairs(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "hloc", tmp_path / "out")
    lines = (tmp_path / "out" / "queries_with_intrinsics.txt").read_text().splitlines()
    read = {line.split()[0]: Camera.parse(line.split()[1:]) for line in lines}
    expected = {
        name: camera
        for session in rendered.splits.queries
        for name, camera in zip(
            rendered.frames(session).names, rendered.frames(session).cameras, strict=True
        )
    }
    assert read == expected
    overlap, names = rendered.covisibility.overlap, rendered.covisibility.names
    pairs = [
        line.split() for line in (tmp_path / "out" / "pairs-query.txt").read_text().splitlines()
    ]
    assert {query for query, _ in pairs} <= set(expected)
    assert {reference for _, reference in pairs} <= set(rendered.splits.map)
    for query in expected:
        shares = [overlap[names.index(query), names.index(r)] for q, r in pairs if q == query]
        assert shares == sorted(shares, reverse=True)
        assert min(shares) >= 0.1
    mapped = (tmp_path / "out" / "pairs-map.txt").read_text().splitlines()
    assert len(mapped) == len(set(mapped)) > 12
    assert {name for line in mapped for name in line.split()} <= set(rendered.splits.map)


@pytest.mark.parametrize("file_format", ["colmap", "nerfstudio", "tum", "hloc"])
def test_mistakes_leave_nothing_behind(rendered: Scene, tmp_path: Path, file_format: str) -> None:
    with pytest.raises(InputError, match="has no session 'monsoon'"):
        export(rendered.path, file_format, tmp_path / "out", ["monsoon"])
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="is not empty"):
        export(rendered.path, file_format, tmp_path / "mine")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["mine", "thesis.tex"]


def test_a_session_without_queries_has_no_hloc_list(rendered: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="have no query"):
        export(rendered.path, "hloc", tmp_path / "out", ["summer-noon-nadir-map"])
    assert not list(tmp_path.iterdir())


def test_command(rendered: Scene, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["export", str(rendered.path), "--format", "tum", "--out", str(out), "--json"]
    answer = CliRunner().invoke(app, words)
    assert answer.exit_code == 0, answer.stderr
    assert json.loads(answer.stdout)["frames"] == 19
    assert len(list(out.iterdir())) == 3
