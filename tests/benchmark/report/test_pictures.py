from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmark.datasets.open import open_datasets
from benchmark.report.pictures import median_query, query_overlay
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Status
from tests.benchmark.made_data import make_scored_query, move, pose_at


def test_the_median_query_has_the_median_error() -> None:
    queries = [
        make_scored_query("a", 3),
        make_scored_query("b", 1),
        make_scored_query("c", 2),
        make_scored_query("d", 9, status=Status.FALLBACK),
    ]
    median = median_query(queries)
    assert median is not None
    assert median.name == "c"
    assert median_query(queries[3:]) is None


def test_overlay_shows_both_poses(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    path = tmp_path / "picture.png"
    query_overlay(dataset.queries[0], dataset.load_map(), move(pose_at(1), 2.0), path, "fake")
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    for colour in ((0, 229, 255), (255, 45, 149)):
        assert (np.abs(pixels - colour).max(-1) < 8).sum() > 20


def test_an_overlay_is_drawn_at_a_pose_that_sees_nothing(made_flight: Path, tmp_path: Path) -> None:
    """Every point behind the camera or out of sight is not a reason to fail."""
    (dataset,) = open_datasets(made_flight)
    path = tmp_path / "picture.png"
    query_overlay(dataset.queries[0], dataset.load_map(), move(pose_at(1), 1e6), path, "fake")
    assert path.stat().st_size > 1000


def test_overlay_leaves_no_partial_file(made_flight: Path, tmp_path: Path) -> None:
    (dataset,) = open_datasets(made_flight)
    (made_flight / "images" / "b.jpg").write_bytes(b"")
    with pytest.raises(InputError):
        query_overlay(
            dataset.queries[0], dataset.load_map(), pose_at(1), tmp_path / "p.png", "fake"
        )
    assert not list(tmp_path.glob("*.png"))
