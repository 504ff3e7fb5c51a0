"""What a rendering process knows of itself: its core, and whether it is still wanted."""

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
    """Be killed when the process `parent` ends, however it ends; at once when it has ended.

    A killed run must leave no process behind that writes the frames its successor renders. Only
    Linux offers this; elsewhere nothing happens.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit("the process that wanted these frames has ended")


def keep_to_one_core() -> None:
    """Let this process run on one core alone, which no other such process takes until it ends.

    Told to render with one thread, Blender keeps a second that looks for work without rest: it
    takes a core, does nothing, and slows down whoever else renders on the machine. On one core it
    gives way. Cores are marked as taken by names of the kernel's that end with their owner. Where
    all are taken, and where the system is not Linux, nothing happens.
    """
    if sys.platform != "linux":
        return
    cores = list(os.sched_getaffinity(0))
    random.shuffle(cores)  # containers on one machine may share its cores and not its names
    for core in cores:
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            mark.bind(f"\0objconnect-renders-on-{core}")
        except OSError:
            mark.close()
            continue
        for thread in Path("/proc/self/task").iterdir():  # later ones follow who starts them
            with suppress(ProcessLookupError):  # one that has ended meanwhile
                os.sched_setaffinity(int(thread.name), {core})
        mark.detach()
        return
