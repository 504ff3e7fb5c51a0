from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from PIL import Image

from benchmark.datasets.open import open_datasets
from benchmark.report.album import (
    ALBUM,
    SIDE,
    Album,
    keep_album,
    make_album,
    read_album,
    write_album,
)
from objconnect.scene.errors import InputError
from tests.benchmark.made_data import move, pose_at


@pytest.fixture
def album(made_flight: Path) -> Album:
    (dataset,) = open_datasets(made_flight)
    return make_album(dataset, dataset.load_map())


def test_points_are_where_the_poses_put_them(made_flight: Path, album: Album) -> None:
    (dataset,) = open_datasets(made_flight)
    sparse_map = dataset.load_map()
    entry = album.entries["b.jpg"]
    assert entry.neighbour is not None
    assert len(entry.world) > 8
    assert entry.project_at(dataset.queries[0].reference) == pytest.approx(entry.truth)
    # The world looks west from above by what the camera moves east: 80 px focal length, 40 m up.
    shift = entry.project_at(move(pose_at(1), 0.5)) - entry.truth
    assert shift[:, 0].mean() == pytest.approx(-1.0, abs=0.1)
    assert np.abs(shift[:, 1]).max() < 0.05
    image = sparse_map.images[entry.neighbour]
    rows = [int(np.flatnonzero((sparse_map.xyz == point).all(1))[0]) for point in entry.world]
    observed = {int(row): xy for row, xy in zip(image.point_rows, image.xy, strict=True)}
    assert entry.seen == pytest.approx(np.array([observed[row] for row in rows]))


def test_neighbour_is_the_nearest_of_those_that_show_as_much(album: Album) -> None:
    # Every photograph sees every point; queries b, d and f fly between a, c, e and g, and the
    # world's noise in the last bit decides between two at the same distance.
    neighbours = {name: entry.neighbour for name, entry in album.entries.items()}
    assert neighbours["b.jpg"] in ("a.jpg", "c.jpg")
    assert neighbours["d.jpg"] in ("c.jpg", "e.jpg")
    assert neighbours["f.jpg"] in ("e.jpg", "g.jpg")
    assert set(album.neighbours) == set(neighbours.values())


def test_neighbour_shows_most_of_the_ground(beach: Path) -> None:
    """On a real flight, and its points lie in it where its own pose puts them."""
    dataset = open_datasets(beach)[0]
    sparse_map = dataset.load_map()
    album = make_album(dataset, sparse_map)
    for query in dataset.queries:
        entry = album.entries[query.name]
        assert entry.neighbour is not None
        image = sparse_map.images[entry.neighbour]
        projected = image.camera.project(image.pose.transform(torch.from_numpy(entry.world)))
        assert np.abs(projected.xy.numpy() - entry.seen).max() < 5
        visible = query.camera.project(query.reference.transform(torch.from_numpy(sparse_map.xyz)))
        inside = (visible.valid & query.camera.contains(visible.xy)).numpy()
        shared = {
            name: int(inside[other.point_rows[other.point_rows >= 0]].sum())
            for name, other in sparse_map.images.items()
        }
        assert shared[entry.neighbour] == max(shared.values()) >= len(entry.world) > 0
        with Image.open(io.BytesIO(entry.photograph)) as photograph:
            assert max(photograph.size) == SIDE


def test_points_out_of_sight_are_unknown(album: Album) -> None:
    below = move(pose_at(1), 0)
    underground = type(below)(below.rotation, below.translation - 80)
    assert np.isnan(album.entries["b.jpg"].project_at(underground)).all()


def test_a_query_off_the_map_has_no_neighbour(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    away = replace(dataset.queries[0], reference=move(pose_at(1), 1e4))
    album = make_album(replace(dataset, queries=(away,)), dataset.load_map())
    write_album(tmp_path / ALBUM, album)
    again = read_album(tmp_path / ALBUM, album.sha256)
    assert again is not None
    entry = again.entries[away.name]
    assert (entry.neighbour, entry.world.shape, dict(again.neighbours)) == (None, (0, 3), {})
    assert entry.project_at(pose_at(1)).shape == (0, 2)


def test_file_says_what_the_album_said(album: Album, tmp_path: Path) -> None:
    write_album(tmp_path / ALBUM, album)
    again = read_album(tmp_path / ALBUM, album.sha256)
    assert again is not None
    assert again.neighbours == album.neighbours
    for name, entry in album.entries.items():
        other = again.entries[name]
        assert (other.camera, other.neighbour) == (entry.camera, entry.neighbour)
        assert other.photograph == entry.photograph
        for array in ("world", "truth", "seen"):
            assert np.array_equal(getattr(other, array), getattr(entry, array))
    assert read_album(tmp_path / ALBUM, "other data") is None
    assert read_album(tmp_path / "nowhere.h5", album.sha256) is None


def test_an_album_is_made_once(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    sparse_map = dataset.load_map()
    path = tmp_path / ALBUM
    keep_album(path, dataset, sparse_map)
    made = path.stat().st_ino
    keep_album(path, dataset, sparse_map)
    assert path.stat().st_ino == made
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="album .* is damaged"):
        read_album(path, dataset.sha256)
    keep_album(path, dataset, sparse_map)
    assert read_album(path, dataset.sha256) is not None


def test_nothing_of_another_file_is_in_an_album(album: Album, tmp_path: Path) -> None:
    path, other = tmp_path / ALBUM, tmp_path / "other.h5"
    write_album(path, album)
    write_album(other, album)
    with h5py.File(path, "r+") as file:
        del file["map"]
        file["map"] = h5py.ExternalLink(other, "/map")
    with pytest.raises(InputError, match="album .* is damaged .*link"):
        read_album(path, album.sha256)


def test_text_of_variable_length_is_not_read(album: Album, tmp_path: Path) -> None:
    """The HDF5 library searches a damaged heap of such texts for ever."""
    path = tmp_path / ALBUM
    write_album(path, album)
    with h5py.File(path, "r+") as file:
        file.attrs["dataset_sha256"] = album.sha256
    with pytest.raises(InputError, match="album .* is damaged .*variable length"):
        read_album(path, album.sha256)


def test_a_neighbour_that_is_no_name(album: Album, tmp_path: Path) -> None:
    path = tmp_path / ALBUM
    write_album(path, album)
    with h5py.File(path, "r+") as file:
        next(iter(file["queries"].values())).attrs["neighbour"] = [1, 2, 3]
    with pytest.raises(InputError, match="lacks a map photograph"):
        read_album(path, album.sha256)
