"""Depth maps of a rendered flight, against its truth."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from objconnect.mapping.dense.command import DENSE, KEY_FILE, UNFINISHED, _resumable, dense
from objconnect.mapping.dense.options import DenseOptions
from objconnect.mapping.dense.report import DenseReport
from objconnect.mapping.dense.sources import choose_sources, find_seeds
from objconnect.mapping.dense.undistort import pinhole_of, undistort_map, write_undistorted
from objconnect.mapping.dense.workspace import Workspace
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.locks import write_lock

SIZE = 96


@pytest.fixture(scope="module")
def scene_and_report(
    rendered: Scene, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, DenseReport]:
    path = Path(shutil.copytree(rendered.path, tmp_path_factory.mktemp("dense") / "hamlet"))
    return Scene.open(path), dense(path, size=SIZE)


def digests(scene: Path) -> dict[str, bytes]:
    """The bytes of everything the command made but its pictures."""
    folder = scene / DENSE
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def test_depth_is_right(scene_and_report: tuple[Scene, DenseReport]) -> None:
    """Pixels of 1 m and photographs far apart: docs/evidence/mapping.md measures the full size."""
    _, report = scene_and_report
    assert report.maps == report.photographs == 12
    found = report.accuracy["all"]
    assert found.pixels > 12 * SIZE * SIZE / 3
    assert found.right > 0.5
    assert found.complete > 0.8
    assert set(report.accuracy) <= {"all", "ground", "small", "medium", "large"}
    parts = [a.pixels for name, a in report.accuracy.items() if name != "all"]
    assert sum(parts) == found.pixels
    assert report.cpu_seconds_per_map is not None
    assert "within 0.5% of the true depth" in report.text()


def test_the_cloud_lies_on_the_surface(scene_and_report: tuple[Scene, DenseReport]) -> None:
    """Its points, seen from a photograph, are at the depth that was rendered; normals point up."""
    scene, report = scene_and_report
    data = Workspace(scene.path / DENSE).cloud.read_bytes()
    header, _, body = data.partition(b"end_header\n")
    assert f"element vertex {report.points}".encode() in header
    layout = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])
    cloud = np.frombuffer(body, layout)
    assert report.points == len(cloud) > 500
    assert np.median(cloud["normal"][:, 2]) > 0.9
    frames = scene.frames("summer-noon-nadir-map")
    with scene.layers("summer-noon-nadir-map") as layers:
        depth = layers.read("depth", 5)
    pose = frames.cam_from_world[5]
    local = cloud["xyz"] @ pose[:3, :3].T + pose[:3, 3]
    column, row = np.floor((local @ frames.cameras[5].calibration.T)[:, :2] / local[:, 2:]).T
    inside = (column >= 0) & (column < 320) & (row >= 0) & (row < 320)
    off = depth[row[inside].astype(int), column[inside].astype(int)] / local[inside, 2] - 1
    assert np.median(np.abs(off)) < 0.005


def test_the_scene_is_whole(scene_and_report: tuple[Scene, DenseReport]) -> None:
    scene, _ = scene_and_report
    assert Scene.open(scene.path).find_changed_files() == []
    assert not (scene.path / UNFINISHED).exists()
    for name in ("dense-maps.png", "dense-cloud.png"):
        assert (scene.path / "pictures" / name).stat().st_size > 10_000


@pytest.mark.thorough
def test_an_interrupted_run_goes_on_to_the_same_bytes(
    scene_and_report: tuple[Scene, DenseReport],
    rendered_copy: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Stopped by a full disk among the first maps, by a signal among the last, and by a full disk
    before they are fused."""
    undisturbed, _ = scene_and_report
    written: list[str] = []
    write, write_bytes = Workspace.write, Path.write_bytes

    def write_until_full(path: Path, data: bytes) -> int:
        if len(written) == 13:  # six photometric maps are done, and the normals of the seventh
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if "stereo" in path.parts:
            written.append(path.name)
        return write_bytes(path, data)

    with monkeypatch.context() as patch:
        patch.setattr("objconnect.mapping.dense.workspace.Path.write_bytes", write_until_full)
        with pytest.raises(WriteError, match="No space left"):
            dense(rendered_copy, size=SIZE)
    assert Scene.open(rendered_copy).find_changed_files() == []
    stereo = rendered_copy / UNFINISHED / "stereo"
    assert len(list((stereo / "depth_maps").rglob("*.bin"))) == 6
    assert len(list((stereo / "normal_maps").rglob("*.bin"))) == 7
    assert not list(stereo.rglob(".*"))
    written.clear()

    def write_until_tired(workspace: Workspace, name: str, *rest: object) -> None:
        if len(written) == 15 - 6:  # three geometric maps are done
            raise KeyboardInterrupt
        written.append(name)
        write(workspace, name, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Workspace, "write", write_until_tired)
    with pytest.raises(KeyboardInterrupt):
        dense(rendered_copy, size=SIZE)
    assert Scene.open(rendered_copy).find_changed_files() == []  # the scene is as whole as before
    (rendered_copy / UNFINISHED / "stereo" / ".objconnect-abcd1234.partial").write_bytes(b"half")
    written.clear()
    monkeypatch.setattr(Workspace, "write", lambda *a: (written.append(a[1]), write(*a)))

    def full_after_the_last_map(_: Path) -> SimpleNamespace:
        return SimpleNamespace(free=1000 if len(written) == 24 - 15 else 2**40)

    with monkeypatch.context() as patch:
        patch.setattr("objconnect.scene.storage.files.shutil.disk_usage", full_after_the_last_map)
        with pytest.raises(WriteError, match="dense.*fused.* are needed"):
            dense(rendered_copy, size=SIZE)
    dense(rendered_copy, size=SIZE)
    assert len(written) == 24 - 15
    assert digests(rendered_copy) == digests(undisturbed.path)


def test_a_finished_run_is_measured_again(scene_and_report: tuple[Scene, DenseReport]) -> None:
    scene, report = scene_and_report
    before = digests(scene.path)
    again = dense(scene.path, size=SIZE)
    assert digests(scene.path) == before
    assert again.accuracy == report.accuracy
    assert again.cpu_seconds_per_map is None


def test_a_photograph_that_changed_is_looked_at_again(
    scene_and_report: tuple[Scene, DenseReport], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(shutil.copytree(scene_and_report[0].path, tmp_path / "copy"))
    name = Scene.open(path).sparse_map().names[3]
    photograph = path / "sessions" / name
    shutil.copyfile(path / "sessions" / Scene.open(path).sparse_map().names[0], photograph)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(
        "objconnect.mapping.dense.command._write_model", stop
    )  # the photographs are written by then
    with pytest.raises(KeyboardInterrupt):
        dense(path, size=SIZE)
    camera = Scene.open(path).sparse_map().images[name].camera
    wanted = tmp_path / "wanted.jpg"
    write_undistorted(photograph, camera, pinhole_of(camera, SIZE), wanted)
    assert (Workspace(path / UNFINISHED).images / name).read_bytes() == wanted.read_bytes()


def test_sources_cover_the_picture(rendered: Scene) -> None:
    sparse_map = straighten(rendered)
    name = sparse_map.names[5]
    seeds = find_seeds(sparse_map, name)
    w, h = sparse_map.images[name].camera.width, sparse_map.images[name].camera.height
    assert len(seeds) > 20
    assert (seeds >= 0).all()
    assert (seeds[:, :2] <= [w, h]).all()
    chosen = choose_sources(sparse_map, name, seeds, 4)
    assert len(set(chosen)) == 4
    assert name not in chosen
    world = sparse_map.images[name].pose.inverse()
    rays, _ = sparse_map.images[name].camera.unproject(torch.from_numpy(seeds[:, :2]))
    points = world.transform(rays / torch.from_numpy(seeds[:, 2:]))
    seen = np.zeros(len(seeds))
    for other in (sparse_map.images[n] for n in chosen):
        projected = other.camera.project(other.pose.transform(points))
        seen += (projected.valid & other.camera.contains(projected.xy)).numpy()
    assert (seen >= 2).mean() > 0.9


def test_added_points_are_seeds_too(rendered: Scene) -> None:
    """A point that no photograph observes seeds every picture it falls into."""
    sparse_map = straighten(rendered)
    name = sparse_map.names[5]
    image = sparse_map.images[name]
    ahead = np.linalg.inv(image.cam_from_world) @ [0, 0, 70, 1]
    more = SparseMap(
        sparse_map.images,
        np.vstack([sparse_map.xyz, ahead[:3]]),
        np.vstack([sparse_map.rgb, [[0, 0, 0]]]).astype(np.uint8),
        np.append(sparse_map.error, 0),
        np.append(sparse_map.track_length, 0),
    )
    before, after = find_seeds(sparse_map, name), find_seeds(more, name)
    assert len(after) == len(before) + 1
    assert np.allclose(after[-1], [*image.camera.principal, 1 / 70])


def straighten(scene: Scene) -> SparseMap:
    sparse_map = scene.sparse_map()
    cameras = {i.camera: pinhole_of(i.camera, 4000) for i in sparse_map.images.values()}
    return undistort_map(sparse_map, cameras)


def test_the_options_are_recorded(tmp_path: Path) -> None:
    """A folder made before they were recorded counts as made with the defaults.

    Later ones record them as a part of what are constants now.
    """
    before = {"map": "sha256", "size": 96}
    key = {**before, "options": DenseOptions().model_dump(mode="json"), "device": "cpu"}
    other = DenseOptions(confirmed=3).model_dump(mode="json")
    (tmp_path / KEY_FILE).write_text(json.dumps(before))
    assert _resumable(tmp_path, key).has_same_request()
    (tmp_path / KEY_FILE).write_text(
        json.dumps({**before, "options": {"agreement": key["options"]}})
    )
    assert _resumable(tmp_path, key).has_same_request()
    assert not _resumable(tmp_path, {**key, "options": other}).has_same_request()
    assert not _resumable(tmp_path, {**key, "device": "cuda:0"}).has_same_request()
    assert not _resumable(tmp_path, {**key, "size": 97}).has_same_request()
    (tmp_path / KEY_FILE).write_text('{"map"')
    assert not _resumable(tmp_path, key).has_same_request()


def test_two_runs_do_not_write_one_cloud(rendered_copy: Path) -> None:
    with write_lock(rendered_copy), pytest.raises(InputError, match="another run is writing"):
        dense(rendered_copy)


def test_no_map_is_one_line(rendered_copy: Path) -> None:
    shutil.rmtree(rendered_copy / "map")
    with pytest.raises(InputError, match="has no map yet: run 'objconnect map"):
        dense(rendered_copy)
    assert not (rendered_copy / UNFINISHED).exists()


def test_a_map_of_one_photograph_is_one_line(rendered_copy: Path) -> None:
    scene = Scene.open(rendered_copy)
    sparse_map = scene.sparse_map()
    image = sparse_map.images[sparse_map.names[0]]
    one = PosedImage(image.name, image.camera, image.cam_from_world)
    write_with_poses([one], sparse_map, scene.map_path)
    with pytest.raises(InputError, match="no photograph of the map .* fly with more overlap"):
        dense(rendered_copy)
    assert not (rendered_copy / UNFINISHED).exists()


def test_a_damaged_photograph_is_named(rendered_copy: Path) -> None:
    name = Scene.open(rendered_copy).sparse_map().names[3]
    photograph = rendered_copy / "sessions" / name
    photograph.write_bytes(photograph.read_bytes()[:4000])
    with pytest.raises(InputError, match=f"{photograph} is damaged"):
        dense(rendered_copy, size=SIZE)


def test_a_damaged_map_is_named(scene_and_report: tuple[Scene, DenseReport]) -> None:
    """COLMAP's fusion would end the process."""
    scene, _ = scene_and_report
    copy = scene.path.with_name("damaged")
    shutil.copytree(scene.path, copy)
    damaged = next((copy / DENSE / "stereo" / "depth_maps").rglob("*.geometric.bin"))
    damaged.write_bytes(damaged.read_bytes()[:100])
    with pytest.raises(InputError, match=f"{damaged.name} is damaged: remove it and run dense"):
        dense(copy, size=SIZE)


def test_colmap_without_cuda_is_one_line(rendered_copy: Path) -> None:
    import pycolmap

    if pycolmap.has_cuda:
        pytest.skip("this pycolmap has CUDA")
    with pytest.raises(InputError, match="needs pycolmap with CUDA"):
        dense(rendered_copy, size=SIZE, stereo="colmap")
