"""Settings of a rendering process: when it ends, and the core on which it runs."""

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


def end_with(parent: int) -> None:
    """Ask the kernel to kill this process when the process ``parent`` ends for any reason.

    Otherwise a killed run would leave processes that write the frames that the next run renders.
    Only Linux offers this; on other systems nothing happens.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit("the process that wanted these frames has ended")


def keep_to_one_core() -> None:
    """Bind this process to one core that no other rendering process uses.

    With one thread, Blender starts a second one that polls for work. It would occupy a core and
    slow down other renderers on the machine. On a single core it yields to the first. A core is
    reserved by a name in the kernel that disappears with the process. Where no core is free, and on
    systems other than Linux, nothing happens.
    """
    if sys.platform != "linux":
        return
    cores = list(os.sched_getaffinity(0))
    random.shuffle(cores)  # containers may share cores but not these names
    for core in cores:
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            mark.bind(f"\0objconnect-renders-on-{core}")
        except OSError:
            mark.close()
            continue
        for thread in Path("/proc/self/task").iterdir():  # later threads inherit the core
            with suppress(ProcessLookupError):  # the thread has ended in the meantime
                os.sched_setaffinity(int(thread.name), {core})
        mark.detach()
        return
