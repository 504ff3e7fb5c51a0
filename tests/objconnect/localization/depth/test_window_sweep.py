"""Windows along rays, beside a plain computation and the known surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.localization.depth.grey_photograph import GreyPhotograph
from objconnect.localization.depth.sweep import Sweeper, SweepOptions, window_offsets
from objconnect.localization.depth.window_sweep import WindowSweep
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.pixloc.made_map import height, write_map

WINDOW = window_offsets()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("windows") / "images"
    return write_map(images), images


def grey_at(photograph: GreyPhotograph, xy: torch.Tensor) -> torch.Tensor:
    """Interpolate a photograph at pixels (..., 2)."""
    height_, width = photograph.grey.shape
    grid = 2 * xy.float() / torch.tensor([width, height_]) - 1
    picture = photograph.grey[None, None]
    sampled = torch.nn.functional.grid_sample(
        picture, grid.view(1, -1, xy.shape[-2], 2), align_corners=False
    )
    return sampled.view(xy.shape[:-1])


def plain_correlation(
    here: GreyPhotograph, xy: torch.Tensor, depth: torch.Tensor, other: GreyPhotograph
) -> torch.Tensor:
    """Correlate windows with every value of the window projected by itself."""
    rays, _ = here.camera.unproject((xy[:, None] + WINDOW).flatten(0, 1))
    in_camera = rays.view(len(xy), -1, 3) * depth[:, None, None]
    world = here.pose.inverse().transform(in_camera.flatten(0, 1))
    there = other.camera.project(other.pose.transform(world)).xy.view(len(xy), -1, 2)
    own, theirs = grey_at(here, xy[:, None] + WINDOW), grey_at(other, there)
    own, theirs = (each - each.mean(1, keepdim=True) for each in (own, theirs))
    return (own * theirs).sum(1) / (own.norm(dim=1) * theirs.norm(dim=1))


@pytest.mark.parametrize("planes", [11, 41])
def test_correlation_is_that_of_windows_projected_value_by_value(
    made: tuple[SparseMap, Path], planes: int
) -> None:
    photographs = Sweeper(*made).photograph
    here, other = photographs("2.png"), photographs("3.png")
    grid = np.meshgrid(np.arange(110, 220, 9.3), np.arange(30, 150, 9.7))
    xy = torch.from_numpy(np.stack(grid, -1).reshape(-1, 2))
    inverse = torch.linspace(1 / 23, 1 / 18, planes, dtype=torch.float64).expand(len(xy), -1)
    found = WindowSweep(here, xy, WINDOW, 8.0)(inverse.float(), other)
    shown = found[:, 3] > -1
    assert shown.mean() > 0.8
    for column in (3, planes - 2):
        expected = plain_correlation(here, xy, 1 / inverse[:, column], other).numpy()
        off = np.abs(found[:, column] - expected)[shown & (found[:, column] > -1)]
        # OpenCV interpolates at 32nds of a pixel.
        assert np.median(off) < 0.005 and off.max() < 0.06


def test_windows_that_are_plain_correlate_with_nothing(made: tuple[SparseMap, Path]) -> None:
    photographs = Sweeper(*made).photograph
    here, other = photographs("2.png"), photographs("3.png")
    plain = GreyPhotograph(torch.full_like(here.grey, 99.0), here.camera, here.pose, lambda xy: xy)
    xy = torch.tensor([[150.0, 90.0]], dtype=torch.float64)
    inverse = torch.linspace(1 / 23, 1 / 18, 5)[None]
    assert (WindowSweep(plain, xy, WINDOW, 8.0)(inverse, other) == 0).all()
    assert (WindowSweep(here, xy, WINDOW, 8.0)(inverse, other) != 0).any()


def test_agreement_in_the_small_pictures_saves_work_and_loses_no_exactness(
    made: tuple[SparseMap, Path],
) -> None:
    xy = np.stack(np.meshgrid(np.arange(90, 240, 3.0), np.arange(20, 180, 3.0)), -1).reshape(-1, 2)
    found = [
        Sweeper(*made, options=SweepOptions(shrink=2, shrunk_correlation=least))("2.png", xy)
        for least in (-1.0, 0.4, 0.99)
    ]
    placed = [int((each.score != 0).sum()) for each in found]
    assert placed[0] > placed[1] > placed[2]
    assert found[1].sure.sum() > 0.98 * found[0].sure.sum()
    x, y, z = torch.from_numpy(found[1].xyz[found[1].sure]).T
    assert float((z - height(x, y)).abs().median()) < 0.1
