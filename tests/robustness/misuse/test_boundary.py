"""Between a command and the shell: streams that cannot be written, signals, folders that may not be
looked into, and what an exception of any kind becomes."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from objconnect.scene.errors import InputError
from simulate.render.libraries import require_libraries
from tests.benchmark.made_data import write_flight
from tests.blender import require_blender
from tests.robustness.misuse.cases import CASES, Case, check_one_line, lay_out, words_of
from tests.robustness.misuse.commands import COMMANDS
from tests.robustness.misuse.harness import run, snapshot
from tests.robustness.misuse.world import make_scene

ROOT = Path(__file__).parents[3]
GATE = ROOT / "tests/data/gate-baseline"
OBJCONNECT = f"{sys.executable} -m benchmark.cli"
# Seconds after which a process hangs, also on a busy machine.
_HANGS_S = 300


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def shell(line: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A line of a shell; its exit code is that of the first command of a pipe."""
    return subprocess.run(
        ["bash", "-c", f"{line}\nexit ${{PIPESTATUS[0]}}"],
        capture_output=True,
        text=True,
        env=environment(**variables),
        check=False,
        timeout=_HANGS_S,
    )


# A command that prints what a table prints, without what real ones take so long to load.
REPORTING = """
import os, sys, types
from benchmark import cli
from objconnect.scene.errors import InputError

def validate(path, cache):
    if not path.is_dir():
        raise InputError(f"{path} is not a folder")
    with open(path / "written", "w") as file:
        os.write(1, b"a library says\\n"), os.write(2, b"a library says\\n")
        file.write("ours")
    return types.SimpleNamespace(ok=True, text=lambda: "within 10° " * 20000)

sys.modules["benchmark.validation"] = types.SimpleNamespace(validate=validate)
cli.main()
"""
HELP = f"{sys.executable} -m benchmark.cli --help"


@pytest.fixture
def report(tmp_path: Path) -> str:
    """A command line that prints much."""
    program = tmp_path / "program.py"
    program.write_text(REPORTING)
    folder = tmp_path / "folder"
    folder.mkdir()
    return f"{sys.executable} {program} validate {folder}"


def test_a_full_disk_is_no_regression(report: str) -> None:
    for command in (report, HELP):
        done = shell(f"{command} > /dev/full")
        assert done.returncode == 2
        assert done.stderr.endswith("objconnect: error: cannot write: the disk is full\n")
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("reader", ["true", "head -1", "head -c 1"])
def test_a_closed_pipe_ends_quietly(reader: str, report: str) -> None:
    """How much was written before the pipe closed is chance: all of it, or not."""
    for command in (f"{report} 2> /dev/null", HELP):
        done = shell(f"{command} | {reader}")
        assert done.returncode in (0, 128 + signal.SIGPIPE)
        assert done.stderr == ""


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&-", ">&- 2>&- <&-"])
def test_closed_standard_streams_are_harmless(closed: str, report: str, tmp_path: Path) -> None:
    """A file that is opened then never has the number of the stream, nor what is printed to it."""
    done = shell(f"{report} {closed}")
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert ("within" in done.stdout) == (not closed.startswith(">"))
    assert (tmp_path / "folder" / "written").read_text() == "ours"


@pytest.mark.parametrize("told", [">&-", "2>&-", "2> /dev/full", "> /dev/full 2>&1"])
def test_an_error_with_closed_streams_keeps_its_code(told: str, report: str) -> None:
    assert shell(f"{report}/nowhere {told}").returncode == 2


@pytest.mark.parametrize(
    "variables",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
)
def test_an_ascii_terminal_shows_escapes(variables: dict[str, str], report: str) -> None:
    done = shell(report, **variables)
    assert done.returncode == 0
    assert "within 10\\xb0" in done.stdout
    failed = shell(f"{report}/größe", **variables)
    assert failed.returncode == 2
    assert failed.stderr.startswith("objconnect: error: ")
    assert failed.stderr.count("\n") == 1


# A process as the command line makes it, whose work goes on until its standard input is closed.
WAITING = """
import signal, sys
from benchmark import cli

# A shell that runs the tests in the background lets them ignore Ctrl-C, and nohup SIGHUP.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

def wait(*arguments, **more):
    print("at work", flush=True)
    sys.stdin.read()

{patch}
sys.argv = ["objconnect", *{words!r}]
cli.main()
"""
EVALUATE = """
from pathlib import Path
import objconnect.methods
from tests.benchmark.made_data import FakeLocalizer

class Slow(FakeLocalizer):
    def prepare(self, sparse_map, images, cache=None):
        self.cache = cache
        if cache is not None:
            (cache / "features").write_text("many")
    def localize(self, query):
        if self.seen:
            wait()
        return super().localize(query)

objconnect.methods.create = lambda name, settings: Slow({})
"""
MAP = """
import objconnect.scene.colmap.triangulation
objconnect.scene.colmap.triangulation._triangulate = wait
"""


@contextmanager
def start_and_wait(
    patch: str, words: Sequence[object], temporary: Path, ignored: int | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A command in the midst of its work."""
    temporary.mkdir()
    if ignored is not None:
        patch += f"\nimport signal; signal.signal({int(ignored)}, signal.SIG_IGN)"
    program = WAITING.format(patch=patch, words=[str(word) for word in words])
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(TMPDIR=str(temporary)),
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if line != "at work\n":
                pytest.fail(f"{line}{process.communicate()[1]}")
            yield process
        finally:
            process.kill()


# Of each command one in the default part.
SIGNALS = [
    (signal.SIGTERM, "terminated"),
    pytest.param(signal.SIGHUP, "terminated", marks=pytest.mark.thorough),
]
BY_HAND = pytest.param(signal.SIGINT, "interrupted", marks=pytest.mark.thorough)


@pytest.mark.parametrize(("number", "word"), [*SIGNALS, BY_HAND])
def test_a_signal_during_evaluate(number: int, word: str, tmp_path: Path) -> None:
    """One that is ignored changes nothing: under nohup the terminal goes, the work stays.

    A query that is being answered is waited for: here until ``communicate`` closes the input.
    """
    flight, out = write_flight(tmp_path / "meadow"), tmp_path / "out"
    words = ["evaluate", flight, "--method", "fake", "--out", out]
    before = snapshot(flight)
    ignored = signal.SIGHUP if number == signal.SIGTERM else None
    with start_and_wait(EVALUATE, words, tmp_path / "tmp", ignored) as process:
        if ignored is not None:
            process.send_signal(ignored)
        process.send_signal(number)
        _, stderr = process.communicate(timeout=_HANGS_S)
    assert process.returncode == 128 + number
    assert stderr == f"objconnect: {word}\n"
    assert snapshot(flight) == before
    assert list((tmp_path / "tmp").iterdir()) == []
    # The query that was finished is kept for the next run, and nothing else.
    (left,) = [path for path in out.rglob("*") if path.is_file()]
    assert left.suffix == ".journal"


@pytest.mark.parametrize(("number", "word"), SIGNALS)
def test_a_signal_during_map(number: int, word: str, tmp_path: Path) -> None:
    """COLMAP's library is loaded by then, and has a word of its own for signals."""
    scene = make_scene(tmp_path / "hamlet")
    before = snapshot(scene / "map")
    with start_and_wait(MAP, ["map", scene], tmp_path / "tmp") as process:
        process.send_signal(number)
        _, stderr = process.communicate(timeout=_HANGS_S)
    assert (process.returncode, stderr) == (128 + number, f"objconnect: {word}\n")
    assert snapshot(scene / "map") == before
    assert list((tmp_path / "tmp").iterdir()) == []
    left = [path.name for path in scene.iterdir() if path.name.startswith(".")]
    assert left == [".objconnect-mapping"]  # features and matches, for the next run


def children(process: int) -> list[int]:
    listed = Path(f"/proc/{process}/task/{process}/children")
    return [int(child) for child in listed.read_text().split()]


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the children of a process")
@pytest.mark.parametrize(("number", "word"), SIGNALS)
def test_a_signal_during_rendering(number: int, word: str, tmp_path: Path) -> None:
    require_blender()
    require_libraries()
    out, temporary = tmp_path / "scene", tmp_path / "tmp"
    temporary.mkdir()
    config = tmp_path / "c.yaml"
    config.write_text(
        "area: 120\nsize: 512\nspp: 4000\nframes: 4\nsessions: ['summer-noon:nadir']\n"
    )
    words = ["simulate", "--config", config, "--out", out, "--jobs", 2]
    with subprocess.Popen(
        [*OBJCONNECT.split(), *(str(word) for word in words)],
        stderr=subprocess.PIPE,
        text=True,
        env=environment(TMPDIR=str(temporary)),
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # noqa: PLW1509 - nohup
    ) as process:
        try:
            begun = time.monotonic()
            while len(renderers := children(process.pid)) < 2:
                assert process.poll() is None
                assert time.monotonic() - begun < _HANGS_S
                time.sleep(0.1)
            process.send_signal(number)
            _, stderr = process.communicate(timeout=_HANGS_S)
        finally:
            process.kill()
    assert process.returncode == 128 + number
    assert stderr.splitlines()[-1] == f"objconnect: {word}"
    assert "Traceback" not in stderr
    # One that was being started when the signal came sees that it is alone, and ends by itself.
    ended = time.monotonic() + _HANGS_S
    while (alive := [child for child in renderers if is_alive(child)]) and time.monotonic() < ended:
        time.sleep(0.1)
    assert not alive
    assert list(temporary.iterdir()) == []
    assert not list(out.rglob("*.partial"))


def is_alive(process: int) -> bool:
    try:
        return "zombie" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


NOBODY = 65534


@contextmanager
def act_as_nobody(root: Path) -> Iterator[None]:
    """Without root's right to look everywhere; the tree is the user's."""
    if os.geteuid():
        yield
        return
    for path in [root.parent, *root.parent.rglob("*")]:
        os.chown(path, NOBODY, -1, follow_symlinks=False)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


def locked_cases() -> Iterator[Case]:
    """Every path that a command takes, as one of a folder that nobody may look into."""
    seen = set()
    for case in CASES:
        if case.name == "under_a_file":
            command = case.command.partition(":")[0]
            if (command, case.argument) not in seen:
                seen.add((command, case.argument))
                yield case


LOCKED = list(locked_cases())


@pytest.fixture
def open_tree() -> Iterator[Path]:
    """A folder that everybody may look into, and all the way to it."""
    with tempfile.TemporaryDirectory(prefix="locked-") as folder:
        Path(folder).chmod(0o755)
        root = Path(folder) / "tree"
        root.mkdir()
        yield root


@pytest.mark.parametrize("case", LOCKED, ids=[case.id for case in LOCKED])
def test_a_folder_that_nobody_may_look_into(
    case: Case, whole: Path, open_tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tree = open_tree
    monkeypatch.chdir(tree)
    lay_out(whole, COMMANDS[case.command], tree)
    (tree / "locked" / "inner").mkdir(parents=True)
    words = words_of(case.command, COMMANDS[case.command], case)
    run(words)  # imports what it needs from where nobody may look
    words = ["locked/inner" if word in (case.fault.words or ()) else word for word in words]
    assert "locked/inner" in words
    (tree / "locked").chmod(0)
    before = snapshot(tree.parent)
    monkeypatch.setenv("HOME", str(tree))
    with act_as_nobody(tree):
        outcome = run(words)
    assert outcome.code == 2, outcome
    check_one_line(outcome, ("locked",))
    assert snapshot(tree.parent) == before


class UnforeseenError(Exception):
    """Something that nobody foresaw."""


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OverflowError("too large to convert"), "OverflowError: too large to convert"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"), "invalid start byte"),
        (UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates not allowed"), "surrogates"),
        (csv.Error("field larger than field limit"), "field larger than field limit"),
        (MemoryError(), "not enough memory"),
        (RecursionError("maximum recursion depth exceeded"), "maximum recursion depth"),
        (PermissionError(errno.EACCES, "Permission denied", "a\nb"), "a b: Permission denied"),
        (OSError(errno.ENOSPC, "No space left on device"), "the disk is full"),
        (OSError("no reason"), "no reason"),
        (InputError("one\ntwo\x1b[31m"), "one two\\x1b[31m"),
        (InputError("x" * 100_000), "xxx"),
    ],
)
def test_exceptions_become_one_line_and_a_code(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    raising(error, monkeypatch)
    outcome = run(["regress", str(GATE), "--against", str(GATE)])
    assert outcome.code == 2
    check_one_line(outcome, (said,))


@pytest.mark.parametrize(
    "error", [UnforeseenError("a\nb"), ValueError(), KeyError("x"), AssertionError()]
)
def test_an_unexpected_exception_shows_its_traceback(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a traceback, to be sent to those who can mend it; never as a regression."""
    raising(error, monkeypatch)
    outcome = run(["regress", str(GATE), "--against", str(GATE)])
    assert outcome.code == 3
    assert outcome.stderr.startswith("Traceback")
    assert outcome.stderr.splitlines()[-1].endswith("this is a fault of the program")


def raising(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise error

    monkeypatch.setattr("benchmark.regression.regress", fail)


def test_only_a_regression_exits_with_1(tmp_path: Path) -> None:
    before = json.loads((GATE / "gate" / "sift.json").read_text())
    shutil.copytree(GATE, tmp_path / "same")
    assert run(["regress", str(tmp_path / "same"), "--against", str(GATE)]).code == 0
    shutil.rmtree(tmp_path / "same")
    worse = tmp_path / "gate" / "sift.json"
    worse.parent.mkdir()
    before["queries"] = before["queries"][:-1]
    worse.write_text(json.dumps(before))
    assert run(["regress", str(tmp_path), "--against", str(GATE)]).code == 2  # figures do not fit
    from benchmark.results.results import Results
    from benchmark.results.results_files import load

    whole = load(GATE / "gate" / "sift.json")
    Results.of(whole.method, whole.dataset, whole.start, whole.queries[:-1]).write(worse)
    outcome = run(["regress", str(tmp_path), "--against", str(GATE)])
    assert (outcome.code, outcome.stderr) == (1, "")
