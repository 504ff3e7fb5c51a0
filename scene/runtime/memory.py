"""How much memory the process holds, and needed at most."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_HELD = Path("/proc/self/statm")
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


def resident_bytes() -> int:
    """Memory held now; where the system does not say, the most that was ever held."""
    try:
        pages = int(_HELD.read_text().split()[1])
    except OSError:
        return _most_ever()
    return pages * os.sysconf("SC_PAGE_SIZE")


def reset_peak() -> None:
    """Start counting anew, where the system allows it; else the peak is since the process began."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return


def peak_megabytes() -> float | None:
    """Largest resident memory since ``reset_peak``, in 1e6 bytes; None where nobody tells."""
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    return _most_ever() / 1e6 or None


def _most_ever() -> int:
    """Largest resident memory since the process began, bytes; 0 where nobody tells."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024)
