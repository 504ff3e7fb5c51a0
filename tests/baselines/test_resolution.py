from __future__ import annotations

import math

import numpy as np
import pytest

from baselines.resolution import metres_per_pixel, scale_to
from tests.baselines.pixloc.made_map import CAMERA, HEIGHT, looking_down


def test_ground_seen_from_above() -> None:
    x, y = np.meshgrid(np.linspace(-5, 5, 20), np.linspace(-5, 5, 20))
    ground = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    found = metres_per_pixel(looking_down(0, 0), CAMERA, ground)
    assert found == pytest.approx(HEIGHT / np.mean(CAMERA.focal))
    assert math.isnan(metres_per_pixel(looking_down(900, 0), CAMERA, ground))


def test_pictures_are_brought_to_one_resolution_where_they_differ() -> None:
    assert scale_to(0.2, 0.1, 4.0) == pytest.approx(0.5)
    assert scale_to(0.2, 0.4, 4.0) == pytest.approx(2.0)
    assert scale_to(0.2, 0.4, 1.5) == 1.5
    # Alike, or not known: as they are, or as small as they must be.
    assert scale_to(0.2, 0.22, 4.0) == 1
    assert scale_to(0.2, math.nan, 4.0) == 1
    assert scale_to(0.2, 0.4, 0.5) == 0.5
    assert scale_to(math.nan, 0.4, 0.5) == 0.5
