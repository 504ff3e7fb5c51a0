from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.storage.lru_cache import LruCache
from tests.programs import run_and_print


def test_the_last_used_stay_within_the_bound() -> None:
    read: list[int] = []

    def zeros(size: int) -> NDArray[np.uint8]:
        read.append(size)
        return np.zeros(size, np.uint8)

    cache = LruCache(zeros, 100)
    for size in (40, 50, 40, 30):  # 50 was used longest ago
        assert len(cache(size)) == size
        assert cache.nbytes <= 100
    assert read == [40, 50, 30]
    assert cache(40) is cache(40)
    cache(50)
    assert read == [40, 50, 30, 50]
    # One alone may be larger: it is needed.
    assert len(cache(200)) == 200
    assert (len(cache), cache.nbytes) == (1, 200)


ROOM = """
import numpy as np
from objconnect.scene.storage.lru_cache import MEGABYTE, free_cache_bytes
from objconnect.scene.runtime.memory import resident_bytes

bound = round(resident_bytes() / MEGABYTE) + 200
print(free_cache_bytes(bound) / MEGABYTE)
allocated = np.ones(100 * MEGABYTE, np.uint8)
print(free_cache_bytes(bound) / MEGABYTE)
assert allocated.all()
print(free_cache_bytes(1))
"""


def test_half_of_what_is_left_below_a_bound_is_for_values() -> None:
    """In a process that does nothing else: what other tests let go may leave memory meanwhile."""
    at_first, with_less, without = map(float, run_and_print(ROOM).split())
    assert at_first == pytest.approx(100, abs=10)
    # Memory that the array occupies is not there any more.
    assert with_less == pytest.approx(50, abs=10)
    assert without == 0
