"""``python -m tests.robustness.misuse.not_unix GATE OUT``: our code as on another system than Unix.

Every module of ours sees ``os``, ``signal``, ``socket`` and ``sys`` without what Unix alone has,
and cannot import what is there on Unix alone. Other packages see all: they have branches of their
own, which are not ours to try. Then everything but rendering is imported, and the gate localized.
"""

from __future__ import annotations

import builtins
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).parents[3]
OURS = ("scene", "dense", "simulate", "ingest", "baselines", "objconnect", "benchmark")


def _words(text: str) -> set[str]:
    return set(text.split())


# https://docs.python.org/3/library/unix.html, and readline and curses, which Windows lacks too.
UNIX = _words("posix pwd grp spwd crypt termios tty pty fcntl resource syslog nis readline curses")
HIDDEN = {
    "os": _words(
        "fork forkpty getuid geteuid getgid getegid getgroups getpgid getpgrp setsid setuid "
        "setgid killpg nice chroot chown lchown fchown fchmod mkfifo mknod openpty posix_fadvise "
        "posix_fallocate posix_spawn pread pwrite sched_getaffinity sched_setaffinity sched_yield "
        "statvfs fstatvfs sysconf confstr sync uname wait wait3 wait4 getxattr setxattr waitid "
        "O_DIRECTORY O_NOFOLLOW O_CLOEXEC O_NONBLOCK O_SYNC O_TMPFILE WNOHANG WIFEXITED "
        "memfd_create pipe2 copy_file_range sendfile getloadavg ctermid major minor"
    ),
    "signal": _words(
        "SIGHUP SIGKILL SIGALRM SIGUSR1 SIGUSR2 SIGCHLD SIGCONT SIGSTOP SIGQUIT SIGPIPE SIGTSTP "
        "alarm setitimer pause pthread_sigmask pthread_kill sigwait siginterrupt"
    ),
    "socket": {"AF_UNIX", "socketpair"},
    "sys": set(),
}
SAYS = {"sys": {"platform": "win32"}, "os": {"name": "nt"}}


class _Elsewhere(ModuleType):
    """A module as our code sees it."""

    def __init__(self, module: ModuleType) -> None:
        super().__init__(module.__name__)
        self._module = module

    def __getattr__(self, name: str) -> Any:
        if name in HIDDEN[self.__name__]:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} elsewhere")
        return SAYS.get(self.__name__, {}).get(name) or getattr(self._module, name)


def hide() -> None:
    """From now on what our modules import is as elsewhere."""
    seen = {name: _Elsewhere(__import__(name)) for name in HIDDEN}
    ordinary = builtins.__import__

    def elsewhere(
        name: str,
        globals: Mapping[str, Any] | None = None,
        locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        importer = str((globals or {}).get("__name__", ""))
        if importer.partition(".")[0] not in OURS:
            return ordinary(name, globals, locals, fromlist, level)
        if name.partition(".")[0] in UNIX:
            raise ModuleNotFoundError(f"No module named {name!r} elsewhere, for {importer}")
        found = ordinary(name, globals, locals, fromlist, level)
        return seen.get(found.__name__, found)

    builtins.__import__ = elsewhere


def main(gate: str, out: str) -> None:
    hide()
    for package in OURS:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            if name != "simulate.render.blender":  # needs Blender's module, which needs Linux
                __import__(name)

    from benchmark.cli import app
    from benchmark.doctor import _machine
    from objconnect.scene.runtime import memory

    memory._STATM = memory._STATUS = memory._CLEAR = ROOT / "no" / "proc"
    assert {"memory", "cores"} <= {check.name for check in _machine()}
    for words in (["--help"], ["evaluate", gate, "--method", "sift", "--out", out]):
        try:
            app(words)
        except SystemExit as end:
            assert not end.code, (words, end.code)


if __name__ == "__main__":
    main(*sys.argv[1:])
