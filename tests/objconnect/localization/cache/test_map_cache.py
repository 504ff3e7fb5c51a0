"""The cache's files are found by all that they are made of; photographs that change are told."""

from __future__ import annotations

import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmark.datasets.open import open_datasets
from objconnect.localization.cache.map_cache import EarlierRows, MapCache, open_cache
from objconnect.localization.cache.store import Rows, write_store
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import MapPart
from objconnect.scene.storage.digests import digest_of
from tests.benchmark.made_data import write_flight


@pytest.fixture
def cache(tmp_path: Path) -> MapCache:
    (dataset,) = open_datasets(write_flight(tmp_path / "meadow"))
    return MapCache.of(dataset.load_map(), dataset.images, tmp_path / "cache")


def one(value: float) -> Callable[[EarlierRows], Rows]:
    """Return what makes a row of a number."""

    def rows(_: EarlierRows) -> Rows:
        yield digest_of(value), {"a": np.array([value])}

    return rows


def test_every_part_decides_the_file(cache: MapCache) -> None:
    sparse_map, (first, *_) = cache.sparse_map, cache.names
    moved = replace(sparse_map, xyz=sparse_map.xyz + 1)
    asked = [
        (cache, "mosaic", 1, "key"),
        (cache, "mosaic", 2, "key"),
        (cache, "objects", 1, "key"),
        (cache, "mosaic", 1, "other"),
        (cache, "mosaic", "1 key"),
        (replace(cache, digests={**cache.digests, first: "0"}), "mosaic", 1, "key"),
        (replace(cache, sparse_map=moved), "mosaic", 1, "key"),
    ]
    for number, (map_cache, kind, *made_of) in enumerate(asked):
        assert not map_cache.holds(kind, *made_of)
        if map_cache.digests is cache.digests:  # else its photographs are not what it says
            map_cache.store(kind, *made_of, rows=one(number))
            assert map_cache.holds(kind, *made_of)
            assert map_cache.store(kind, *made_of, rows=one(-1)).read(0, "a") == [number]
    assert len(list(cache.folder.iterdir())) == len(asked) - 1


def test_a_part_lies_in_its_own_folder(cache: MapCache, tmp_path: Path) -> None:
    folder = cache.folder / "part"
    part = replace(cache, part=MapPart(cache.names[:1], folder))
    part.store("a", rows=one(1))
    assert part.names == cache.names[:1] and part.whole == cache
    assert not cache.holds("a") and len(list(folder.iterdir())) == 1
    found = cache.earlier("a")(digest_of(1), ["a"])
    assert found is not None and found["a"] == [1]


def test_a_photograph_that_changes_meanwhile_is_told(cache: MapCache) -> None:
    path = cache.images / cache.names[0]

    def rows(_: EarlierRows) -> Rows:
        yield "", {"a": np.ones(1)}
        path.write_bytes(path.read_bytes() + b"more")

    with pytest.raises(InputError, match=path.name):
        cache.store("mosaic", rows=rows)
    assert not cache.holds("mosaic")


def test_without_a_folder_files_stay_open(cache: MapCache) -> None:
    with open_cache(cache.sparse_map, cache.images, None) as map_cache:
        store = map_cache.store("a", rows=one(3))
    assert not map_cache.folder.exists()
    assert store.read(0, "a") == [3]


def test_earlier_rows_are_found_by_what_they_were_made_of(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.h5" for name in ("one", "other", "damaged", "unkeyed", "old")]
    for path in paths[:3]:
        rows = ((digest_of(path.stem, row), {"a": np.full((row, 2), row)}) for row in range(3))
        write_store(path, rows)
    write_store(paths[3], (("", {"a": np.ones((1, 2))}) for _ in range(1)))
    paths[2].write_bytes(paths[2].read_bytes()[:200])
    with h5py.File(paths[4], "w") as file:  # as earlier versions wrote it
        file["keys"], file["a"] = np.array([digest_of("old", 0).encode()]), np.ones((1, 2))
    earlier = EarlierRows(paths)
    for name in ("one", "other"):
        for row in range(3):
            found = earlier(digest_of(name, row), ["a"])
            assert found is not None
            np.testing.assert_array_equal(found["a"], np.full((row, 2), row))
    assert earlier(digest_of("one", 2), ["b"]) is None
    assert earlier(digest_of("damaged", 2), ["a"]) is None
    assert earlier(digest_of("old", 0), ["a"]) is None
    assert earlier("", ["a"]) is None


def test_more_earlier_files_than_a_process_may_open(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.h5" for number in range(60)]
    for number, path in enumerate(paths):
        write_store(path, one(number)(EarlierRows([])))
    before, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    there = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (there + 30, hard))
    try:
        earlier = EarlierRows(paths)
        for number in range(60):
            found = earlier(digest_of(number), ["a"])
            assert found is not None and found["a"] == [number]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, hard))
