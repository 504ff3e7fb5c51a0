"""Behaviour on a full disk: a small file system in memory is mounted for the tests."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import pytest
import torch

from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import GATE_SCENES
from benchmark.results.query_result import QueryResult
from objconnect.localization.pipeline.journal import Journal
from objconnect.scene.bundle.frames import read_frames, write_frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.database import MappingJob
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.triangulation import triangulate
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.exports.export import export
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.storage.atomic import atomic_folder, atomic_write, write_text
from objconnect.scene.storage.files import require_disk_space
from objconnect.scene.storage.locks import resumable_file, write_lock
from tests.benchmark.made_data import make_scored_query
from tests.objconnect.scene.bundle.test_frames import ALL, assert_equal, make_frames, make_layers
from tests.robustness.misuse.harness import run

GATE = GATE_SCENES["gate"]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 2 MB."""
    path = tmp_path / "disk"
    path.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(path)]
    mounted = shutil.which("mount") and not subprocess.run(mount, check=False).returncode
    if not mounted:
        pytest.skip("a file system can be mounted by root alone")
    try:
        yield path
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


def fill(disk: Path, left: int = 0) -> Path:
    """Fill the disk until the given number of bytes is left."""
    path = disk / "filling"
    path.write_bytes(bytes(max(shutil.disk_usage(disk).free - left, 0)))
    return path


def test_a_full_disk_leaves_no_partial_file(disk: Path) -> None:
    path = disk / "result"
    path.write_text("old")
    with pytest.raises(WriteError, match="No space left"), atomic_write(path) as partial:
        partial.write_bytes(bytes(3_000_000))
    assert path.read_text() == "old"
    assert [p.name for p in disk.iterdir()] == ["result"]


def test_a_full_disk_leaves_no_partial_folder(disk: Path) -> None:
    with pytest.raises(WriteError, match="No space left"), atomic_folder(disk / "m") as out:
        (out / "a").write_bytes(bytes(3_000_000))
    assert not list(disk.iterdir())


def test_a_session(disk: Path) -> None:
    """HDF5 reports a full disk by exceptions of its own, possibly when the file is closed."""
    path = disk / "frames.h5"
    write_frames(path, make_frames(3), ALL, (make_layers(k) for k in range(3)))
    filling = fill(disk, 3000)
    with pytest.raises(WriteError, match="cannot write"):
        write_frames(path, make_frames(40), ALL, (make_layers(k) for k in range(40)))
    assert_equal(read_frames(path), make_frames(3))
    assert {p.name for p in disk.iterdir()} == {"frames.h5", "filling"}
    filling.unlink()
    write_frames(path, make_frames(40), ALL, (make_layers(k) for k in range(40)))
    assert len(read_frames(path)) == 40


WRITING = """
import sys
from pathlib import Path
import numpy as np
from objconnect.scene.storage.hdf5_writing import hdf5_file, open_hdf5
from objconnect.scene.errors import WriteError
how = {"whole": hdf5_file, "in place": open_hdf5}[sys.argv[2]]
try:
    with how(Path(sys.argv[1])) as file:
        for k in range(40):
            group = file.create_group(str(k))
            group["values"] = np.full(3000, k)
            group.attrs["k"] = k
        print("unnoticed")
except WriteError as error:
    print(error)
"""


# Of each way one in the default part.
DEFAULT_LEFT = {(3_000, "whole"), (64_000, "in place")}
LEFT = [
    pytest.param(left, how, marks=() if (left, how) in DEFAULT_LEFT else pytest.mark.thorough)
    for how in ("whole", "in place")
    for left in (0, 3_000, 64_000, 500_000)
]


@pytest.mark.parametrize(("left", "how"), LEFT)
def test_hdf5_survives(disk: Path, left: int, how: str) -> None:
    """The library of HDF5 would end the process after its last line: signal 11."""
    filling = fill(disk, left)
    command = [sys.executable, "-c", WRITING, str(disk / "a.h5"), how]
    ended = subprocess.run(
        command, cwd=GATE.parents[2], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith(f"cannot write {disk / 'a.h5'}: ")
    assert ended.stdout.count("\n") == 1 and "unnoticed" not in ended.stdout
    if how == "whole":
        assert [path.name for path in disk.iterdir()] == ["filling"]
    filling.unlink()
    ended = subprocess.run(
        command, cwd=GATE.parents[2], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stdout) == (0, "unnoticed\n")
    with h5py.File(disk / "a.h5") as file:
        assert [int(file[f"{k}/values"][-1]) for k in range(40)] == list(range(40))


def test_a_copy_names_what_is_written(disk: Path, tmp_path: Path) -> None:
    """The error of copying names the file that is read, which lies on another disk."""
    photograph = tmp_path / "photograph.jpg"
    photograph.write_bytes(bytes(3_000_000))
    with pytest.raises(WriteError) as raised, atomic_write(disk / "a.jpg") as partial:
        shutil.copyfile(photograph, partial)
    assert str(raised.value) == f"cannot write {disk / 'a.jpg'}: No space left on device"
    with pytest.raises(WriteError, match=r"/b\.jpg: No such file"), atomic_write(disk / "a.jpg"):
        shutil.copyfile(tmp_path / "b.jpg", disk / "b.jpg")


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(
            ("leaderboard", str(Path(__file__).parents[3] / "data" / "gate-baseline"), "--out"),
            marks=pytest.mark.thorough,
        ),
        ("score", str(GATE / "reference_poses.txt"), "--reference", str(GATE), "--out"),
        pytest.param(("audit", "places.csv", "--out"), marks=pytest.mark.thorough),
    ],
    ids=lambda words: words[0],
)
def test_a_command_ends_with_one_line(disk: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    """What it leaves is whole, and the same command finishes when there is room."""
    (tmp_path / "places.csv").write_text("name,lat,lon,alt\na.jpg,47,8,440\nb.jpg,47.001,8,440\n")
    words = tuple(str(tmp_path / word) if word == "places.csv" else word for word in words)
    out = "out.html" if words[0] == "audit" else "out"
    filling = fill(disk, 2 << 10)
    ended = run([*words, str(disk / out)])
    assert ended.code == 2, ended.stderr
    assert ended.stderr.splitlines()[-1].startswith(f"objconnect: error: cannot write {disk}")
    assert "Traceback" not in ended.stderr
    assert not [path for path in disk.rglob("*") if path.name.endswith(".partial")]
    filling.unlink()
    assert run([*words, str(disk / out)]).code == 0


@pytest.mark.parametrize(
    "file_format", ["nerfstudio", "colmap", "colmap-database", "hloc-features", "rerun"]
)
def test_an_export_names_the_folder_that_was_asked_for(
    disk: Path, rendered: Scene, file_format: str
) -> None:
    """Each library reports a full disk in its own way, and none knows where its files would be."""
    if file_format == "rerun":
        pytest.importorskip("rerun")
    fill(disk)
    out = disk / "out"
    with pytest.raises(WriteError) as raised:
        export(rendered.path, file_format, out, ["summer-noon-nadir-map"])
    assert str(raised.value).startswith(f"cannot write {out}")
    assert ".partial" not in str(raised.value)
    assert [path.name for path in disk.iterdir()] == ["filling"]


@pytest.mark.parametrize("left", [8 << 10, (1 << 20) + (8 << 10)])
def test_rerun_is_whole_or_absent(disk: Path, rendered: Scene, left: int) -> None:
    """The library says on its log alone that a disk became full, and cuts the file."""
    pytest.importorskip("rerun")
    fill(disk, left)
    with pytest.raises(WriteError, match=f"^cannot write {disk / 'out'}/scene.rrd: the disk has"):
        export(rendered.path, "rerun", disk / "out", ["summer-noon-nadir-map"])
    assert [path.name for path in disk.iterdir()] == ["filling"]


@pytest.mark.parametrize(
    ("method", "cache"),
    [
        ("sift", None),
        pytest.param("pixloc", "cache", marks=pytest.mark.thorough),
        pytest.param("sift", "cache", marks=pytest.mark.thorough),
        pytest.param("pixloc", None, marks=pytest.mark.thorough),
    ],
)
def test_localize_ends_with_one_line(
    disk: Path, tmp_path: Path, method: str, cache: str | None
) -> None:
    """A disk of 64 kB has room for the answers and not for what a method keeps per map."""
    (tmp_path / "photographs").mkdir()
    photograph = min((GATE / "images" / "query-a").rglob("*.jpg"))
    shutil.copy(photograph, tmp_path / "photographs")
    filling = fill(disk, 64 << 10)
    command = [sys.executable, "-m", "benchmark.cli", "localize", "--map", str(GATE)]
    command += ["--images", str(tmp_path / "photographs"), "--method", method]
    command += ["--out", str(disk / "poses.txt")]
    command += [] if cache is None else ["--cache", str(disk / cache)]
    ended = subprocess.run(
        command, cwd=GATE.parents[2], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2, ended.stderr
    errors = [line for line in ended.stderr.splitlines() if "error" in line.lower()]
    assert len(errors) == 1 and "free some space and run again" in errors[0]
    assert str(disk) in errors[0]
    assert "Traceback" not in ended.stderr
    left = {path.name for path in disk.rglob("*")} - {"filling", "cache"}
    assert not left
    assert filling.is_file()


def test_a_full_disk_leaves_no_partial_checkpoint(disk: Path) -> None:
    """Torch writes files without Python, and reports a full disk by a RuntimeError."""
    path = disk / "checkpoint.pt"
    torch.save({"done": 1}, path)
    with pytest.raises(WriteError, match="cannot write"), atomic_write(path) as partial:
        torch.save({"w": torch.zeros(1_000_000)}, partial)
    assert torch.load(path, weights_only=True) == {"done": 1}
    assert [p.name for p in disk.iterdir()] == ["checkpoint.pt"]


def test_an_error_that_is_not_the_disk_s_is_not_taken_for_it(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="mine"), atomic_write(tmp_path / "a"):
        raise RuntimeError("mine")


def test_a_journal_survives_a_full_disk(disk: Path) -> None:
    """Queries written to the journal are kept until there is space again."""
    filling = fill(disk, 4096)
    noted = []
    opened = Journal(disk / "j", "key", QueryResult)
    with pytest.raises(WriteError, match="No space left"), opened as journal:
        for k in range(100):
            journal.add(make_scored_query(f"{k}.jpg", 0.1))
            noted.append(f"{k}.jpg")
    assert 1 < len(noted) < 100
    filling.unlink()
    with Journal(disk / "j", "key", QueryResult) as journal:
        assert list(journal.done) == noted
        journal.add(make_scored_query("new.jpg", 0.1))


def test_a_damaged_journal_keeps_what_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "j"
    with pytest.raises(KeyboardInterrupt), Journal(path, "key", QueryResult) as journal:
        for name in ("a", "b"):
            journal.add(make_scored_query(name, 0.1))
        raise KeyboardInterrupt
    data = path.read_bytes()
    path.write_bytes(data[:-30] + b"\xb3" + data[-29:])  # not UTF-8
    with Journal(path, "key", QueryResult) as journal:
        assert list(journal.done) == ["a"]


def matching(disk: Path) -> Callable[[], object]:
    """Map four photographs of the gate with a database on the disk."""
    (dataset,) = open_datasets(GATE)
    known = dataset.load_map().images
    names = sorted(known)[:4]
    images = [PosedImage(n, known[n].camera, known[n].cam_from_world) for n in names]
    pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
    (disk.parent / "map").mkdir(exist_ok=True)

    def run() -> object:
        out, database = disk.parent / "map", disk / "kept.db"
        return triangulate(
            MappingJob(dataset.images, pairs, SiftOptions(), images=images, database=database), out
        )

    return run


def test_colmap_is_not_let_near_a_full_disk(disk: Path) -> None:
    """COLMAP would end the process: 'terminate called', signal 6."""
    fill(disk, 900_000)
    with pytest.raises(WriteError, match=r"has 1 MB left and \d+ MB are needed"):
        matching(disk)()


def test_what_is_matched_outlives_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is reported full after the third pair; the next run does not repeat those pairs."""
    import objconnect.scene.colmap.database as adapter

    run = matching(tmp_path / "disk")
    (tmp_path / "disk").mkdir()
    compared = 0
    match = adapter.match

    def count(*args: object) -> object:
        nonlocal compared
        compared += 1
        return match(*args)  # type: ignore[arg-type]

    def room(path: Path, needed: int) -> None:
        if compared == 3:
            raise WriteError("cannot write: full")

    monkeypatch.setattr(adapter, "match", count)
    with monkeypatch.context() as patch:
        patch.setattr(adapter, "require_disk_space", room)
        with (
            pytest.raises(WriteError),
            resumable_file(tmp_path / "disk", "kept.db"),
        ):
            run()
    assert (tmp_path / "disk" / "kept.db").is_file()
    run()
    assert compared == 6  # the pairs of four photographs
    with pytest.raises(InputError), resumable_file(tmp_path / "disk", "kept.db"):
        raise InputError("these photographs make no map")
    assert not (tmp_path / "disk").exists()


def test_room(tmp_path: Path) -> None:
    require_disk_space(tmp_path / "new", 1000)
    with pytest.raises(WriteError, match="are needed: free some"):
        require_disk_space(tmp_path / "new", 10**18)


def test_a_disk_that_cannot_be_written(disk: Path) -> None:
    """The file system forbids it to root as well; permissions alone would not."""
    (disk / "scene").mkdir()
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    with pytest.raises(WriteError, match="Read-only"), write_lock(disk / "scene"):
        pass
    with pytest.raises(WriteError, match="Read-only"):
        write_text(disk / "scene" / "a", "text")
    with pytest.raises(InputError, match="Read-only"), write_lock(disk / "new"):
        pass
    with pytest.raises(WriteError, match="Read-only"), atomic_folder(disk / "map"):
        pass
    with pytest.raises(WriteError, match="Read-only"), resumable_file(disk / "kept", "a.db"):
        pass
    journal = Journal(disk / "out" / "j", "key", QueryResult)
    with pytest.raises(InputError, match="Read-only"), journal:
        pass


def test_a_killed_evaluation_has_noted_every_query(tmp_path: Path) -> None:
    """After kill -9 all finished queries are on disk: none waits in a buffer."""
    code = (
        "import os, pathlib, signal, sys\n"
        "from objconnect.localization.pipeline.journal import Journal\n"
        "from benchmark.results.query_result import QueryResult\n"
        "from tests.benchmark.made_data import make_scored_query\n"
        "with Journal(pathlib.Path(sys.argv[1]), 'key', QueryResult) as journal:\n"
        "    for k in range(5):\n"
        "        journal.add(make_scored_query(f'{k}.jpg', 0.1))\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    killed = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "j")], cwd=GATE.parents[2], check=False
    )
    assert killed.returncode == -signal.SIGKILL
    with Journal(tmp_path / "j", "key", QueryResult) as journal:
        assert list(journal.done) == [f"{k}.jpg" for k in range(5)]
