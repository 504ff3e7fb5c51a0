"""Running of a command line in this process, and its changes to the tree."""

from __future__ import annotations

import hashlib
import io
import logging
import os
import resource
import signal
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from benchmark.cli import app

COMMAND: Any = typer.main.get_command(app)

# A command line that takes longer waits for something that never comes, also on a busy machine.
PATIENCE_S = 300.0
# More memory than any small tree asks for, and less than a test may take from its machine.
_MEMORY = 4 << 30


class Hangs(BaseException):
    """The command waited for too long."""


class Begun(BaseException):
    """The command found nothing wrong and began its work."""


@dataclass(frozen=True)
class Outcome:
    """What a person sees of a command; ``begun`` when it was stopped at the work itself."""

    code: int
    stdout: str
    stderr: str
    begun: bool


def run(words: Sequence[str]) -> Outcome:
    """Run ``objconnect`` with these words; what libraries write by themselves is caught, too."""
    with ExitStack() as stack:
        # Beside the tests' own streams, and not among the temporary files that are watched.
        files = [stack.enter_context(tempfile.TemporaryFile(dir=memory())) for _ in range(2)]
        begun = False
        with _streams(files), _fresh_logging(), _limits():
            try:
                COMMAND.main(args=list(words), prog_name="objconnect")
                code = -1  # it always ends by SystemExit
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else 0
            except Begun:
                code, begun = 0, True
        texts = []
        for file in files:
            file.seek(0)
            texts.append(file.read().decode(errors="surrogateescape"))
    return Outcome(code, texts[0], texts[1], begun)


def snapshot(root: Path) -> dict[str, str]:
    """Kind, mode and content of everything below a folder, by its name; links are not followed.

    Paths stay bytes: this runs twice per case, and ``pathlib`` takes most of its time.
    """
    found: dict[str, str] = {}
    top = os.fsencode(root)
    folders = [top]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                status = entry.stat(follow_symlinks=False)
                content = ""
                if entry.is_symlink():
                    content = os.fsdecode(os.readlink(entry.path))  # noqa: PTH115
                elif entry.is_dir():
                    folders.append(entry.path)
                elif entry.is_file():
                    with open(entry.path, "rb") as file:  # noqa: PTH123
                        content = hashlib.blake2b(file.read()).hexdigest()
                name = os.fsdecode(entry.path[len(top) + 1 :])
                kind = stat.S_IFMT(status.st_mode)
                found[name] = f"{kind:o} {stat.S_IMODE(status.st_mode):o} {content}"
    return found


def differences(before: dict[str, str], after: dict[str, str]) -> dict[str, str]:
    """What happened to each name: it is new, gone or changed."""
    names = sorted(before.keys() | after.keys())
    happened = {}
    for name in names:
        if name not in before:
            happened[name] = "new"
        elif name not in after:
            happened[name] = "gone"
        elif before[name] != after[name]:
            happened[name] = "changed"
    return happened


def memory() -> str | None:
    """A folder in memory, where thousands of small trees are made and removed in no time."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


@contextmanager
def _streams(files: Sequence[Any]) -> Iterator[None]:
    """Standard output and error, of Python and of the process, into files."""
    kept, ours = (sys.stdout, sys.stderr), (os.dup(1), os.dup(2))
    for stream in kept:
        stream.flush()
    for number, file in enumerate(files, 1):
        os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(os.fdopen(os.dup(number), "wb"), encoding="utf-8", write_through=True)
        for number in (1, 2)
    )
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.close()
        sys.stdout, sys.stderr = kept
        for number, old in enumerate(ours, 1):
            os.dup2(old, number)
            os.close(old)


@contextmanager
def _fresh_logging() -> Iterator[None]:
    """As in a new process: the command line sets up its own logging."""
    root = logging.getLogger()
    kept, level = root.handlers[:], root.level
    root.handlers[:] = []
    try:
        yield
    finally:
        root.handlers[:] = kept
        root.setLevel(level)


@contextmanager
def _limits() -> Iterator[None]:
    """A file without an end costs no more than this, and a pipe that nobody writes no longer."""

    def hang(number: int, frame: object) -> None:
        raise Hangs

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + _MEMORY, hard))
    before = signal.signal(signal.SIGALRM, hang)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
