"""Photographs of a map: which points they see, and the colours of these points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.images import read_rgb
from simulate.twin.photographs import (
    Photograph,
    covered_square,
    map_photographs,
    sample_photographs,
)

CAMERA = Camera("SIMPLE_PINHOLE", 100, 100, (100.0, 50.0, 50.0))


def straight_down(east_m: float, north_m: float, height_m: float) -> Photograph:
    """A photograph whose rows run from north to south."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [east_m, north_m, height_m]
    return Photograph(Path("none.jpg"), CAMERA, pose)


@pytest.mark.parametrize("level_m", [0.0, -20.0])
def test_the_square_that_two_photographs_see(level_m: float) -> None:
    """Each shows 80 m a side from 80 m above the ground."""
    above = [straight_down(0, 0, level_m + 80), straight_down(0, 10, level_m + 80)]
    # Together they see the square but for a strip in the south that is 10 m wide, so that 5 % of a
    # side of s m are unseen where (s / 2 - 30) / s = 0.05.
    assert covered_square(above, level_m, 200.0) == pytest.approx(66.7, abs=1)
    assert covered_square(above[:1], level_m, 200.0) == 0
    assert covered_square([straight_down(300, 0, 80)] * 2, 0.0, 200.0) == 0


def test_colours_are_those_of_the_photographs(rendered: Scene) -> None:
    photographs = map_photographs(rendered)
    assert len(photographs) == len(rendered.splits.map)
    session = "summer-noon-nadir-map"
    frames = rendered.frames(session)
    with rendered.layers(session) as dense:
        depth = dense.read("depth", 4)
    camera, pose = frames.cameras[4], frames.cam_from_world[4]
    # Near the middle of a photograph straight down, none looks more from above.
    rows, columns = (grid.ravel() for grid in np.mgrid[-3:4, -3:4])
    rows, columns = rows + camera.height // 2, columns + camera.width // 2
    rays = camera.unproject(camera.pixel_grid())[0].numpy()[rows, columns]
    points = (rays * depth[rows, columns][:, None] - pose[:3, 3]) @ pose[:3, :3]
    rgb = read_rgb(rendered.images_root / frames.names[4])[rows, columns]
    own = [p for p in photographs if p.path.samefile(rendered.images_root / frames.names[4])]
    np.testing.assert_allclose(sample_photographs(own, points), rgb, atol=1)
    every = sample_photographs(photographs, points)
    assert np.abs(every - rgb).mean() < 12
    hidden = points + np.array([1000.0, 0.0, 0.0])
    assert np.isnan(sample_photographs(photographs, hidden)).all()
