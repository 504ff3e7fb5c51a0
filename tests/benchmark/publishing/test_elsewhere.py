"""Published folders as datasets, mlcroissant and the hub's client read them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import datasets
import mlcroissant
import numpy as np
import pytest
import torch
from huggingface_hub import DatasetCard

from benchmark.publishing.columns import COLUMNS
from benchmark.publishing.command import publish
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from tests.benchmark.publishing.conftest import STATED


@pytest.fixture
def loaded(rendered: Scene, tmp_path: Path) -> Any:
    """A rendered scene, published and loaded by ``datasets``."""
    publish([rendered.path], tmp_path / "out", layers=["depth"], release=STATED)
    return datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "loaded"))


def frames_of(scene: Scene) -> Iterator[tuple[str, Camera, np.ndarray[Any, Any]]]:
    for session in scene.sessions:
        frames = scene.frames(session)
        yield from zip(frames.names, frames.cameras, frames.cam_from_world, strict=True)


def test_photographs_poses_and_cameras_are_exact(loaded: Any, rendered: Scene) -> None:
    xyz = torch.from_numpy(rendered.sparse_map().xyz)
    known = {name: (camera, pose) for name, camera, pose in frames_of(rendered)}
    raw = loaded.cast_column("image", datasets.Image(decode=False))
    rows = [row for split in ("map", "query") for row in raw[split]]
    assert {row["name"] for row in rows} == set(known)
    for row in rows:
        photograph = (rendered.images_root / row["name"]).read_bytes()
        assert row["image"]["bytes"] == photograph
        camera, pose = known[row["name"]]
        published = Camera(
            row["camera_model"], row["width"], row["height"], tuple(row["camera_params"])
        )
        assert published == camera
        assert np.array_equal(np.array(row["cam_from_world"]), pose)
        ours = camera.project(Pose.from_matrix(pose).transform(xyz))
        theirs = published.project(Pose.from_matrix(np.array(row["cam_from_world"])).transform(xyz))
        seen = ours.valid
        assert seen.any()
        assert torch.equal(seen, theirs.valid)
        assert (ours.xy[seen] - theirs.xy[seen]).abs().max() < 1e-6


def test_pictures_are_decoded(loaded: Any) -> None:
    row = loaded["query"][0]
    assert row["image"].size == (row["width"], row["height"])
    depth = np.asarray(row["depth"])
    assert depth.dtype == np.float32
    assert depth.shape == (row["height"], row["width"])
    assert 10 < np.median(depth[depth > 0]) < 500


def test_one_of_several_scenes_can_be_loaded(hamlet: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        shutil.copytree(hamlet, tmp_path / "scenes" / name)
    publish([tmp_path / "scenes"], tmp_path / "out")
    options = {"split": "query", "cache_dir": str(tmp_path / "loaded")}
    every = datasets.load_dataset(str(tmp_path / "out"), **options)
    one = datasets.load_dataset(str(tmp_path / "out"), "b", **options)
    assert every["scene"][:] == ["a"] * 6 + ["b"] * 6
    assert one["scene"][:] == ["b"] * 6


def test_croissant_is_valid_and_complete(published: Path) -> None:
    read = mlcroissant.Dataset(str(published / "croissant.json"))
    assert not read.metadata.issues.errors
    assert not read.metadata.issues.warnings
    text = json.loads((published / "croissant.json").read_text())
    assert text["conformsTo"] == [
        "http://mlcommons.org/croissant/1.1",
        "http://mlcommons.org/croissant/RAI/1.0",
    ]
    metadata = read.metadata
    assert metadata.license == ["https://creativecommons.org/licenses/by/4.0/"]
    assert (metadata.name, metadata.url, metadata.version) == ("published", STATED.url, "1.0.0")
    for value in (
        metadata.data_collection,
        metadata.data_annotation_protocol,
        metadata.data_preprocessing_protocol,
        metadata.data_limitations,
        metadata.data_biases,
        metadata.data_use_cases,
        metadata.data_social_impact,
        metadata.personal_sensitive_information,
        metadata.data_release_maintenance_plan,
    ):
        assert value


def test_mlcroissant_reads_the_records(published: Path, hamlet: Path) -> None:
    read = mlcroissant.Dataset(str(published / "croissant.json"))
    records = {r["photographs/name"].decode(): r for r in read.records("photographs")}
    assert len(records) == 9
    for name, camera, pose in frames_of(Scene.open(hamlet)):
        record = records[name]
        assert {key.removeprefix("photographs/") for key in record} == set(COLUMNS)
        assert record["photographs/image"].size == (camera.width, camera.height)
        assert np.array_equal(np.stack(record["photographs/cam_from_world"]), pose)


def test_a_wrong_file_in_croissant_is_noticed(published: Path) -> None:
    """The check of the metadata can fail."""
    text = json.loads((published / "croissant.json").read_text())
    del text["distribution"][0]["contentUrl"]
    (published / "croissant.json").write_text(json.dumps(text))
    with pytest.raises(mlcroissant.ValidationError):
        mlcroissant.Dataset(str(published / "croissant.json"))


def test_the_hub_reads_the_card(published: Path) -> None:
    card = DatasetCard.load(published / "README.md")
    card.data.to_dict()
    assert card.data.license == "cc-by-4.0"
    assert card.data.size_categories == ["n<1K"]
    for heading in ("Use", "How it was made", "Cost", "Licence", "Limits", "Intended use"):
        assert f"## {heading}\n" in card.text
    assert "$" not in card.text.replace("$ ", "")
    assert "![hamlet](pictures/hamlet.jpg)" in card.text
