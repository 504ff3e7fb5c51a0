"""Corners of photographs whose true surface is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.featuremetric.corners import (
    CornerFinder,
    CornerOptions,
    Corners,
    all_corners,
)
from objconnect.scene.errors import InputError
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.pixloc.made_map import height, write_map


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("corners") / "images"
    return write_map(images), images


def off_the_ground(found: Corners) -> np.ndarray:
    x, y, z = torch.from_numpy(found.xyz).T
    return (z - height(x, y)).abs().numpy()


def test_corners_stand_on_the_ground(made: tuple[SparseMap, Path]) -> None:
    """The ground is a smooth relief of 3 m, seen from 20 m by photographs 6 m apart."""
    sparse_map, images = made
    found = CornerFinder(sparse_map, images, 1024, CornerOptions(count=300))("2.png")
    assert len(found.xy) == len(found.xyz) > 30
    off = off_the_ground(found)
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.9) < 0.4
    image = sparse_map.images["2.png"]
    seen = image.camera.project(image.pose.transform(torch.from_numpy(found.xyz))).xy
    np.testing.assert_allclose(seen, found.xy, atol=1e-3)


def test_what_only_one_photograph_shows_is_left_out(
    made: tuple[SparseMap, Path], tmp_path: Path
) -> None:
    """A thing that has moved on: sharp corners, and nothing like them in the others."""
    sparse_map, images = made
    for path in images.iterdir():
        picture = np.asarray(Image.open(path)).copy()
        if path.name == "2.png":
            rng = np.random.default_rng(0)
            noise = rng.integers(100, 150, (10, 12, 3), np.uint8)
            picture[60:110, 100:160] = cv2.resize(noise, (60, 50), interpolation=cv2.INTER_NEAREST)
        Image.fromarray(picture).save(tmp_path / path.name)
    found = CornerFinder(sparse_map, tmp_path, 1024, CornerOptions(count=400))("2.png")
    within = ((found.xy > [104, 64]) & (found.xy < [156, 106])).all(1)
    assert len(found.xy) > 20
    assert within.sum() <= 2


def test_photographs_without_neighbours_have_none(made: tuple[SparseMap, Path]) -> None:
    sparse_map, images = made
    alone = replace(sparse_map, images={"0.png": sparse_map.images["0.png"]})
    assert len(CornerFinder(alone, images, 1024, CornerOptions(count=300))("0.png").xy) == 0


def test_large_photographs_are_looked_at_smaller(made: tuple[SparseMap, Path]) -> None:
    sparse_map, images = made
    found = CornerFinder(sparse_map, images, 160, CornerOptions(count=300))("2.png")
    assert len(found.xy) > 15
    assert np.median(off_the_ground(found)) < 0.15
    # In pixels of the photograph as it is.
    image = sparse_map.images["2.png"]
    seen = image.camera.project(image.pose.transform(torch.from_numpy(found.xyz))).xy
    np.testing.assert_allclose(seen, found.xy, atol=1e-3)


def test_kept_for_every_method(
    made: tuple[SparseMap, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sparse_map, images = made
    kept = MapCache.of(sparse_map, images, tmp_path)
    find = CornerFinder(sparse_map, images, 1024, CornerOptions(count=200))
    first = all_corners(find, kept, 200)
    assert len(first) == len(sparse_map.names)
    np.testing.assert_array_equal(first[2], find("2.png").xyz)
    monkeypatch.setattr(CornerFinder, "__call__", None)  # nothing is swept again
    for ours, theirs in zip(all_corners(find, kept, 200), first, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(InputError, match="delete it"):
        all_corners(find, kept, 200)
