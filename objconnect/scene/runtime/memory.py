"""Resident memory of the process and its peak."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_STATM = Path("/proc/self/statm")
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


def resident_bytes() -> int:
    """Return the resident memory, bytes; its peak on systems that do not report it."""
    try:
        pages = int(_STATM.read_text().split()[1])
    except OSError:
        return _lifetime_peak()
    return pages * os.sysconf("SC_PAGE_SIZE")


def reset_peak() -> None:
    """Reset the peak if the system allows it; else the peak of the whole process remains."""
    try:
        _CLEAR.write_text("5")  # resets VmHWM
    except OSError:
        return


def peak_megabytes() -> float | None:
    """Return the peak of resident memory since ``reset_peak``, 1e6 bytes; None if unknown."""
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    return _lifetime_peak() / 1e6 or None


def _lifetime_peak() -> int:
    """Return the peak of resident memory since the process began, bytes; 0 if unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024)
