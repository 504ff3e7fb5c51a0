"""Loops that Numba compiles, and keeps for the next process."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any, Final

from objconnect.scene.runtime.tuning import return_code

# Numba knows what it kept by the file of a function: after a change here, write those files anew.
OPTIONS: Final[dict[str, Any]] = {
    "nogil": True,
    "error_model": "numpy",
    # What is not finite must stay so: flags that exclude it are missing.
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}
# Of functions that a kept one calls. They become part of it: else the process that compiles it
# calls others than those that are kept with it, whose results differ by rounding.
CALLED: Final[dict[str, Any]] = {**OPTIONS, "forceinline": True}


@cache
def has_compiler() -> bool:
    """Return whether Numba is installed; it comes with the extra ``[fast]``."""
    return find_spec("numba") is not None


@cache
def compile_loop(function: Callable[..., None], signature: Any) -> Callable[..., None]:
    """Compile a function of arrays, and of records of them, for one signature of Numba.

    To compile takes a second or so, and a tenth to read what was compiled before: that is kept
    beside the function's file, or in the user's cache.
    """
    from numba import njit

    try:
        made = njit(cache=True, **OPTIONS)(function)
        made.compile(signature)
    except (OSError, RuntimeError):  # nowhere to keep it, or the disk is full
        made = njit(**OPTIONS)(function)
        made.compile(signature)
    return_code("llvmlite")  # 50 MB of a compiler
    loops: Callable[..., None] = made
    return loops
