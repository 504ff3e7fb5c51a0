"""Resident memory of the process, now and at its peak."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_HELD = Path("/proc/self/statm")
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


def resident_bytes() -> int:
    """Return the resident memory, bytes; where the system does not report it, its largest value."""
    try:
        pages = int(_HELD.read_text().split()[1])
    except OSError:
        return _most_ever()
    return pages * os.sysconf("SC_PAGE_SIZE")


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
