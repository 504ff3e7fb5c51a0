from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.atomic import atomic_folder, atomic_write, write_text
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import is_safe_path, read_text
from objconnect.scene.storage.locks import write_lock


def test_digest(tmp_path: Path) -> None:
    (tmp_path / "data").write_bytes(b"abc" * 100_000)
    assert sha256_of(tmp_path / "data") == hashlib.sha256(b"abc" * 100_000).hexdigest()


def test_a_file_appears_whole_in_a_new_folder(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "result.txt"
    with atomic_write(path) as partial:
        partial.write_text("half")
        assert not path.exists()
        partial.write_text("whole")
    assert path.read_text() == "whole"
    assert os.listdir(path.parent) == ["result.txt"]  # noqa: PTH208 - hidden files too


def test_an_input_missing_meanwhile_is_named(tmp_path: Path) -> None:
    lost = tmp_path / "lost.npz"
    with (
        pytest.raises(WriteError, match=r"result\.txt: .*lost\.npz: No such file"),
        atomic_write(tmp_path / "result.txt"),
    ):
        lost.read_bytes()
    with (
        pytest.raises(WriteError, match=r"folder: .*lost\.npz: No such file"),
        atomic_folder(tmp_path / "folder"),
    ):
        lost.read_bytes()


def test_a_failed_file_keeps_the_old_one_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_write(path) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["result.txt"]  # noqa: PTH208


def test_a_file_is_as_readable_as_any_other(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_text(tmp_path / "whole", "text")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "map"
    with atomic_folder(path) as partial:
        (partial / "images.bin").write_text("whole")
        assert not path.exists()
    assert (path / "images.bin").read_text() == "whole"
    assert os.listdir(path.parent) == ["map"]  # noqa: PTH208


def test_a_folder_replaces_what_we_wrote_into_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "map"
    path.mkdir()
    (path / "stale").touch()
    with atomic_folder(path, ["stale"]) as partial:
        (partial / "fresh").touch()
        assert (path / "stale").exists()
    assert [file.name for file in path.iterdir()] == ["fresh"]
    assert os.listdir(tmp_path) == ["map"]  # noqa: PTH208


def test_a_failed_folder_keeps_the_old_one_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "map"
    path.mkdir()
    (path / "old").touch()
    with pytest.raises(RuntimeError), atomic_folder(path) as partial:
        (partial / "half").touch()
        raise RuntimeError
    assert [file.name for file in path.iterdir()] == ["old"]
    assert os.listdir(tmp_path) == ["map"]  # noqa: PTH208


def test_an_unwritable_place_is_one_clear_error(tmp_path: Path) -> None:
    """With a file in the place of a folder nobody can write there, not even root."""
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with (
        pytest.raises(InputError, match="cannot write .*result.txt: "),
        atomic_write(blocked / "result.txt"),
    ):
        pytest.fail("the block must not start")
    with (
        pytest.raises(InputError, match="cannot write .*map: "),
        atomic_folder(blocked / "map"),
    ):
        pytest.fail("the block must not start")
    assert blocked.read_text() == "in the way"


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_without_permission_is_one_clear_error(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="cannot write .*result.txt: Permission denied"):
            write_text(tmp_path / "result.txt", "text")
    finally:
        tmp_path.chmod(0o700)


def test_a_folder_in_the_place_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "result.txt").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        write_text(tmp_path / "result.txt", "text")
    assert os.listdir(tmp_path) == ["result.txt"]  # noqa: PTH208


def test_text_comes_back(tmp_path: Path) -> None:
    write_text(tmp_path / "text", "5 m, 10°\n")
    assert read_text(tmp_path / "text", "list") == "5 m, 10°\n"


def test_unreadable_text_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read query list .*missing: No such file"):
        read_text(tmp_path / "missing", "query list")
    with pytest.raises(InputError, match="cannot read query list .*: Is a directory"):
        read_text(tmp_path, "query list")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a UTF-8 text file"):
        read_text(tmp_path / "binary", "query list")


def test_one_process_writes_a_folder_at_a_time(tmp_path: Path) -> None:
    """A second process gets an error; the lock of a killed process does not remain."""
    folder = tmp_path / "new" / "scene"
    hold = (
        "import pathlib, sys\n"
        "from objconnect.scene.storage.locks import write_lock\n"
        "with write_lock(pathlib.Path(sys.argv[1])):\n"
        "    print('held', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with (
            pytest.raises(InputError, match="another run is writing .*scene: wait"),
            write_lock(folder),
        ):
            pass
        assert folder.is_dir()
        other.kill()
        other.wait()
    with write_lock(folder):
        (folder / "result").touch()
    assert os.listdir(folder) == ["result"]  # noqa: PTH208 - hidden files too


def test_a_folder_nobody_wrote_into_goes_again(tmp_path: Path) -> None:
    with write_lock(tmp_path / "new" / "scene"):
        assert (tmp_path / "new" / "scene").is_dir()
    assert not (tmp_path / "new").exists()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write .*file"), write_lock(tmp_path / "file"):
        pass


@pytest.mark.parametrize(
    ("name", "stays"),
    [
        ("a.jpg", True),
        ("session/images/..a..jpg", True),
        ("/etc/passwd", False),
        ("../a.jpg", False),
        ("a/../../b.jpg", False),
        ("..", False),
        ("a\0.jpg", False),
        ("a" * 300, False),
    ],
)
def test_names_that_lead_out_of_their_folder(name: str, stays: bool) -> None:
    assert is_safe_path(name) is stays
