from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scene.held import MEGABYTE, Held, room
from scene.memory import resident_bytes


def test_the_last_used_stay_within_the_bound() -> None:
    read: list[int] = []

    def zeros(size: int) -> NDArray[np.uint8]:
        read.append(size)
        return np.zeros(size, np.uint8)

    held = Held(zeros, 100)
    for size in (40, 50, 40, 30):  # 50 was used longest ago
        assert len(held(size)) == size
        assert held.nbytes <= 100
    assert read == [40, 50, 30]
    assert held(40) is held(40)
    held(50)
    assert read == [40, 50, 30, 50]
    # One alone may be larger: it is needed.
    assert len(held(200)) == 200
    assert (len(held), held.nbytes) == (1, 200)


def test_half_of_what_is_left_below_a_bound_is_for_values() -> None:
    resident = resident_bytes() / MEGABYTE
    bound = round(resident) + 200
    assert room(bound) / MEGABYTE == pytest.approx(100, abs=10)
    # What is taken meanwhile is not there any more.
    taken = np.ones(100 * MEGABYTE, np.uint8)
    assert room(bound) / MEGABYTE == pytest.approx(50, abs=10)
    assert taken.all()
    assert room(1) == 0
