"""What a rendering process knows of itself: its memory, and whether it is still wanted."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from pathlib import Path

_PR_SET_PDEATHSIG = 1


def resident_bytes() -> int:
    """Memory held now; where the system does not say, the most that was ever held."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak * (1 if sys.platform == "darwin" else 1024)
    return pages * os.sysconf("SC_PAGE_SIZE")


def end_with(parent: int) -> None:
    """Be killed when the process `parent` ends, however it ends; at once when it has ended.

    A killed run must leave no process behind that writes the frames its successor renders. Only
    Linux offers this; elsewhere nothing happens.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit("the process that wanted these frames has ended")
