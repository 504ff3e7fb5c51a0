"""Temporary folders of living processes stay, those of killed ones go."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

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
    time.sleep(60)
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
