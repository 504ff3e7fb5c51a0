"""Features of a map's photographs: extracted once, or not at all where the map has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.matching.features import Extractor, map_features
from objconnect.scene.maps.features import Features, features_key, write_features
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import digests_in
from tests.baselines.pixloc.made_map import write_map


class Counting(Extractor):
    """Returns one keypoint a photograph, and counts them."""

    name, options = "counting", "of one"

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        self.count += 1
        return features(float(rgb.mean()))


def features(value: float) -> Features:
    place = np.full((1, 2), value, np.float32)
    return Features(place, np.ones(1, np.float32), np.full((1, 4), 2, np.uint8))


@pytest.fixture
def made(tmp_path: Path) -> tuple[SparseMap, Path]:
    """Return a map with the features that it was built from, and the folder of its photographs."""
    images = tmp_path / "images"
    sparse_map, path = write_map(images), tmp_path / "features.h5"
    kept = {name: features(-1.0) for name in sparse_map.names}
    write_features(path, kept, features_key(digests_in(images, sparse_map.names), Counting.options))
    return replace(sparse_map, features=path), images


def list_keypoints(made: tuple[SparseMap, Path], cache: Path, extractor: Counting) -> set[float]:
    """Return the places of all keypoints."""
    every = map_features(MapCache.of(*made, cache), extractor)
    return {float(every[name].xy[0, 0]) for name in made[0].names}


def test_features_of_the_map_are_taken_as_they_are(
    made: tuple[SparseMap, Path], tmp_path: Path
) -> None:
    extractor = Counting()
    assert list_keypoints(made, tmp_path, extractor) == {-1.0} and extractor.count == 0


def test_a_photograph_that_changed_or_another_option_needs_new_ones(
    made: tuple[SparseMap, Path], tmp_path: Path
) -> None:
    other = Counting()
    other.options = "of two"
    assert -1.0 not in list_keypoints(made, tmp_path, other) and other.count == len(made[0].names)
    first, second = (made[1] / name for name in made[0].names[:2])
    first.write_bytes(second.read_bytes())
    changed = Counting()
    assert -1.0 not in list_keypoints(made, tmp_path, changed) and changed.count == len(
        made[0].names
    )
    again = Counting()
    assert list_keypoints(made, tmp_path, again) and again.count == 0


@pytest.mark.parametrize("damage", ["unknown", "damaged", "missing", "none"])
def test_without_the_features_of_the_map_they_are_extracted(
    made: tuple[SparseMap, Path], tmp_path: Path, damage: str
) -> None:
    sparse_map, images = made
    path = sparse_map.features
    assert path is not None
    if damage == "unknown":  # as older versions wrote them
        write_features(path, {name: features(-1.0) for name in sparse_map.names})
    elif damage == "damaged":
        path.write_bytes(path.read_bytes()[:100])
    elif damage == "missing":
        path.unlink()
    else:
        sparse_map = replace(sparse_map, features=None)
    extractor = Counting()
    assert -1.0 not in list_keypoints((sparse_map, images), tmp_path, extractor)
    assert extractor.count == len(sparse_map.names)


@pytest.mark.parametrize("turned", [True, False])
def test_of_photographs_that_were_added_alone_features_are_extracted(
    made: tuple[SparseMap, Path], tmp_path: Path, turned: bool
) -> None:
    whole, images = replace(made[0], features=None), made[1]
    first = replace(whole, images={name: whole.images[name] for name in whole.names[:3]})
    extractor = Counting()
    extractor.rotation_invariant = turned
    map_features(MapCache.of(first, images, tmp_path / "cache"), extractor)
    grown = map_features(MapCache.of(whole, images, tmp_path / "cache"), extractor)
    assert extractor.count == len(whole.names) == len(grown)
    alone = map_features(MapCache.of(whole, images, tmp_path / "other"), extractor)
    for name in whole.names:
        np.testing.assert_array_equal(grown[name].xy, alone[name].xy)
    # Damaged files say nothing. The grown one is still open, so its place is taken by another.
    for path in (tmp_path / "cache").iterdir():
        part = path.read_bytes()[:300]
        path.unlink()
        path.write_bytes(part)
    before, other = extractor.count, {name: whole.images[name] for name in whole.names[1:]}
    fewer = replace(whole, images=other)
    map_features(MapCache.of(fewer, images, tmp_path / "cache"), extractor)
    assert extractor.count == before + len(other)
