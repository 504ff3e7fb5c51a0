"""Tuning of memory, garbage collector and threads of the whole process.

The command line runs within ``ProcessTuning``. Importing this package changes nothing in a process:
the functions of this module that trim memory, release code or freeze objects do nothing unless the
process is tuned.

>>> with ProcessTuning():  # in a program of your own
...     is_tuned()
True
"""

from __future__ import annotations

import gc
import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import wraps
from pathlib import Path
from typing import Final, ParamSpec

from objconnect.scene.runtime.memory import resident_bytes

Arguments = ParamSpec("Arguments")

_MAPS = Path("/proc/self/maps")
# Parameters of glibc's mallopt.
_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
# Trim threshold: bytes that may stay free at the end of the heap.
_MAX_FREE_BYTES: Final = 1 << 30
# Mmap threshold: larger blocks are mapped separately. It is glibc's maximum.
_MAX_HEAP_BLOCK_BYTES: Final = 1 << 25
# MADV_DONTNEED of madvise.
_DONTNEED: Final = 4
# oneDNN, torch's library on CPUs, compiles a convolution for each image size and caches the last
# 1024: about 100 MB after fifty photographs rotated by different angles. The 32 of one or two image
# sizes suffice: recompiling takes 2 to 5 % of a query. oneDNN reads the variable before the first
# convolution of the process.
_CONVOLUTION_CACHE: Final = ("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "32")


class ProcessTuning:
    """A context that tunes the process.

    It caches few compiled convolutions and hides Pillow's warnings. Freed memory stays allocated
    for the next query up to a bound (``retain_heap``, ``trim_heap_above``). The garbage
    collector skips the objects of a prepared localizer (``freeze_objects``). The code of a
    finished compiler is released (``release_code``). Threads for compiled loops are kept
    (``worker_threads``). Environment variables of the user take precedence.

    Leaving ends the threads, and restores the environment, the warnings and the collector. The
    thresholds of the C library stay, because they cannot be read.
    """

    def __enter__(self) -> ProcessTuning:
        """Tune the process."""
        name, value = _CONVOLUTION_CACHE
        with ExitStack() as restored:
            if name not in os.environ:
                os.environ[name] = value
                restored.callback(os.environ.pop, name, None)
            restored.enter_context(warnings.catch_warnings())
            # Our own messages cover large images and damaged EXIF.
            warnings.filterwarnings("ignore", module=r"PIL\.")
            self.threads = restored.enter_context(ThreadPoolExecutor(os.cpu_count() or 1))
            self._restored = restored.pop_all()
        _active_tunings.append(self)
        return self

    def __exit__(self, *error: object) -> None:
        """Restore the process."""
        _active_tunings.remove(self)
        self._restored.close()
        if not _active_tunings:
            gc.unfreeze()


_active_tunings: Final[list[ProcessTuning]] = []


def is_tuned() -> bool:
    """Return whether ``ProcessTuning`` is entered."""
    return bool(_active_tunings)


def _skip_outside_tuning(function: Callable[Arguments, None]) -> Callable[Arguments, None]:
    """Return a function that does nothing unless the process is tuned."""

    @wraps(function)
    def guard(*args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
        if is_tuned():
            function(*args, **kwargs)

    return guard


@_skip_outside_tuning
def trim_heap() -> None:
    """Return freed memory to the system, if the C library can.

    Otherwise a network that processes images of many sizes leaves a gigabyte unused.
    """
    import ctypes

    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return


@_skip_outside_tuning
def trim_heap_above(bound: int) -> None:
    """Return freed memory to the system if the process holds more than ``bound`` bytes.

    Below the bound it is kept, because allocating it again costs time.
    """
    if resident_bytes() > bound:
        trim_heap()


@_skip_outside_tuning
def retain_heap() -> None:
    """Keep freed memory for the next pass of a network, if the C library can.

    glibc returns free memory at the end of its heap if it exceeds twice the largest block that was
    ever freed. The feature maps of an image take about 50 MB, and allocating them again costs a
    tenth of a query. ``trim_heap`` returns the memory. Thresholds in environment variables take
    precedence.
    """
    import ctypes

    if any(name.startswith("MALLOC_") or name == "GLIBC_TUNABLES" for name in os.environ):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
        # Setting either threshold disables glibc's dynamic adjustment of both.
        if mallopt(_MMAP_THRESHOLD, _MAX_HEAP_BLOCK_BYTES):
            mallopt(_TRIM_THRESHOLD, _MAX_FREE_BYTES)
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return


@_skip_outside_tuning
def release_code(library: str) -> None:
    """Release the code pages of a loaded library; the system reloads them if it runs again.

    Otherwise a compiler stays resident after its work.

    Args:
        library: part of the name of its file.
    """
    import ctypes

    try:
        mappings = _MAPS.read_text().splitlines()
        madvise = ctypes.CDLL(None).madvise
    except (AttributeError, OSError, TypeError):  # not Linux
        return
    madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for line in mappings:
        span, access, *_, file = line.split(maxsplit=5)
        # Only code pages are sure to equal the file.
        if access == "r-xp" and library in file.rpartition("/")[2]:
            begin, end = (int(side, 16) for side in span.split("-"))
            madvise(begin, end - begin, _DONTNEED)


@_skip_outside_tuning
def freeze_objects() -> None:
    """Collect garbage once, then freeze all live objects so that later collections skip them.

    A full collection visits every object at an arbitrary time. With the modules that a localizer
    loads, that is a pause of 100 ms in the middle of a query.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


@contextmanager
def worker_threads() -> Iterator[ThreadPoolExecutor]:
    """Yield a thread pool for work that releases the interpreter's lock.

    A tuned process keeps its threads; otherwise they end with the block. Work in the pool must not
    wait for other work in it.
    """
    if is_tuned():
        yield _active_tunings[-1].threads
        return
    with ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        yield threads
