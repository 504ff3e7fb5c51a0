"""Published flights: the same data set, and exact projections as others load them."""

from __future__ import annotations

import json
from pathlib import Path

import datasets
import numpy as np
import pytest
import torch

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.identity import describe_changes
from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import gate_scene
from benchmark.publishing.command import publish
from benchmark.publishing.description import Release
from benchmark.publishing.index import INDEX
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import read_model
from tests.benchmark.made_data import write_flight

STATED = Release(license="CC-BY-4.0")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The gate scene in snow, and beside it the scene published."""
    folder = tmp_path_factory.mktemp("town")
    gate_scene(folder / "town", "gate-snow")
    publish([folder / "town"], folder / "published", release=STATED)
    return folder


def require_equal(ours: Dataset, theirs: Dataset) -> None:
    assert describe_changes(ours.parts, theirs.parts) == ""
    assert (ours.name, ours.track, ours.sha256) == (theirs.name, theirs.track, theirs.sha256)
    assert ours.map_conditions == theirs.map_conditions
    assert ours.courses == theirs.courses
    assert ours.unjudged == theirs.unjudged
    for one, other in zip(ours.queries, theirs.queries, strict=True):
        assert (one.name, one.condition, one.group) == (other.name, other.condition, other.group)


def test_it_is_the_data_set_of_the_flight(town: Path) -> None:
    (ours,), (theirs,) = open_datasets(town / "town"), open_datasets(town / "published")
    require_equal(ours, theirs)
    assert {query.condition for query in theirs.queries} == {"summer-noon", "snow-dusk"}


def test_points_project_as_colmap_recorded(town: Path, tmp_path: Path) -> None:
    """With loaded poses and cameras, each point has the reprojection error of its record."""
    published = town / "published"
    loaded = datasets.load_dataset(str(published), split="map", cache_dir=str(tmp_path))
    sparse_map = read_model(published / "scenes/town/map")
    total, count = np.zeros(len(sparse_map.xyz)), np.zeros(len(sparse_map.xyz))
    for row in loaded.remove_columns("image"):
        image = sparse_map.images[row["name"]]
        seen = image.point_rows[image.point_rows >= 0]
        camera = Camera(
            row["camera_model"], row["width"], row["height"], tuple(row["camera_params"])
        )
        points = Pose.from_matrix(np.array(row["cam_from_world"])).transform(
            torch.from_numpy(sparse_map.xyz[seen])
        )
        pixels = camera.project(points).xy.numpy()
        np.add.at(total, seen, np.linalg.norm(pixels - image.xy[image.point_rows >= 0], axis=1))
        np.add.at(count, seen, 1)
    assert np.array_equal(count, sparse_map.track_length)
    assert np.abs(total / count - sparse_map.error).max() < 1e-9


def test_a_flight_with_a_hard_split_is_two(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / "meadow")
    for name in ("queries", "reference_poses"):
        hard = (flight / f"{name}.txt").read_text()
        (flight / f"{name}_sparse.txt").write_text(hard)
    (flight / "sparse/map").rename(flight / "sparse/map_sparse")
    write_flight(tmp_path / "other")
    (tmp_path / "other/sparse/map").rename(flight / "sparse/map")
    report = publish([flight], tmp_path / "out", release=STATED)
    assert report.scenes == ("meadow", "meadow-sparse")
    for ours, theirs in zip(open_datasets(flight), open_datasets(tmp_path / "out"), strict=True):
        require_equal(ours, theirs)


def test_the_card_says_what_a_flight_does_not_tell(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / "meadow")
    error = {"metres": 0.2, "source": "measured"}
    (flight / "reference_error.json").write_text(json.dumps(error))
    (ours,) = open_datasets(flight)
    publish([flight], tmp_path / "out", release=STATED)
    card = (tmp_path / "out/README.md").read_text()
    assert "which do not record how they were made" in card
    assert "Poses and cameras are those that the files of the flight state." in card
    assert ours.unjudged
    assert f"too inexact to score at {', '.join(ours.unjudged)}." in card
    require_equal(ours, open_datasets(tmp_path / "out")[0])


def test_a_flight_needs_a_licence_and_has_no_layers(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / "meadow")
    with pytest.raises(InputError, match="meadow may show a real site: state the licence"):
        publish([flight], tmp_path / "out")
    with pytest.raises(InputError, match="meadow has no layers: leave out --layer"):
        publish([flight], tmp_path / "out", layers=["depth"], release=STATED)


def test_a_prior_that_no_row_can_hold_is_refused(tmp_path: Path) -> None:
    """Without positions of the map's photographs, the accuracy of the others is unknown."""
    flight = write_flight(tmp_path / "meadow")
    rows = (flight / "gps.csv").read_text().splitlines(keepends=True)
    (flight / "gps.csv").write_text("".join(row for row in rows if ",map," not in row))
    with pytest.raises(InputError, match=r"the prior of \S+ cannot be published: give sigmas"):
        publish([flight], tmp_path / "out", release=STATED)
    assert not (tmp_path / "out").exists()


def test_a_condition_that_no_session_has_is_refused(town: Path, tmp_path: Path) -> None:
    index = json.loads((town / "published" / INDEX).read_text())
    index["scenes"][0]["sessions"]["town"]["conditions"] = ["summer-noon"]
    changed = tmp_path / "published"
    changed.mkdir()
    for part in ("data", "scenes"):
        (changed / part).symlink_to(town / "published" / part)
    (changed / INDEX).write_text(json.dumps(index))
    with pytest.raises(InputError, match="belongs to no session"):
        open_datasets(changed)
