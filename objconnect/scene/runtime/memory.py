"""Resident memory of the process, now and at its peak, and how to have less of it."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from pathlib import Path
from typing import Final

_HELD = Path("/proc/self/statm")
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
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
# Convolutions that are kept: those of a network for one or two sizes.
_KERNELS = "32"


def resident_bytes() -> int:
    """Return the resident memory, bytes; where the system does not report it, its largest value."""
    try:
        pages = int(_HELD.read_text().split()[1])
    except OSError:
        return _most_ever()
    return pages * os.sysconf("SC_PAGE_SIZE")


def return_freed() -> None:
    """Give memory that was freed back to the system, where its C library can.

    A network that sees pictures of many sizes otherwise leaves a gigabyte that nothing uses.
    """
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return


def return_freed_above(bound: int) -> None:
    """Give memory that was freed back where the process holds more than ``bound`` bytes.

    To take it again later costs time, which is lost where there is room.
    """
    if resident_bytes() > bound:
        return_freed()


def keep_freed() -> None:
    """Keep memory that was freed for the next pass of a network, where the C library can.

    glibc gives back what is free at the end of its heap, once that is twice the largest block that
    it ever freed. The maps of a picture are some 50 MB, and to take them again costs a tenth of a
    query. ``return_freed`` gives it back. Thresholds that the environment gives are left as they
    are.
    """
    if any(name.startswith("MALLOC_") or name == "GLIBC_TUNABLES" for name in os.environ):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
        # Either one ends that glibc chooses both by the blocks it frees.
        if mallopt(_MMAP_THRESHOLD, _BLOCK):
            mallopt(_TRIM_THRESHOLD, _FREE_AT_END)
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return


def return_code(library: str) -> None:
    """Give the code of a loaded library back to the system, which reads it again where it runs.

    A compiler that has done its work otherwise stays resident.

    Args:
        library: a part of the name of its file.
    """
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


def keep_few_kernels() -> None:
    """Keep the compiled convolutions of few sizes of pictures.

    oneDNN, with which torch computes on processors, compiles each convolution for each size and
    keeps the last 1024: some 100 MB after fifty photographs that were turned by as many angles. To
    compile some again takes 2 to 5 % of a query. The call must come before the first convolution of
    the process; a number that the environment gives is left as it is.
    """
    os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", _KERNELS)


def spare_collector() -> None:
    """Spare Python's garbage collector all objects that there are now.

    A full collection looks at every object of the process and comes when it will: with the modules
    that a localizer loads, a pause of 100 ms in the middle of a query. Objects of now are looked
    at once more here, and then not until the next call.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def reset_peak() -> None:
    """Reset the peak, where the system allows it; else it is counted since the process began."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return


def peak_megabytes() -> float | None:
    """Return the largest resident memory since ``reset_peak``, 1e6 bytes; None where unknown."""
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    return _most_ever() / 1e6 or None


def _most_ever() -> int:
    """Return the largest resident memory since the process began, bytes; 0 where unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024)
