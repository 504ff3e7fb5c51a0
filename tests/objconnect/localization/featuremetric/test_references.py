from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from objconnect.learning.pixloc_net import read_network
from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.featuremetric.corners import CornerOptions
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.references import (
    ReferenceFeatures,
    ReferenceSource,
    load_references,
    observe,
    order_by_coverage,
)
from objconnect.scene.errors import InputError
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.images import read_rgb
from tests.baselines.pixloc.made_map import write_map, write_network

CORNERS = CornerOptions(count=50)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("map") / "images"
    return write_map(images), images


@pytest.fixture(scope="module")
def extract(tmp_path_factory: pytest.TempPathFactory) -> MapExtractor:
    path = write_network(tmp_path_factory.mktemp("weights") / "pixloc.safetensors")
    return MapExtractor(read_network(path)[0], 1024, "float32")


def read(made: tuple[SparseMap, Path], extract: MapExtractor, cache: Path) -> ReferenceFeatures:
    kept = MapCache.of(*made, cache)
    return load_references(ReferenceSource(kept, extract, "key", "method", 100), 2**20)


def test_beginnings_cover_the_picture() -> None:
    rng = np.random.default_rng(0)
    # Nearly all points in one corner.
    xy = np.concatenate([rng.uniform(0, 0.06, (900, 2)), rng.uniform(0, 1, (100, 2))])
    worth = rng.integers(3, 9, 1000)
    order = order_by_coverage(xy, worth, 16)
    assert sorted(order) == list(range(1000))
    cells = (xy * 16).astype(int) @ [1, 16]
    cell_count = len(np.unique(cells))
    assert len(np.unique(cells[order[:cell_count]])) == cell_count
    for row in order[:cell_count]:
        assert worth[row] == worth[cells == cells[row]].max()


def test_observed_as_the_network_sees_them(
    made: tuple[SparseMap, Path], extract: MapExtractor
) -> None:
    sparse_map, images = made
    image = sparse_map.images["2.png"]
    view, maps = extract(read_rgb(images / "2.png"), image.camera)
    rows = np.unique(image.point_rows[image.point_rows >= 0])
    seen = observe(view, maps, image.pose, sparse_map.xyz[rows], 60)
    assert len(seen.xyz) == 60 == len(np.unique(seen.xyz, axis=0))
    xy = image.camera.project(image.pose.transform(torch.from_numpy(seen.xyz))).xy
    for level, map_ in enumerate(maps):
        place = 2 * xy.float() / torch.tensor([256.0, 192.0]) - 1
        there = torch.nn.functional.grid_sample(
            map_.features, place[None, None], padding_mode="border", align_corners=False
        )
        unit = torch.nn.functional.normalize(there[0, :, 0].T, dim=-1)
        np.testing.assert_allclose(seen.features[level], unit, atol=1e-3)
        assert np.linalg.norm(seen.features[level].astype(float), axis=1) == pytest.approx(
            1, abs=1e-3
        )
    assert seen.confidence.shape == (60, 3)
    assert seen.confidence.min() > 0 and seen.confidence.max() < 1


def test_kept_on_disk_and_bounded_in_memory(
    made: tuple[SparseMap, Path],
    extract: MapExtractor,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = read(made, extract, tmp_path)
    monkeypatch.setattr(MapExtractor, "__call__", None)  # the network is not asked again
    one = first[0].nbytes
    monkeypatch.setattr(
        "objconnect.localization.featuremetric.references.free_cache_bytes",
        lambda _: 2 * one + one // 2,
    )
    again = read(made, extract, tmp_path)
    assert len(again) == 5
    for row in (0, 1, 2, 3, 4, 0, 4, 2):
        for ours, theirs in zip(again[row].features, first[row].features, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(again[row].xyz, first[row].xyz)
        assert again._cache.nbytes <= 2 * one + one // 2
    assert len(again._cache) == 2
    assert again[2] is again[2]
    # 100 points of 112 channels and 3 confidences in half precision, and their places.
    assert one == 100 * (2 * (112 + 3) + 24)


def test_other_inputs_are_other_files(
    made: tuple[SparseMap, Path], extract: MapExtractor, tmp_path: Path
) -> None:
    read(made, extract, tmp_path)
    sparse_map, images = made
    moved = replace(sparse_map, xyz=sparse_map.xyz + 0.01)
    kept = MapCache.of(sparse_map, images, tmp_path)
    source = ReferenceSource(kept, extract, "key", "method", 100)
    load_references(replace(source, map_cache=replace(kept, sparse_map=moved)), 2**30)
    load_references(replace(source, extractor_key="other"), 2**30)
    load_references(replace(source, corners=CORNERS), 2**30)
    # The last has a file of corners beside it.
    assert len(list(tmp_path.iterdir())) == 5


def without_the_last(sparse_map: SparseMap) -> SparseMap:
    """Return a map before its last photograph was added."""
    images = {name: sparse_map.images[name] for name in sparse_map.names[:-1]}
    last = sparse_map.images[sparse_map.names[-1]].point_rows
    tracks = sparse_map.track_length.copy()
    tracks[last] -= 1
    return replace(sparse_map, images=images, track_length=tracks)


@pytest.mark.parametrize("corners", [None, CORNERS])
def test_what_an_added_photograph_does_not_change_is_copied(
    made: tuple[SparseMap, Path],
    extract: MapExtractor,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    corners: CornerOptions | None,
) -> None:
    whole, images = made
    kept = MapCache.of(whole, images, tmp_path / "cache")
    source = ReferenceSource(kept, extract, "key", "method", 100, corners)
    before = MapCache.of(without_the_last(whole), images, tmp_path / "cache")
    load_references(replace(source, map_cache=before), 2**30)
    alone = load_references(
        replace(source, map_cache=replace(kept, folder=tmp_path / "alone")), 2**30
    )
    asked = []

    def count(of: MapExtractor, *args: Any) -> Any:
        asked.append(1)
        return extracted(of, *args)

    extracted = MapExtractor.__call__
    monkeypatch.setattr(MapExtractor, "__call__", count)
    grown = load_references(source, 2**30)
    for row in range(len(whole.names)):
        for ours, theirs in zip(grown[row].features, alone[row].features, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(grown[row].xyz, alone[row].xyz)
        np.testing.assert_array_equal(grown[row].confidence, alone[row].confidence)
    # The first photographs share no point with the last.
    assert 1 <= len(asked) < len(whole.names)
    load_references(replace(source, extractor_key="other"), 2**30)
    assert len(asked) >= 2 * len(whole.names) - 4


def test_damaged_cache(made: tuple[SparseMap, Path], extract: MapExtractor, tmp_path: Path) -> None:
    read(made, extract, tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="delete it"):
        read(made, extract, tmp_path)


def test_cache_that_leads_elsewhere(
    made: tuple[SparseMap, Path], extract: MapExtractor, tmp_path: Path
) -> None:
    read(made, extract, tmp_path)
    (path,) = tmp_path.iterdir()
    with h5py.File(path, "r+") as file:
        file.move("arrays/xyz", "other")
        file["arrays/xyz"] = h5py.SoftLink("/other")
    with pytest.raises(InputError, match="link.*delete it"):
        read(made, extract, tmp_path)[0]


def test_missing_photograph(
    made: tuple[SparseMap, Path], extract: MapExtractor, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read((made[0], tmp_path), extract, tmp_path)
    assert not list(tmp_path.iterdir())
