"""Digests are those of the bytes on disk, whatever the cache holds."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import objconnect.scene.storage.digests
from objconnect.scene.errors import InputError
from objconnect.scene.storage.digests import FOLDER_VARIABLE, digest, digests, require_unchanged

ROOT = Path(__file__).parents[4]


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use an own cache, which also holds files that have just changed."""
    folder = tmp_path / "kept"
    monkeypatch.setenv(FOLDER_VARIABLE, str(folder))
    monkeypatch.setattr(objconnect.scene.storage.digests, "_TICK_NS", -(10**15))
    return folder


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "data" / "a.jpg"
    path.parent.mkdir()
    path.write_bytes(b"first")
    return path


@pytest.fixture
def unreadable(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Make every read fail from now on."""

    def refuse(*_: object) -> None:
        raise AssertionError("a file was read")

    return lambda: monkeypatch.setattr(hashlib, "file_digest", refuse)


def test_in_the_order_given(kept: Path, tmp_path: Path) -> None:
    names = ["b/2", "a/1", "b/1", "a/1"]
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    wanted = [sha256(name.encode()) for name in names]
    assert digests(tmp_path / name for name in names) == wanted
    assert digests(tmp_path / name for name in names) == wanted


def test_a_file_is_read_once(kept: Path, file: Path, unreadable: Any) -> None:
    before = digest(file)
    unreadable()
    assert digest(file) == before == sha256(b"first")
    with pytest.raises(AssertionError):
        digest(file.with_name("a.jpg").rename(file.with_name("b.jpg")))


def test_another_process_remembers(file: Path, kept: Path) -> None:
    """A name that is not UTF-8 is cached too."""
    odd = file.with_name(os.fsdecode(b"\xff\n.jpg"))
    odd.write_bytes(b"odd")
    digests([file, odd])
    code = (
        "import hashlib, sys; from pathlib import Path\n"
        "from objconnect.scene.storage.digests import digests\n"
        "del hashlib.file_digest\n"
        "print(*digests(sorted(Path(sys.argv[1]).iterdir())))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code, file.parent],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.split() == [sha256(b"first"), sha256(b"odd")]


def write_later(file: Path, data: bytes) -> None:
    """Write a file after the last tick of the clock in which it was changed."""
    before = file.stat().st_ctime_ns
    while file.stat().st_ctime_ns == before:
        file.write_bytes(data)


def test_other_bytes_of_the_same_size_and_time(kept: Path, file: Path) -> None:
    """A tool edits a photograph and restores its modification time."""
    assert digest(file) == sha256(b"first")
    times = file.stat()
    write_later(file, b"other")
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert digest(file) == sha256(b"other")


def test_another_file_in_its_place(kept: Path, file: Path) -> None:
    assert digest(file) == sha256(b"first")
    times = file.stat()
    other = file.with_name("other")
    other.write_bytes(b"other")
    os.utime(other, ns=(times.st_atime_ns, times.st_mtime_ns))
    other.replace(file)
    assert digest(file) == sha256(b"other")


def test_a_file_that_changes_within_a_tick(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a file system that counts time in steps of two seconds, as FAT does, most of these changes
    leave no trace in it."""

    def coarse(status: os.stat_result) -> list[int]:
        times = [status.st_mtime_ns // (2 * 10**9), status.st_ctime_ns // (2 * 10**9)]
        return [status.st_dev, status.st_ino, status.st_size, *times]

    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "kept"))
    monkeypatch.setattr(objconnect.scene.storage.digests, "_state", coarse)
    for k in range(20):
        data = f"{k:05d}".encode()
        file.write_bytes(data)
        assert digest(file) == sha256(data)


def test_one_that_rests_is_remembered(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unreadable: Any
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "kept"))
    now = changed = file.stat().st_ctime_ns
    monkeypatch.setattr(objconnect.scene.storage.digests.time, "time_ns", lambda: now)
    digest(file)
    assert not (tmp_path / "kept").exists()
    now = changed + 10 * 10**9
    digest(file)
    unreadable()
    assert digest(file) == sha256(b"first")


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data.replace(sha256(b"first").encode(), sha256(b"other").encode()),
        lambda data: b"\xff" + data,
        lambda data: b"objconnect digests 1 " + sha256(b"[]").encode() + b"\n[1]",
    ],
)
def test_damage_is_not_believed(kept: Path, file: Path, damage: Any) -> None:
    digest(file)
    (remembered,) = kept.iterdir()
    data = remembered.read_bytes()
    remembered.write_bytes(damage(data))
    assert remembered.read_bytes() != data
    assert digest(file) == sha256(b"first")
    assert remembered.read_bytes() == data


@pytest.mark.parametrize("where", ["", "/dev/null/kept", "/proc/kept"])
def test_nowhere_to_remember(
    kept: Path, file: Path, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, where)
    monkeypatch.chdir(file.parent)
    assert [digest(file), digest(file)] == [sha256(b"first")] * 2
    assert list(file.parent.iterdir()) == [file]
    assert not kept.exists()


def test_the_folder_is_the_users(
    kept: Path, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(FOLDER_VARIABLE)
    for variable, value, folder in [
        ("XDG_CACHE_HOME", tmp_path / "xdg", tmp_path / "xdg"),
        ("XDG_CACHE_HOME", "relative", tmp_path / "home" / ".cache"),
    ]:
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        monkeypatch.setenv(variable, str(value))
        digest(file)
        assert len(list((folder / "objconnect" / "digests").iterdir())) == 1


def test_two_processes_at_once(kept: Path, tmp_path: Path) -> None:
    """Two processes write the cache many times, each with half of the files; all is correct."""
    folder = tmp_path / "many"
    folder.mkdir()
    for k in range(40):
        (folder / f"{k:02d}").write_text(str(k))
    code = (
        "import sys; from pathlib import Path; import objconnect.scene.storage.digests as of\n"
        "of._TICK_NS = -10**15\n"
        "files = sorted(Path(sys.argv[1]).iterdir())\n"
        "for k in range(int(sys.argv[2]), 40, 2): of.digests(files[: k + 1])"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", code, folder, str(k)], cwd=ROOT) for k in range(2)
    ]
    assert [process.wait() for process in running] == [0, 0]
    assert digests(sorted(folder.iterdir())) == [sha256(str(k).encode()) for k in range(40)]
    assert len(list(kept.iterdir())) == 1


def test_what_is_gone_is_forgotten(kept: Path, file: Path) -> None:
    digest(file)
    (remembered,) = kept.iterdir()
    size = remembered.stat().st_size
    for k in range(20):
        other = file.with_name(f"{k:05d}")
        other.write_bytes(b"first")
        digest(other)
        other.unlink()
    assert remembered.stat().st_size < 2.5 * size


def test_the_folder_has_bounds(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of others in the folder of the cache are kept."""
    monkeypatch.setattr(objconnect.scene.storage.digests, "_MOST_BYTES", 2000)
    kept.mkdir()
    (kept / "notes.txt").write_text("mine")
    for k in range(30):
        file = tmp_path / f"folder{k}" / "a.jpg"
        file.parent.mkdir()
        file.write_text(str(k))
        assert digest(file) == sha256(str(k).encode())
        assert sum(path.stat().st_size for path in kept.iterdir()) <= 2004
    assert (kept / "notes.txt").read_text() == "mine"


def test_what_cannot_be_read(kept: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*gone\.jpg: No such file"):
        digest(tmp_path / "gone.jpg")
    with pytest.raises(InputError, match="is not a regular file"):
        digest(tmp_path)
    os.mkfifo(tmp_path / "pipe.jpg")
    with pytest.raises(InputError, match="is not a regular file"):
        digest(tmp_path / "pipe.jpg")
    assert digests([tmp_path / "gone.jpg"], missing="gone") == ["gone"]


def test_much_to_read_is_shown_and_the_same(
    kept: Path, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(objconnect.scene.storage.digests, "_PROGRESS_BYTES", 0)
    assert digest(file) == sha256(b"first")


def test_a_file_in_use_must_not_change(kept: Path, file: Path) -> None:
    before = digests([file])
    require_unchanged([file], before)
    write_later(file, b"other")
    with pytest.raises(InputError, match=r"a\.jpg was changed while it was in use"):
        require_unchanged([file], before)
