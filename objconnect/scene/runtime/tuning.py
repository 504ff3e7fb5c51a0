"""Tuning of a whole process for queries to a network, which only the owner of the process enters.

The command line enters ``ProcessTuning``. A program that imports this package does not, so that
nothing of its process changes: the other functions of this module, which tell when memory may go
back and when the collector may be spared, then do nothing.

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
# Bytes that may be free at the end of the heap, and above which a block is taken from the system by
# itself: the most that glibc takes for the latter.
_FREE_AT_END: Final = 1 << 30
_BLOCK: Final = 1 << 25
# Advice of madvise: the pages are not needed now.
_DONTNEED: Final = 4
# oneDNN, with which torch computes on processors, compiles each convolution for each size of
# picture and keeps the last 1024: some 100 MB after fifty photographs that were turned by as many
# angles. Those of a network for one or two sizes are enough: to compile some again takes 2 to 5 %
# of a query. oneDNN reads the variable before the first convolution of the process.
_KERNELS: Final = ("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "32")


class ProcessTuning:
    """Tunes the process while it is entered.

    Few compiled convolutions are kept, and Pillow's warnings are not printed. Memory that was freed
    stays for the next query up to a bound (``retain_heap``, ``return_freed_above``), Python's
    collector leaves out what a prepared localizer holds (``spare_collector``), the code of a
    compiler that has done its work goes back (``return_code``), and threads for compiled loops stay
    (``worker_threads``). What the environment says of memory or convolutions is left as it is.

    Leaving ends the threads, and restores the environment, the warnings and the collector.
    Thresholds of the C library stay, for it does not tell what they were.
    """

    def __enter__(self) -> ProcessTuning:
        """Tune the process from now on."""
        name, value = _KERNELS
        with ExitStack() as restored:
            if name not in os.environ:
                os.environ[name] = value
                restored.callback(os.environ.pop, name, None)
            restored.enter_context(warnings.catch_warnings())
            # They are about large images and damaged EXIF, which messages of ours tell.
            warnings.filterwarnings("ignore", module=r"PIL\.")
            self.threads = restored.enter_context(ThreadPoolExecutor(os.cpu_count() or 1))
            self._restored = restored.pop_all()
        _entered.append(self)
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the process as it was."""
        _entered.remove(self)
        self._restored.close()
        if not _entered:
            gc.unfreeze()


_entered: Final[list[ProcessTuning]] = []


def is_tuned() -> bool:
    """Return whether ``ProcessTuning`` is entered."""
    return bool(_entered)


def _only_when_tuned(function: Callable[Arguments, None]) -> Callable[Arguments, None]:
    """Return a function that does nothing where the process is not tuned."""

    @wraps(function)
    def guard(*given: Arguments.args, **named: Arguments.kwargs) -> None:
        if is_tuned():
            function(*given, **named)

    return guard


@_only_when_tuned
def trim_heap() -> None:
    """Give memory that was freed back to the system, where its C library can.

    A network that sees pictures of many sizes otherwise leaves a gigabyte that nothing uses.
    """
    import ctypes

    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return


@_only_when_tuned
def return_freed_above(bound: int) -> None:
    """Give memory that was freed back where the process holds more than ``bound`` bytes.

    To take it again later costs time, which is lost where there is room.
    """
    if resident_bytes() > bound:
        trim_heap()


@_only_when_tuned
def retain_heap() -> None:
    """Keep memory that was freed for the next pass of a network, where the C library can.

    glibc gives back what is free at the end of its heap, once that is twice the largest block that
    it ever freed. The maps of a picture are some 50 MB, and to take them again costs a tenth of a
    query. ``trim_heap`` gives it back. Thresholds that the environment gives are left as they
    are.
    """
    import ctypes

    if any(name.startswith("MALLOC_") or name == "GLIBC_TUNABLES" for name in os.environ):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
        # Either one ends that glibc chooses both by the blocks it frees.
        if mallopt(_MMAP_THRESHOLD, _BLOCK):
            mallopt(_TRIM_THRESHOLD, _FREE_AT_END)
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return


@_only_when_tuned
def return_code(library: str) -> None:
    """Give the code of a loaded library back to the system, which reads it again where it runs.

    A compiler that has done its work otherwise stays resident.

    Args:
        library: a part of the name of its file.
    """
    import ctypes

    try:
        mapped = _MAPS.read_text().splitlines()
        madvise = ctypes.CDLL(None).madvise
    except (AttributeError, OSError, TypeError):  # not Linux
        return
    madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for line in mapped:
        span, access, *_, file = line.split(maxsplit=5)
        # Only code is sure to be as it is in the file.
        if access == "r-xp" and library in file.rpartition("/")[2]:
            begin, end = (int(side, 16) for side in span.split("-"))
            madvise(begin, end - begin, _DONTNEED)


@_only_when_tuned
def spare_collector() -> None:
    """Spare Python's garbage collector all objects that there are now.

    A full collection looks at every object of the process and comes when it will: with the modules
    that a localizer loads, a pause of 100 ms in the middle of a query. Objects of now are looked
    at once more here, and then not until the next call.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


@contextmanager
def worker_threads() -> Iterator[ThreadPoolExecutor]:
    """Yield threads for work that releases the interpreter's lock.

    In a tuned process they stay for the next work; else they end with the block. Work in them must
    not wait for other work in them.
    """
    if is_tuned():
        yield _entered[-1].threads
        return
    with ThreadPoolExecutor(os.cpu_count() or 1) as threads:
        yield threads
