"""The cache's files are named by all that they are made of; photographs that change are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.datasets.open import open_datasets
from objconnect.localization.cache.map_cache import MapCache
from objconnect.scene.errors import InputError
from tests.benchmark.made_data import write_flight


@pytest.fixture
def cache(tmp_path: Path) -> MapCache:
    (dataset,) = open_datasets(write_flight(tmp_path / "meadow"))
    return MapCache.of(dataset.load_map(), dataset.images, tmp_path / "cache")


def test_every_part_decides_the_name(cache: MapCache) -> None:
    names = {
        cache.path("mosaic", 1, "key"),
        cache.path("mosaic", 2, "key"),
        cache.path("objects", 1, "key"),
        cache.path("mosaic", 1, "other"),
        replace(cache, digests={"one": "0"}).path("mosaic", 1, "key"),
        replace(cache, map_sha256="0").path("mosaic", 1, "key"),
    }
    assert len(names) == 6
    assert all(name.parent == cache.folder and name.suffix == ".h5" for name in names)
    assert cache.path("mosaic", 1, "key") == cache.path("mosaic", 1, "key")


def test_a_photograph_that_changes_meanwhile_is_told(cache: MapCache) -> None:
    cache.require_unchanged()
    with cache.files[0].open("ab") as file:
        file.write(b"more")
    with pytest.raises(InputError, match=cache.files[0].name):
        cache.require_unchanged()
