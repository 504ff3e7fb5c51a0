"""Pictures of a flight are made more alike, and its other files stay."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments.normalized_flight import OF_ALL, TO_MAP, match_histogram, normalize_flight


def make_flight(folder: Path) -> None:
    rng = np.random.default_rng(0)
    (folder / "images" / "virtual").mkdir(parents=True)
    (folder / "queries.txt").write_text("q000.jpg PINHOLE 64 64 64 64 32 32\n")
    for name, mean in (("q000.jpg", 60), ("virtual/000000.jpg", 160)):
        picture = rng.normal(mean, 20, (64, 64, 3)).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / "images" / name), picture)


def read(folder: Path, name: str) -> np.ndarray:
    picture = cv2.imread(str(folder / "images" / name))
    assert picture is not None
    return picture.astype(float)


@pytest.mark.parametrize("by", [*TO_MAP, *OF_ALL])
def test_a_flight_is_copied_with_other_pictures(by: str, tmp_path: Path) -> None:
    make_flight(tmp_path / "flight")
    normalize_flight(tmp_path / "flight", tmp_path / "out", by)
    query, mapped = (read(tmp_path / "out", n) for n in ("q000.jpg", "virtual/000000.jpg"))
    before = read(tmp_path / "flight", "q000.jpg")
    assert np.abs(query - before).mean() > 1
    is_same_map = np.array_equal(mapped, read(tmp_path / "flight", "virtual/000000.jpg"))
    assert is_same_map == (by in TO_MAP)
    if by in TO_MAP:
        assert abs(query.mean() - mapped.mean()) < 5 < abs(before.mean() - mapped.mean())
    if by == "grey":
        assert np.ptp(query, axis=-1).max() <= 3
    assert (tmp_path / "out" / "queries.txt").read_text().startswith("q000.jpg")


def test_histograms_become_equal() -> None:
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 100, (64, 64, 3), dtype=np.uint8)
    reference = rng.integers(100, 256, (4096, 3), dtype=np.uint8)
    matched = match_histogram(picture, reference)
    for share in (0.1, 0.5, 0.9):
        assert np.quantile(matched, share) == pytest.approx(np.quantile(reference, share), abs=3)
