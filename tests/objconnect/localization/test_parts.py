"""A map that several processes prepare, each a part, is the map that one prepares."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import objconnect.localization.featuremetric.corners
import objconnect.localization.featuremetric.references
import objconnect.localization.matching.features
from objconnect.methods import create
from objconnect.network.object_map import ObjectFinder
from objconnect.scene.localizer import MapPart, PreparesParts
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.pixloc.made_map import write_map


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("map") / "images"
    return write_map(images), images


def arrays(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, node: found.update({name: node[...]} if hasattr(node, "dtype") else {})
        )
    return found


def refuse(*_: object) -> None:
    raise AssertionError("computed again")


@pytest.mark.parametrize("method", ["sift", pytest.param("objconnect", marks=pytest.mark.thorough)])
def test_parts_are_copied(
    made: tuple[SparseMap, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    alone, cache = tmp_path / "alone", tmp_path / "cache"
    create(method, {}).prepare(*made, alone)
    names = made[0].names
    for number, part in enumerate((names[:2], names[2:])):
        folder = cache / f"part-{number}"
        folder.mkdir(parents=True)
        localizer = create(method, {})
        assert isinstance(localizer, PreparesParts)
        localizer.prepare_part(*made, cache, MapPart(part, folder))
        assert not [path for path in cache.iterdir() if path.is_file()]
    with monkeypatch.context() as patched:
        patched.setattr(objconnect.localization.matching.features, "_extract_all", refuse)
        patched.setattr(objconnect.localization.featuremetric.references, "observe", refuse)
        patched.setattr(
            objconnect.localization.featuremetric.corners.CornerFinder, "__call__", refuse
        )
        patched.setattr(ObjectFinder, "find_in_view", refuse)
        create(method, {}).prepare(*made, cache)
    written = [path for path in cache.iterdir() if path.is_file()]
    assert {path.name for path in written} == {path.name for path in alone.iterdir()}
    for path in written:
        ours, theirs = arrays(path), arrays(alone / path.name)
        assert ours.keys() == theirs.keys()
        for name, values in ours.items():
            np.testing.assert_array_equal(values, theirs[name])
    # Where the cache holds the whole, no part is computed.
    before = sorted(cache.rglob("*"))
    (cache / "other").mkdir()
    create(method, {}).prepare_part(*made, cache, MapPart(names[1:3], cache / "other"))
    assert sorted({*cache.rglob("*")} - {cache / "other"}) == before
