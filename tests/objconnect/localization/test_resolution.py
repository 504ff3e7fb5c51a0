from __future__ import annotations

import math

import numpy as np
import pytest

from objconnect.localization.resolution import metres_per_pixel, scale_to
from objconnect.scene.geometry.views import level_rotation
from tests.baselines.pixloc.made_map import CAMERA, HEIGHT, looking_down


def test_ground_seen_from_above() -> None:
    x, y = np.meshgrid(np.linspace(-5, 5, 20), np.linspace(-5, 5, 20))
    ground = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    found = metres_per_pixel(looking_down(0, 0), CAMERA, ground)
    assert found == pytest.approx(HEIGHT / np.mean(CAMERA.focal))
    assert math.isnan(metres_per_pixel(looking_down(900, 0), CAMERA, ground))


@pytest.mark.parametrize(("tilt", "known"), [(60, True), (69, True), (71, False), (90, False)])
def test_a_camera_that_looks_along_the_ground_has_no_resolution(tilt: float, known: bool) -> None:
    x, y = np.meshgrid(np.linspace(-500, 500, 500), np.linspace(-500, 500, 500))
    ground = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    pose = looking_down(0, 0, (tilt, 0, 0))
    assert math.isfinite(metres_per_pixel(pose, CAMERA, ground)) == known
    # Seen as by a camera that is turned down, it has one.
    down = level_rotation(pose.rotation.numpy(), 0.0) @ pose.rotation.numpy().T
    assert metres_per_pixel(pose, CAMERA, ground, down) > 0


def test_pictures_are_brought_to_one_resolution_where_they_differ() -> None:
    assert scale_to(0.2, 0.1, 4.0) == pytest.approx(0.5)
    assert scale_to(0.2, 0.4, 4.0) == pytest.approx(2.0)
    assert scale_to(0.2, 0.4, 1.5) == 1.5
    # Alike, or not known: as they are, or as small as they must be.
    assert scale_to(0.2, 0.22, 4.0) == 1
    assert scale_to(0.2, math.nan, 4.0) == 1
    assert scale_to(0.2, 0.4, 0.5) == 0.5
    assert scale_to(math.nan, 0.4, 0.5) == 0.5
