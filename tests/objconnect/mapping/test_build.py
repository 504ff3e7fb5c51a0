"""A map triangulated from a rendered flight lies on the rendered surface."""

from __future__ import annotations

import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.mapping.build import build_map, choose_pairs
from objconnect.mapping.class_coverage import class_coverage
from objconnect.mapping.report import MapReport
from objconnect.scene.bundle.scene import FEATURES, Scene
from objconnect.scene.errors import InputError
from objconnect.scene.maps.features import read_features
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.locks import write_lock

pytestmark = pytest.mark.usefixtures("extracted_once")


def test_map_of_a_rendered_flight(rendered: Scene) -> None:
    sparse_map = rendered.sparse_map()
    assert set(sparse_map.images) == set(rendered.splits.map)
    assert len(sparse_map.xyz) > 300
    assert sparse_map.reprojection_error() < 1.0
    frames = rendered.frames("summer-noon-nadir-map")
    for k, name in enumerate(frames.names):
        assert np.allclose(sparse_map.images[name].cam_from_world, frames.cam_from_world[k])
        assert sparse_map.images[name].camera == frames.cameras[k]


def test_points_lie_on_the_surface(rendered: Scene) -> None:
    """Depth of each point in the views that observe it, against the rendered depth there."""
    sparse_map = rendered.sparse_map()
    frames = rendered.frames("summer-noon-nadir-map")
    off = []
    with rendered.layers("summer-noon-nadir-map") as dense:
        for k, name in enumerate(frames.names):
            image = sparse_map.images[name]
            seen = image.point_rows >= 0
            xyz = torch.from_numpy(sparse_map.xyz[image.point_rows[seen]])
            z = image.pose.transform(xyz)[:, 2].numpy()
            columns, rows = np.floor(image.xy[seen]).astype(int).T
            off.append(np.abs(z - dense.read("depth", k)[rows, columns]))
    assert np.median(np.concatenate(off)) < 0.25


def test_features_lie_beside_the_map(rendered: Scene) -> None:
    features = read_features(rendered.map_path / FEATURES)
    sparse_map = rendered.sparse_map()
    assert set(features) == set(sparse_map.images)
    for name, image in sparse_map.images.items():
        assert np.abs(features[name].xy - image.xy).max() < 1e-3


@pytest.fixture(scope="module")
def again(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, MapReport]:
    """The rendered scene, whose damaged map is built again."""
    path = Path(shutil.copytree(rendered.path, tmp_path_factory.mktemp("again") / "hamlet"))
    (path / "map" / "points3D.bin").write_bytes(b"damaged")
    report = build_map(path)
    return Scene.open(path), report


def test_mapping_again_replaces_the_map(rendered: Scene, again: tuple[Scene, MapReport]) -> None:
    scene, _ = again
    assert np.allclose(scene.sparse_map().xyz, rendered.sparse_map().xyz)
    assert scene.find_changed_files() == []


def test_pairs_are_the_overlapping_ones() -> None:
    overlap = np.array([[0, 0.9, 0.1], [0.9, 0, 0.3], [0.1, 0.3, 0]])
    assert choose_pairs(overlap, ["a", "b", "c"]) == [(0, 1), (1, 2)]


def test_frames_that_follow_each_other_need_little_overlap() -> None:
    overlap = np.array([[0, 0.1, 0.1, 0], [0.1, 0, 0.1, 0], [0.1, 0.1, 0, 0.1], [0, 0, 0.1, 0]])
    assert choose_pairs(overlap, ["a", "a", "a", "b"]) == [(0, 1), (0, 2), (1, 2)]


def test_pairs_of_hundreds_of_frames_grow_with_their_number() -> None:
    """A straight line of frames each of which sees a hundred others."""
    place = np.arange(400)
    overlap = np.clip(1 - np.abs(place[:, None] - place) / 60, 0, 1) - np.eye(400)
    pairs = choose_pairs(overlap, ["line"] * 400)
    assert 400 * 10 <= len(pairs) <= 400 * 20
    assert {(k, k + 1) for k in range(399)} < set(pairs)


def test_two_runs_do_not_write_one_map(rendered_copy: Path) -> None:
    with write_lock(rendered_copy), pytest.raises(InputError, match="another run is writing"):
        build_map(rendered_copy)


def test_a_damaged_photograph_keeps_the_old_map(rendered_copy: Path) -> None:
    before = Scene.open(rendered_copy).sparse_map()
    photograph = rendered_copy / "sessions" / before.names[3]
    photograph.write_bytes(photograph.read_bytes()[:4000])
    with pytest.raises(InputError, match=f"{photograph} is damaged"):
        build_map(rendered_copy)
    assert Scene.open(rendered_copy).sparse_map().sha256 == before.sha256
    assert not list(rendered_copy.glob(".*"))


def test_structure_from_motion_finds_the_poses(rendered_copy: Path) -> None:
    report = build_map(rendered_copy, "sfm")
    assert report.registered == report.images == 12
    assert report.reprojection_error_px < 1.0
    assert 0 < report.position_m.mean <= report.position_m.rms <= report.position_m.max < 0.2
    assert 0 < report.rotation_deg.mean <= report.rotation_deg.rms < 0.2
    scene = Scene.open(rendered_copy)
    assert scene.find_changed_files() == []
    cameras = set(scene.frames("summer-noon-nadir-map").cameras)
    assert {image.camera for image in scene.sparse_map().images.values()} == cameras
    assert scene.sparse_map().reprojection_error() == report.reprojection_error_px


def test_report_of_a_triangulated_map(again: tuple[Scene, MapReport]) -> None:
    scene, report = again
    assert report.points == len(scene.sparse_map().xyz)
    # Poses went into COLMAP's file as quaternions and came back.
    assert report.position_m.max < 1e-9
    assert report.rotation_deg.max < 1e-9
    assert sum(c.seen for c in report.objects.values()) <= len(scene.objects.objects)
    small = report.small_objects.values()
    assert sum(c.seen for c in small) == report.objects["small"].seen > 0
    assert sum(c.points for c in small) == report.objects["small"].points
    assert report.pairs <= 12 * 11 // 2
    for coverage in report.objects.values():
        assert coverage.with_points <= min(coverage.seen, coverage.points)
    assert report.objects["medium"].points > 20
    assert f"{report.points} points" in report.text()


def digests_of(scene: Path) -> dict[str, str]:
    return {path.name: sha256_of(path) for path in sorted((scene / "map").iterdir())}


# The command line, killed as soon as the first ten pairs are verified.
KILLS_ITSELF = """
import os, signal
from benchmark import cli
from objconnect.scene.colmap import database

verify = database.pycolmap.verify_matches

def verify_ten(*arguments):
    verify(*arguments)
    os.kill(os.getpid(), signal.SIGKILL)

database._PAIR_CHUNK = 10
database.pycolmap.verify_matches = verify_ten
cli.main()
"""


def start(
    scene: Path, method: str, program: Sequence[str] = ("-m", "benchmark.cli")
) -> subprocess.Popen[bytes]:
    command = [sys.executable, *program, "map", str(scene), "--method", method]
    return subprocess.Popen(command)


@pytest.fixture(scope="module")
def finished(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Digests of the map by structure from motion of an undisturbed run."""
    path = shutil.copytree(rendered.path, tmp_path_factory.mktemp("finished") / "hamlet")
    build_map(path, "sfm")
    assert not list(path.glob(".*"))
    return digests_of(path)


@pytest.mark.thorough
def test_killed_while_matching_and_resumed_is_the_same_map(
    rendered: Scene, rendered_copy: Path, finished: dict[str, str]
) -> None:
    killed = start(rendered_copy, "sfm", ("-c", KILLS_ITSELF))
    assert killed.wait() == -signal.SIGKILL
    # The old map is still there.
    assert digests_of(rendered_copy) == digests_of(rendered.path)
    assert verified_pairs(rendered_copy) == 10
    build_map(rendered_copy, "sfm")
    assert digests_of(rendered_copy) == finished
    assert Scene.open(rendered_copy).find_changed_files() == []
    assert not list(rendered_copy.glob(".*"))


def verified_pairs(scene: Path) -> int:
    """Pairs that an interrupted run would not match again."""
    databases = list(scene.glob(".objconnect-mapping/*.db"))
    try:
        with closing(sqlite3.connect(f"file:{databases[0]}?mode=ro", uri=True)) as connection:
            return int(connection.execute("SELECT count(*) FROM two_view_geometries").fetchone()[0])
    except (IndexError, sqlite3.OperationalError):
        return 0


@pytest.mark.slow
def test_killed_at_ten_random_moments_is_the_same_map(
    rendered_copy: Path, finished: dict[str, str]
) -> None:
    rng = np.random.default_rng(0)
    kills = 0
    while kills < 10:
        child = start(rendered_copy, "sfm")
        try:
            assert child.wait(timeout=rng.uniform(1.0, 14.0)) == 0
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            kills += 1
            continue
        assert digests_of(rendered_copy) == finished
    build_map(rendered_copy, "sfm")
    assert digests_of(rendered_copy) == finished
    assert not list(rendered_copy.glob(".*"))


@pytest.mark.thorough
def test_what_an_interrupted_run_kept_may_be_damaged_or_of_other_photographs(
    rendered_copy: Path, finished: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("objconnect.mapping.build.write_features", interrupt)
    with pytest.raises(KeyboardInterrupt):
        build_map(rendered_copy, "triangulate")
    monkeypatch.undo()
    (database,) = (rendered_copy / ".objconnect-mapping").glob("*.db")
    whole = database.read_bytes()
    database.write_bytes(whole[:5000] + b"damaged" * 2000 + whole[19000:])
    (rendered_copy / ".objconnect-mapping" / "0123456789abcdef.db").write_bytes(whole)
    build_map(rendered_copy, "sfm")
    assert digests_of(rendered_copy) == finished
    assert not list(rendered_copy.glob(".*"))


def test_keypoints_spread_over_surfaces_as_pixels_do(rendered: Scene) -> None:
    features = read_features(rendered.map_path / FEATURES)
    spread = class_coverage(rendered, rendered.sparse_map(), features)
    for share in ("pixels", "keypoints", "points"):
        assert sum(getattr(s, share) for s in spread.values()) == pytest.approx(1)
    for kind in ("ground", "buildings", "vegetation"):
        assert 0.5 < spread[kind].keypoints / spread[kind].pixels < 2, (kind, spread[kind])
    assert spread["buildings"].points > 0


def test_shares_are_of_what_the_pixels_show(rendered: Scene) -> None:
    """Buildings counted by instance instead of by label, keypoint by keypoint."""
    features = read_features(rendered.map_path / FEATURES)
    spread = class_coverage(rendered, rendered.sparse_map(), features)
    built = [o.id for o in rendered.objects.objects if o.class_name == "building"]
    pixels, keypoints = [], []
    session = "summer-noon-nadir-map"
    with rendered.layers(session) as dense:
        for k, name in enumerate(rendered.frames(session).names):
            instance = dense.read("instance", k)
            pixels.append(np.isin(instance, built).mean())
            keypoints += [instance[int(y), int(x)] in built for x, y in features[name].xy]
    assert spread["buildings"].pixels == pytest.approx(np.mean(pixels))
    assert spread["buildings"].keypoints == pytest.approx(np.mean(keypoints))
