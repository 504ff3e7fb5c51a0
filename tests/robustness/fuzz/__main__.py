"""Feeds mutated real files to every reader.

    python -m tests.robustness.fuzz [--inputs N] [--seed S] [--reader NAME...] [--keep DIR]

Expected of each input is a result or an ``InputError``. A finding is any other exception, an
allocation that fails beyond 1 GB over what the empty process holds, 5 s of processor time (or five
minutes of any time), the end of the process, and a file outside the input's folder that is opened.
Readers run in a process of their own, which is started again when an input ends it. Inputs follow
from the seed and their number alone: ``--only NUMBER`` runs one of one reader again.
"""

from __future__ import annotations

import argparse
import json
import mmap
import os
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import torch

from objconnect.scene.errors import InputError
from objconnect.scene.storage.digests import FOLDER_VARIABLE
from tests.robustness.fuzz.mutations import spoil
from tests.robustness.fuzz.readers import READERS, ROOT, Reader

MEMORY = 10**9
SECONDS = 5.0
_ANY_SECONDS = 300.0
# Inputs that one process is given: what the libraries leak stays small.
_TURN = 4000
# Readers take turns so many times, so that a run cut short has looked at all of them.
_PARTS = 100
# Folders that libraries read while they work.
_OWN = ("/proc/", "/sys/", "/dev/", "/usr/lib", "/usr/share", "/etc/ssl", "/etc/localtime")
_WATCHED = {"open", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "shutil.rmtree", "os.listdir"}
_FORBIDDEN = {"pickle.find_class", "subprocess.Popen", "os.system", "os.exec", "socket.connect"}


class Escaped(BaseException):
    """An input made its reader do what no reader does."""


def fuzz(names: list[str], inputs: int, seed: int, keep: Path, only: int | None) -> int:
    """Run, and return the number of kinds of findings."""
    total = sum(READERS[name].share for name in names)
    counts = {name: max(1, round(inputs * READERS[name].share / total)) for name in names}
    # A forked process has none of torch's threads and would wait for them.
    torch.set_num_threads(1)
    os.environ[FOLDER_VARIABLE] = ""  # digests of inputs are remembered nowhere
    findings: Counter[str] = Counter()
    done, began = 0, time.monotonic()
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a disk waits at every file
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=memory) as scratch:
        folder = Path(scratch).resolve()
        for name in names:
            READERS[name].make(_make(folder / f"{name}-whole"))
            for _, read in READERS[name].files.values():
                read(_copy(folder, name))  # what is whole is read
        parts = _PARTS if only is None else 1
        for part in range(parts):
            for name in names:
                bounds = (counts[name] * k // parts for k in (part, part + 1))
                numbers = range(*bounds) if only is None else range(only, only + 1)
                for finding in _turns(name, numbers, seed, folder):
                    if finding["what"] not in findings:
                        _keep(finding, keep)
                        print(f"{name} {finding['number']}: {finding['what']}", flush=True)
                    findings[finding["what"]] += 1
                done += len(numbers)
            used = resource.getrusage(resource.RUSAGE_CHILDREN)
            print(
                f"{done} inputs of {len(names)} readers after {time.monotonic() - began:.0f} s, "
                f"{used.ru_utime + used.ru_stime:.0f} s of a core; {len(findings)} findings",
                flush=True,
            )
    for what, times in findings.most_common():
        print(f"{times:7d} x {what}")
    print(f"{done} inputs, {len(findings)} kinds of findings")
    return len(findings)


def _make(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _copy(folder: Path, name: str) -> Path:
    """The whole files of a reader anew, in the folder where they are spoiled."""
    shutil.rmtree(folder / name, ignore_errors=True)
    shutil.copytree(folder / f"{name}-whole", folder / name)
    return folder / name


def _turns(name: str, numbers: range, seed: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Findings of some inputs, whatever becomes of the processes that read them."""
    at = numbers.start
    current = mmap.mmap(-1, 8)
    while at < numbers.stop:
        whole, spoiled = folder / f"{name}-whole", _copy(folder, name)
        last = min(at + _TURN, numbers.stop)
        current[:] = struct.pack("<q", at)
        read, write = os.pipe()
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            os.close(read)
            _work(name, range(at, last), seed, whole, spoiled, current, write)
        os.close(write)
        with os.fdopen(read) as lines:
            yield from map(json.loads, lines)
        _, status = os.waitpid(child, 0)
        at = last
        if status:
            (number,) = struct.unpack("<q", current[:])
            yield {"number": number, "what": f"{name}: {_end(status)}", "trace": ""}
            at = number + 1


def _end(status: int) -> str:
    if not os.WIFSIGNALED(status):
        return f"the process ended with {os.waitstatus_to_exitcode(status)}"
    number = os.WTERMSIG(status)
    if number == signal.SIGPROF:
        return f"works for more than {SECONDS:.0f} s"
    if number == signal.SIGALRM:
        return f"hangs for more than {_ANY_SECONDS:.0f} s"
    return f"the process was killed by {signal.Signals(number).name}"


def _work(
    name: str,
    numbers: range,
    seed: int,
    whole: Path,
    spoiled: Path,
    current: mmap.mmap,
    pipe: int,
) -> None:
    """The life of a child: never returns."""
    held = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY, held + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    _guard(spoiled)
    reader = READERS[name]
    files = {path: (whole / path).read_bytes() for path in reader.files}
    code = 1
    try:
        with os.fdopen(pipe, "w") as out:
            for number in numbers:
                current[:] = struct.pack("<q", number)
                finding = _one(reader, files, number, f"{seed} {name} {number}", spoiled)
                if finding is not None:
                    what, trace = finding
                    line = {"number": number, "what": f"{name}: {what}", "trace": trace}
                    out.write(json.dumps(line) + "\n")
        code = 0
    finally:
        os._exit(code)


def _one(
    reader: Reader, files: dict[str, bytes], number: int, seed: str, spoiled: Path
) -> tuple[str, str] | None:
    """Read one input: what was found and where, or None."""
    rng = Random(seed)
    path = rng.choice(list(files))
    target = spoiled / path
    kind, read = reader.files[path]
    target.write_bytes(spoil(rng, kind, files[path]))
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.setitimer(signal.ITIMER_REAL, _ANY_SECONDS)
    try:
        read(spoiled)
    except InputError as error:
        if _out_of_memory(error):
            return f"{path} asks for too much memory: {_where(error)}", traceback.format_exc()
    except BaseException as error:
        return f"{path}: {type(error).__name__} {_where(error)}", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(files[path])
    return None


def _out_of_memory(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, MemoryError) or "allocate" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _where(error: BaseException) -> str:
    """The last line of ours that the error went through."""
    innermost = error
    while innermost.__context__ is not None and isinstance(error, InputError):
        innermost = innermost.__context__
    lines = [
        f"{Path(frame.filename).relative_to(ROOT)}:{frame.lineno} {frame.name}"
        for frame in traceback.extract_tb(innermost.__traceback__)
        if frame.filename.startswith(f"{ROOT}/") and "/tests/" not in frame.filename
    ]
    return f"at {lines[-1]}" if lines else repr(str(error)[:200])


def _guard(folder: Path) -> None:
    """From now on nothing but the folder and the libraries is opened, and nothing else begun."""
    own = (str(folder), str(ROOT), sys.prefix, sys.base_prefix, *_OWN)

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _FORBIDDEN:
            raise Escaped(f"{event} {arguments}")
        if event in _WATCHED and isinstance(arguments[0], str | bytes):
            path = os.path.abspath(os.fsdecode(arguments[0]))  # noqa: PTH100, links stay
            if not path.startswith(own):
                raise Escaped(f"{event} outside: {arguments[0]!r}")

    sys.addaudithook(watch)


def _keep(finding: dict[str, Any], keep: Path) -> None:
    name, number = finding["what"].split(":")[0], finding["number"]
    keep.mkdir(parents=True, exist_ok=True)
    (keep / f"{name}-{number}.txt").write_text(f"{finding['what']}\n{finding['trace']}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=20_000, help="of all readers together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", nargs="+", choices=READERS, default=list(READERS))
    parser.add_argument("--keep", type=Path, default=Path("runs/fuzz"), help="for tracebacks")
    parser.add_argument("--only", type=int, help="number of one input of one reader")
    given = parser.parse_args()
    sys.exit(1 if fuzz(given.reader, given.inputs, given.seed, given.keep, given.only) else 0)
