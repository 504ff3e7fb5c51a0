"""A simulated street in the tree of Extended CMU Seasons, read back by the benchmark's reader."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.datasets.cmu import open_cmu
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from objconnect.scene.bundle.frames import Frames, read_frames, write_frames
from objconnect.scene.bundle.manifest import (
    Manifest,
    Objects,
    Session,
    Splits,
    Surroundings,
    read_json,
    write_json,
)
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.digests import sha256_of
from tests.benchmark.made_data import pose_at, write_jpeg

LEFT = Camera("OPENCV", 96, 64, (81.0, 80.5, 48.5, 35.0, -0.399, 0.189, 0.0002, 0.0006))
RIGHT = Camera("OPENCV", 96, 64, (82.0, 82.5, 49.0, 33.1, -0.397, 0.182, 0.0002, -0.0006))
SUMMER, WINTER = (datetime(y, m, d, 11, tzinfo=UTC) for y, m, d in ((2025, 7, 2), (2026, 1, 20)))
SESSIONS = {
    "map-left": (LEFT, SUMMER),
    "map-right": (RIGHT, SUMMER),
    "summer-left": (LEFT, SUMMER),
    "winter-right": (RIGHT, WINTER),
}
# Cameras stand at -12, -8, ... 8 m east: two of every session in each.
PARTS = (("urban", -50, -6), ("suburban", -6, 2), ("park", 2, 50))
SLICES = {"urban": 2, "suburban": 9, "park": 18}


def strip(name: str, west: float, east: float) -> Surroundings:
    return Surroundings(
        name=name, outline=((west, -50), (east, -50), (east, 10.1), (east, 50), (west, 50))
    )


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """A scene of four sessions: two cameras mapping in summer, a query drive in each season."""
    path = tmp_path / "street"
    poses = [pose_at(k) for k in range(6)]
    points = np.random.default_rng(1).uniform([-30, -15, -1], [30, 15, 1], (400, 3))
    mapped = {}
    for number, (session, (camera, start)) in enumerate(SESSIONS.items()):
        names = tuple(f"{session}/images/{k:06d}.jpg" for k in range(6))
        for k, name in enumerate(names):
            write_jpeg(path / "sessions" / name, 10 * number + k)
            if session.startswith("map"):
                projected = camera.project(poses[k].transform(torch.from_numpy(points)))
                seen = (projected.valid & camera.contains(projected.xy)).numpy()
                matrix = poses[k].matrix().numpy()
                xy, rows = projected.xy.numpy()[seen], np.flatnonzero(seen)
                mapped[name] = MapImage(name, camera, matrix, xy, rows)
        frames = Frames(
            names=names,
            cameras=(camera,) * 6,
            cam_from_world=np.array([pose.matrix().numpy() for pose in poses]),
            time=start.timestamp() + 2.0 * np.arange(6),
            gps_prior=np.zeros((6, 3)),
            gps_sigma=np.ones((6, 3)),
            attitude_prior=np.tile([1.0, 0, 0, 0], (6, 1)),
            attitude_sigma_deg=np.ones(6),
        )
        write_frames(path / "sessions" / session / "frames.h5", frames, (), iter(()))
    grey, zero = np.full((400, 3), 90, np.uint8), np.zeros(400)
    (path / "map").mkdir()
    write_with_poses(
        [PosedImage(i.name, i.camera, i.cam_from_world) for i in mapped.values()],
        SparseMap(mapped, points, grey, zero, zero.astype(np.int64)),
        path / "map",
    )
    parts = tuple(strip(*part) for part in PARTS)
    write_json(path / "objects.json", Objects(classes={}, objects=(), surroundings=parts))
    queries = {s: tuple(f"{s}/images/{k:06d}.jpg" for k in range(6)) for s in SESSIONS}
    references = tuple(name for s in ("map-left", "map-right") for name in queries.pop(s))
    write_json(path / "splits.json", Splits(map=references, queries=queries))
    manifest = Manifest(
        versions={}, preset="street", seed=7, config={}, origin=Geodetic(47.0, 8.0, 400.0),
        sessions={
            s: Session(condition="", flight="street", role="map" if "map" in s else "query")
            for s in SESSIONS
        },
        sha256={},
    )  # fmt: skip
    finish_scene(path, manifest)
    return path


@pytest.fixture
def tree(street: Path, tmp_path: Path) -> Path:
    out = tmp_path / "tree"
    assert export(street, "cmu", out)["frames"] == 24
    return out


def frame_of(street: Path, dataset: Dataset, photograph: Path) -> tuple[Frames, int, str]:
    """The frame of the scene that a photograph of the tree is."""
    digest = sha256_of(photograph)
    for session in SESSIONS:
        frames = read_frames(street / "sessions" / session / "frames.h5")
        for k, name in enumerate(frames.names):
            if sha256_of(street / "sessions" / name) == digest:
                return frames, k, session
    raise AssertionError(f"{photograph} of {dataset.name} is not a frame")


def test_the_reader_takes_it_as_the_real_set(tree: Path) -> None:
    datasets = open_datasets(tree)
    assert [d.name for d in datasets] == [
        "cmu-urban-slice2", "cmu-suburban-slice9", "cmu-park-slice18",
    ]  # fmt: skip
    for dataset in datasets:
        # But for one thing: figures on it must not pass for figures on the real set.
        assert dataset.track == "cmu-sim"
        assert len(dataset.load_map().images) == 4
        assert (
            sorted(q.condition for q in dataset.queries) == ["2025-07-02"] * 2 + ["2026-01-20"] * 2
        )
        assert dataset.map_conditions == ("2025-07-02",)


def test_files_are_those_of_the_download(tree: Path) -> None:
    for number in SLICES.values():
        folder = tree / f"slice{number}"
        assert {item.name for item in folder.iterdir()} == {
            "database", "query", "sparse", "camera-poses",
            f"ground-truth-database-images-slice{number}.txt", f"test-images-slice{number}.txt",
        }  # fmt: skip
        assert sorted(item.name for item in (folder / "camera-poses").iterdir()) == [
            f"slice-{number}-gt-query-images-{day}.txt" for day in ("20250702", "20260120")
        ]
        listed = (folder / f"test-images-slice{number}.txt").read_text().split()
        assert sorted(listed) == sorted(item.name for item in (folder / "query").iterdir())


def test_every_pose_camera_and_photograph_is_the_scenes(street: Path, tree: Path) -> None:
    """Centres as centres, c1 with the lens of c1, and each in its own surroundings."""
    for dataset, (_, west, east) in zip(open_cmu(tree), PARTS, strict=True):
        for query in dataset.queries:
            frames, k, session = frame_of(street, dataset, query.image)
            metres, degrees = query.reference.error_to(Pose.from_matrix(frames.cam_from_world[k]))
            assert float(metres) < 2e-6
            assert float(degrees) < 2e-4
            assert query.camera == SESSIONS[session][0]
            assert ("_c0_" in query.name) == (query.camera == LEFT)
            assert west < float(query.reference.centre()[0]) < east
        for name, image in dataset.load_map().images.items():
            frames, k, session = frame_of(street, dataset, dataset.images / name)
            assert image.camera == SESSIONS[session][0]
            assert np.abs(image.cam_from_world - frames.cam_from_world[k]).max() < 1e-9


def test_maps_are_of_their_slice_alone(tree: Path) -> None:
    for dataset in open_cmu(tree):
        sparse_map = dataset.load_map()
        assert len(sparse_map.xyz) > 50
        assert sparse_map.track_length.min() >= 2
        assert sparse_map.track_length.max() <= 4
        # Pixels are COLMAP's on both sides: half a pixel off would show here.
        assert sparse_map.reprojection_error() < 1e-6


def test_ground_truth_of_the_database_holds_centres(tree: Path) -> None:
    for dataset in open_cmu(tree):
        folder = dataset.images.parent
        lines = (folder / f"ground-truth-database-images-{folder.name}.txt").read_text()
        images = dataset.load_map().images
        assert len(lines.splitlines()) == len(images)
        for line in lines.splitlines():
            name, *numbers = line.split()
            assert np.abs(np.array(numbers[4:], float) - images[name].centre).max() < 1e-6


def broken(street: Path, tmp_path: Path, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        export(street, "cmu", tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_place_without_surroundings_is_refused(street: Path, tmp_path: Path) -> None:
    write_json(street / "objects.json", Objects(classes={}, objects=()))
    broken(street, tmp_path, "taken in no urban, suburban or park part: .*--preset street")


def test_a_tree_has_two_cameras(street: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two cameras, c0 and c1, and these sessions have 1"):
        export(street, "cmu", tmp_path / "out", ["map-left", "summer-left"])
    for session, camera in (("map-left", LEFT), ("map-right", RIGHT)):
        path = street / "sessions" / session / "frames.h5"
        fisheye = Camera("OPENCV_FISHEYE", 96, 64, camera.params)
        frames = dataclasses.replace(read_frames(path), cameras=(fisheye,) * 6)
        write_frames(path, frames, (), iter(()))
    with pytest.raises(InputError, match="cannot hold a fisheye"):
        export(street, "cmu", tmp_path / "out", ["map-left", "map-right"])


def test_a_tree_holds_four_coefficients(street: Path, tmp_path: Path) -> None:
    path = street / "sessions" / "map-left" / "frames.h5"
    full = Camera("FULL_OPENCV", 96, 64, (*LEFT.params, 0.01, 0.0, 0.0, 0.0))
    write_frames(path, dataclasses.replace(read_frames(path), cameras=(full,) * 6), (), iter(()))
    with pytest.raises(InputError, match="cannot hold k3 of a camera of the model FULL_OPENCV"):
        export(street, "cmu", tmp_path / "out", ["map-left", "map-right"])
    assert not (tmp_path / "out").exists()


def test_a_slice_needs_a_map(street: Path, tmp_path: Path) -> None:
    objects = read_json(street / "objects.json", Objects, "objects")
    parts = (strip("urban", -50, 7), strip("park", 7, 50))
    write_json(street / "objects.json", objects.model_copy(update={"surroundings": parts}))
    (street / "splits.json").write_text(
        (street / "splits.json").read_text().replace('"map-right/images/000005.jpg"', '"none"')
    )
    broken(street, tmp_path, "no point that at least two photographs of its park part see")


def test_a_scene_needs_its_map(street: Path, tmp_path: Path) -> None:
    (street / "map").rename(tmp_path / "elsewhere")
    broken(street, tmp_path, "has no map yet: run 'objconnect map")


def test_points_are_inside_one_of_two_neighbours(street: Path) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform([-40, -40, 0], [40, 40, 5], (500, 3))
    objects = Scene.open(street).objects
    inside = np.array([part.contains(points) for part in objects.surroundings])
    assert (inside.sum(0) == 1).all()
    expected = [next(n for n, west, east in PARTS if west < x < east) for x in points[:, 0]]
    assert objects.surroundings_at(points) == expected
    assert objects.surroundings_at(np.array([[90.0, 0.0]])) == [None]
