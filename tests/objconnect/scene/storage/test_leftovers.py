"""Temporary folders of living processes stay, those of killed ones go."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock, Timeout

from objconnect.scene.storage import leftovers
from objconnect.scene.storage.leftovers import remove_abandoned, remove_partial
from objconnect.scene.storage.scratch import scratch

# Makes a scratch folder with a file, says so, and waits.
_WAITS = """
import sys, time
from pathlib import Path
from objconnect.scene.storage.scratch import scratch
with scratch(Path(sys.argv[1])) as folder:
    (folder / ".objconnect-abcd1234.partial").write_text("half")
    print(folder, flush=True)
    time.sleep(600)
"""


@pytest.fixture
def other(tmp_path: Path) -> subprocess.Popen[str]:
    """Another process with a scratch folder."""
    command = [sys.executable, "-c", _WAITS, str(tmp_path)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def folder_of(process: subprocess.Popen[str]) -> Path:
    assert process.stdout is not None
    return Path(process.stdout.readline().strip())


def test_a_folder_in_use_stays_until_its_process_is_killed(
    other: subprocess.Popen[str], tmp_path: Path
) -> None:
    folder = folder_of(other)
    try:
        with scratch(tmp_path) as ours:
            remove_partial(tmp_path)
            remove_abandoned(tmp_path)
            assert ours.is_dir()
            assert (folder / ".objconnect-abcd1234.partial").read_text() == "half"
    finally:
        other.send_signal(signal.SIGKILL)
        other.wait()
    assert folder.is_dir()
    with scratch(tmp_path):
        assert not folder.exists()
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / ".objconnect-abcd1234.partial").write_text("half")
    (tmp_path / ".objconnect-mine").write_text("whole")
    remove_abandoned(tmp_path)
    assert (tmp_path / "in" / ".objconnect-abcd1234.partial").exists()  # may be of another run
    remove_partial(tmp_path)
    assert sorted(path.name for path in tmp_path.rglob("*")) == [".objconnect-mine", "in"]


def test_a_folder_that_is_removed_before_it_is_marked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another run sweeps between the making of a folder and the lock of its mark."""
    made: list[Path] = []

    class Late(FileLock):
        def acquire(self, *arguments: Any, **options: Any) -> Any:
            folder = Path(self.lock_file).parent
            if not options and self.blocking and len(made) < 2:
                made.append(folder)
                remove_partial(tmp_path)
                raise FileNotFoundError(self.lock_file)
            return super().acquire(*arguments, **options)

    monkeypatch.setattr(leftovers, "FileLock", Late)
    with scratch(tmp_path) as folder:
        assert len(made) == 2 and not any(path.exists() for path in made)
        remove_partial(tmp_path)
        remove_abandoned(tmp_path)
        assert folder.is_dir() and folder not in made
    assert list(tmp_path.iterdir()) == []


def test_nobody_begins_to_use_what_is_being_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / ".objconnect-abcd1234.partial"
    folder.mkdir()
    (folder / ".objconnect-in-use").touch()
    remove, refused = shutil.rmtree, []

    def try_to_mark(path: Path, **options: Any) -> None:
        with pytest.raises(Timeout):
            FileLock(path / ".objconnect-in-use", blocking=False, is_singleton=False).acquire()
        refused.append(path)
        remove(path, **options)

    monkeypatch.setattr(leftovers.shutil, "rmtree", try_to_mark)
    remove_abandoned(tmp_path)
    assert refused == [folder] and not folder.exists()
