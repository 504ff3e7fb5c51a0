"""Photographs that show the same: by the points that they share, and by their poses where these
are few."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.localization.depth.neighbours import NeighbourOptions, Neighbours
from objconnect.localization.depth.sweep import Sweeper, SweepOptions
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from tests.baselines.pixloc.made_map import HEIGHT, height, write_map

OPTIONS = NeighbourOptions()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("neighbours") / "images"
    return write_map(images), images


def thin(sparse_map: SparseMap, kept: dict[str, int]) -> SparseMap:
    """Leave photographs so many of their points each, those first in the map."""
    images = {
        name: replace(image, xy=image.xy[: kept[name]], point_rows=image.point_rows[: kept[name]])
        for name, image in sparse_map.images.items()
    }
    return replace(sparse_map, images=images)


def few(sparse_map: SparseMap, each: int) -> SparseMap:
    return thin(sparse_map, dict.fromkeys(sparse_map.images, each))


def turn_away(image: MapImage) -> MapImage:
    """A photograph from the same place that looks up."""
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    pose = Pose(flip @ image.pose.rotation, flip @ image.pose.translation)
    return replace(image, cam_from_world=pose.matrix().numpy())


def test_photographs_share_points_as_they_are_counted_pair_by_pair(
    made: tuple[SparseMap, Path],
) -> None:
    sparse_map = made[0]
    neighbours = Neighbours(sparse_map, OPTIONS)
    rows = [
        set(image.point_rows[image.point_rows >= 0].tolist())
        for image in (sparse_map.images[name] for name in sparse_map.names)
    ]
    for own in rows:
        counted = neighbours._count_shared(np.array(sorted(own))).tolist()
        assert counted == [len(own & other) for other in rows]
    assert min(map(len, rows)) > 0


def test_photographs_that_share_no_points_are_beside_each_other_by_their_poses(
    made: tuple[SparseMap, Path],
) -> None:
    sparse_map = few(made[0], 8)
    assert Neighbours(sparse_map, NeighbourOptions(min_shared_view=1.5))("2.png") == []
    chosen = Neighbours(sparse_map, OPTIONS)("2.png")
    assert set(chosen) >= {"1.png", "3.png"} and "2.png" not in chosen


def test_a_photograph_of_the_same_place_that_looks_elsewhere_is_no_neighbour(
    made: tuple[SparseMap, Path],
) -> None:
    sparse_map = few(made[0], 8)
    images = dict(sparse_map.images)
    assert "3.png" in Neighbours(sparse_map, OPTIONS)("2.png")
    images["3.png"] = replace(
        turn_away(images["3.png"]), point_rows=np.full_like(images["3.png"].point_rows, -1)
    )
    assert "3.png" not in Neighbours(replace(sparse_map, images=images), OPTIONS)("2.png")


def test_those_that_share_points_come_first_and_poses_change_nothing_where_they_suffice(
    made: tuple[SparseMap, Path],
) -> None:
    options = NeighbourOptions(neighbours=2)
    full = Neighbours(made[0], options)("2.png")
    assert full == Neighbours(made[0], options.model_copy(update={"min_shared_view": 1.5}))("2.png")
    sparse_map = thin(made[0], {f"{k}.png": 10_000 if k in (2, 4) else 8 for k in range(5)})
    chosen = Neighbours(sparse_map, options)("2.png")
    assert chosen[0] == "4.png" and chosen[1] in ("1.png", "3.png")


def test_depths_are_those_of_the_photographs_around_where_a_photograph_has_few_points(
    made: tuple[SparseMap, Path],
) -> None:
    near, far = Neighbours(made[0], OPTIONS).depths("2.png")
    assert 0.85 * (HEIGHT - 1.5) < near < HEIGHT < far < 1.15 * (HEIGHT + 1.5)
    kept = {f"{k}.png": 3 if k == 2 else 10_000 for k in range(5)}
    around = Neighbours(thin(made[0], kept), OPTIONS)
    low, high = around.depths("2.png")
    assert low == pytest.approx(0.3 * HEIGHT, rel=0.05) and high == pytest.approx(far, rel=0.05)
    # Those of the others are what they were.
    assert around.depths("3.png") == Neighbours(made[0], OPTIONS).depths("3.png")


def test_a_map_without_points_has_no_neighbours_and_no_depths(
    made: tuple[SparseMap, Path],
) -> None:
    empty = Neighbours(few(made[0], 0), OPTIONS)
    assert empty("2.png") == [] and empty.depths("2.png") == (np.inf, np.inf)
    swept = Sweeper(few(made[0], 0), made[1])("2.png", np.array([[100.0, 90.0]]))
    assert not swept.sure.any()


def test_corners_are_placed_where_photographs_share_too_few_points(
    made: tuple[SparseMap, Path],
) -> None:
    sparse_map, images = few(made[0], 12), made[1]
    xy = np.stack(np.meshgrid(np.arange(90, 240, 6.0), np.arange(20, 180, 6.0)), -1).reshape(-1, 2)
    before = SweepOptions(min_shared_view=1.5)
    assert not Sweeper(sparse_map, images, options=before)("2.png", xy).sure.any()
    found = Sweeper(sparse_map, images)("2.png", xy)
    assert found.sure.sum() > 0.1 * len(xy)
    x, y, z = torch.from_numpy(found.xyz[found.sure]).T
    assert float((z - height(x, y)).abs().median()) < 0.15
