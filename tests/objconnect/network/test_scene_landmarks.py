"""The objects of a scene's map, kept with the scene: what is written, read, drawn and refused."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from benchmark.datasets.open import open_datasets
from benchmark.report.view import view
from objconnect.learning.checkpoint import write_weights
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.network import ObjConnectNet
from objconnect.network.scene_landmarks import LANDMARKS, find_landmarks, read_landmarks
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError


@pytest.fixture(scope="module")
def found(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the rendered scene with its landmarks."""
    path = Path(shutil.copytree(rendered.path, tmp_path_factory.mktemp("found") / "hamlet"))
    find_landmarks(path, out=table_of(path))
    return path


def table_of(scene: Path) -> Path:
    """The table that is written with the landmarks."""
    return scene.parent / "objects.csv"


def test_landmarks_are_kept_with_the_scene(found: Path) -> None:
    scene = Scene.open(found)
    assert scene.find_changed_files() == []
    assert LANDMARKS in scene.manifest.sha256
    kept = read_landmarks(scene, scene.sparse_map())
    assert kept is not None
    landmarks, tracks = kept
    assert len(landmarks) > 5
    assert len(tracks.landmark) == landmarks.views.sum()
    assert set(tracks.name) <= set(scene.sparse_map().names)


def test_tracks_lie_where_the_photographs_show_the_landmarks(found: Path) -> None:
    scene = Scene.open(found)
    sparse_map = scene.sparse_map()
    kept = read_landmarks(scene, sparse_map)
    assert kept is not None
    landmarks, tracks = kept
    away = []
    for row, name, xy in zip(tracks.landmark.tolist(), tracks.name, tracks.xy, strict=True):
        image = sparse_map.images[name]
        seen = image.camera.project(
            image.pose.transform(torch.from_numpy(landmarks.xyz[row][None]))
        )
        away.append(np.linalg.norm(seen.xy[0].numpy() - xy))
    # Centres are medians of those of the photographs, which guess heights.
    assert np.median(away) < 6


def test_results_of_before_can_be_compared(rendered: Scene, found: Path) -> None:
    (before,) = open_datasets(rendered.path)
    (after,) = open_datasets(found)
    assert before.sha256 == after.sha256


def test_a_table_is_written_and_replaced(found: Path, tmp_path: Path) -> None:
    table = Path(shutil.copy(table_of(found), tmp_path / "objects.csv"))
    report = find_landmarks(found, out=table)
    assert table.read_bytes() == table_of(found).read_bytes()
    with table.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(report.landmarks)
    np.testing.assert_allclose(float(rows[0]["e"]), report.landmarks.xyz[0, 0], atol=0.01)
    assert int(rows[0]["photographs"]) == report.landmarks.views[0]
    assert str(table) in report.text()
    table.write_text("mine\n")
    with pytest.raises(InputError, match="objects.csv"):
        find_landmarks(found, out=table)
    assert table.read_text() == "mine\n"


def test_the_table_does_not_replace_the_objects(rendered_copy: Path) -> None:
    with pytest.raises(InputError, match="would be written twice"):
        find_landmarks(rendered_copy, out=rendered_copy / LANDMARKS)
    assert not (rendered_copy / LANDMARKS).exists()


def test_objects_are_drawn(found: Path, tmp_path: Path) -> None:
    drawn = view(found, out=tmp_path / "page.html")
    scene = Scene.open(found)
    kept = read_landmarks(scene, scene.sparse_map())
    assert kept is not None
    assert drawn.points["landmarks"] == len(kept[0])
    assert '"landmarks"' in drawn.page.read_text()


def test_objects_of_another_map_are_none(found: Path) -> None:
    scene = Scene.open(found)
    sparse_map = scene.sparse_map()
    other = replace(sparse_map, xyz=sparse_map.xyz + 1)
    assert read_landmarks(scene, other) is None


def test_a_damaged_file_is_named(found: Path, tmp_path: Path) -> None:
    scene = Scene.open(found)
    kept = (found / LANDMARKS).read_bytes()
    try:
        for damage in (b"nothing", kept[: len(kept) // 2]):
            (found / LANDMARKS).write_bytes(damage)
            with pytest.raises(InputError, match="landmarks.h5 is damaged"):
                read_landmarks(scene, scene.sparse_map())
        (found / LANDMARKS).write_bytes(kept)
        with h5py.File(found / LANDMARKS, "a") as file:
            del file["sides"]
            file["sides"] = np.zeros(2)
        with pytest.raises(InputError, match="different lengths"):
            read_landmarks(scene, scene.sparse_map())
    finally:
        (found / LANDMARKS).write_bytes(kept)


def test_a_network_without_a_detector_finds_none(found: Path, tmp_path: Path) -> None:
    plain = ObjConnectNetConfig(width=0.125)
    write_weights(tmp_path / "plain.safetensors", ObjConnectNet(plain), plain.model_dump())
    with pytest.raises(InputError, match="no detector of objects"):
        find_landmarks(found, tmp_path / "plain.safetensors")
