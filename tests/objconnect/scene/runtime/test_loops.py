"""Compiled loops are kept where there is room, and work where there is none."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.runtime.loops import compile_loop

SIGNATURE = "void(f4[::1], f4[::1])"


def running_sums(values: NDArray[np.float32], into: NDArray[np.float32]) -> None:
    total = np.float32(0)
    for k in range(len(values)):
        total += values[k]
        into[k] = total


def sums(values: NDArray[np.float32]) -> NDArray[np.float32]:
    compile_loop.cache_clear()
    into = np.empty_like(values)
    compile_loop(running_sums, SIGNATURE)(values, into)
    return into


def test_what_is_read_again_gives_the_same_bits() -> None:
    values = np.random.default_rng(0).random(100, np.float32)
    first, again = sums(values), sums(values)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(first, np.cumsum(values), rtol=1e-5)


@pytest.mark.parametrize("error", [OSError("No space left on device"), RuntimeError("no locator")])
def test_loops_that_cannot_be_kept_are_compiled(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = np.random.default_rng(1).random(100, np.float32)
    expected, njit, refused = sums(values), numba.njit, []

    def full(cache: bool = False, **options: Any) -> Any:
        if cache:
            refused.append(error)
            raise error
        return njit(**options)

    monkeypatch.setattr(numba, "njit", full)
    np.testing.assert_array_equal(sums(values), expected)
    compile_loop.cache_clear()
    assert refused
