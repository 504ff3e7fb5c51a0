"""Control the lifetime and the CPU core of a rendering process."""

from __future__ import annotations

import ctypes
import os
import random
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
# Prefix of the socket names that reserve cores. All runs on a machine use the same names.
_CORE_LOCK_PREFIX = "objconnect-renders-on"


def end_with(parent: int) -> None:
    """Make the kernel kill this process when the process ``parent`` ends.

    Otherwise the processes of a killed run would write the same frames as the next run. This works
    only on Linux; on other systems it does nothing.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit("the process that requested these frames has ended")


def keep_to_one_core() -> None:
    """Bind this process to one core that no other rendering process uses.

    Blender with one thread starts a second one that polls for work and would occupy another core.
    On a single core, the second thread yields to the first. A core is reserved by an abstract
    socket name, which disappears with the process. Without a free core, and on systems other than
    Linux, the process is not bound.
    """
    if sys.platform != "linux":
        return
    cores = list(os.sched_getaffinity(0))
    random.shuffle(cores)  # containers may share cores but not these names
    for core in cores:
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            lock.bind(f"\0{_CORE_LOCK_PREFIX}-{core}")
        except OSError:
            lock.close()
            continue
        for thread in Path("/proc/self/task").iterdir():  # later threads inherit the core
            with suppress(ProcessLookupError):  # the thread has ended in the meantime
                os.sched_setaffinity(int(thread.name), {core})
        lock.detach()
        return
