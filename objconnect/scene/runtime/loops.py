"""Loops that Numba compiles and caches for later processes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any, Final

from objconnect.scene.runtime.tuning import release_code

# Numba's cache does not depend on these options: after a change, touch the files of all loops.
LOOP_OPTIONS: Final[dict[str, Any]] = {
    "nogil": True,
    "error_model": "numpy",
    # Flags that assume finite numbers are left out.
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}
# Options of functions that a cached loop calls. These functions are inlined, so that cached and
# fresh kernels match bitwise.
INLINED_OPTIONS: Final[dict[str, Any]] = {**LOOP_OPTIONS, "forceinline": True}


@cache
def has_compiler() -> bool:
    """Return whether Numba, of the extra ``[fast]``, is installed."""
    return find_spec("numba") is not None


@cache
def compile_loop(function: Callable[..., None], signature: Any) -> Callable[..., None]:
    """Compile a function of arrays or records of arrays for one Numba signature.

    Compiling takes about a second, and loading from the cache a tenth of it. The cache lies beside
    the function's file, or in the user's cache.
    """
    from numba import njit

    try:
        compiled = njit(cache=True, **LOOP_OPTIONS)(function)
        compiled.compile(signature)
    # The cache cannot be written, or was written by a version with other names of records.
    except (OSError, RuntimeError, AttributeError, ImportError):
        compiled = njit(**LOOP_OPTIONS)(function)
        compiled.compile(signature)
    release_code("llvmlite")  # frees 50 MB
    loop: Callable[..., None] = compiled
    return loop
