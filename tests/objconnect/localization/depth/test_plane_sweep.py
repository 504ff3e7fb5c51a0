"""Depths of a whole picture, from planes, where the true surface is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.localization.depth.grey_photograph import GreyPhotograph
from objconnect.localization.depth.plane_sweep import PlaneSweep
from objconnect.localization.depth.sweep import Sweeper, SweepOptions
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.pixloc.made_map import height, looking_down, write_map


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("planes") / "images"
    return write_map(images), images


def off_the_ground(xyz: np.ndarray) -> np.ndarray:
    x, y, z = torch.from_numpy(xyz).T
    return (z - height(x, y)).abs().numpy()


def grid_of_pixels() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(90, 240, 12.0), np.arange(20, 180, 12.0)), -1).reshape(
        -1, 2
    )


def test_the_plane_at_a_pixels_depth_fits_best(made: tuple[SparseMap, Path]) -> None:
    photographs = Sweeper(*made).photograph
    here, other = photographs("2.png"), photographs("3.png")
    xy, planes = grid_of_pixels(), torch.linspace(1 / 23, 1 / 17, 61, dtype=torch.float64)
    correlation = PlaneSweep(here, 9, 4.0)(xy, planes, other)
    best = correlation.argmax(1)
    sure = correlation.max(1) > 0.95
    assert sure.sum() > 40
    rays, _ = here.camera.unproject(torch.from_numpy(xy[sure] + 0.5))
    xyz = here.pose.inverse().transform(rays / planes[best[sure], None]).numpy()
    off = off_the_ground(xyz)
    assert np.median(off) < 0.15 and np.quantile(off, 0.9) < 0.6


def test_what_the_other_picture_does_not_show_is_nowhere(made: tuple[SparseMap, Path]) -> None:
    photographs = Sweeper(*made).photograph
    xy = np.array([[4.0, 96.0], [252.0, 96.0]])
    planes = torch.tensor([1 / 20], dtype=torch.float64)
    (left,), (right,) = PlaneSweep(photographs("2.png"), 5, 4.0)(xy, planes, photographs("3.png"))
    assert left == -1 and right > -1


def test_sweeping_small_pictures_first_places_the_same_pixels(
    made: tuple[SparseMap, Path],
) -> None:
    xy = np.stack(np.meshgrid(np.arange(90, 240, 3.0), np.arange(20, 180, 3.0)), -1).reshape(-1, 2)
    whole, small = (
        Sweeper(*made, options=SweepOptions(shrink=shrink))("2.png", xy) for shrink in (1, 2)
    )
    both = whole.sure & small.sure
    assert both.sum() > 0.8 * whole.sure.sum() > 100
    assert np.median(np.linalg.norm(whole.xyz - small.xyz, axis=1)[both]) < 0.01
    assert np.median(off_the_ground(small.xyz[small.sure])) < 0.1


def test_a_photograph_of_any_size_and_lens_is_made_smaller() -> None:
    camera = Camera("SIMPLE_RADIAL", 1024, 575, (600.0, 512.0, 287.0, 0.004))
    pose = looking_down(0, 0)
    grey = torch.rand(575, 1024)
    small = GreyPhotograph(grey, camera, pose, lambda xy: xy).downscale(3)
    assert (small.camera.width, small.camera.height) == (341, 191) == tuple(small.grey.shape[::-1])
    torch.testing.assert_close(small.grey[0, 0], grey[:3, :3].mean())
    rays, _ = camera.unproject(torch.tensor([[300.0, 150.0]], dtype=torch.float64))
    there = small.camera.project(rays).xy
    torch.testing.assert_close(there, torch.tensor([[100.0, 50.0]], dtype=torch.float64))
