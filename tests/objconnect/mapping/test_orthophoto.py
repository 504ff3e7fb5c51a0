"""``map --ortho``: the same command continues after an interruption, and failures leave nothing."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

import objconnect.ingestion.virtual.command as rendering
from benchmark.cli import app
from objconnect.ingestion.virtual.command import photograph_orthophoto
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError, NoPointsError, WriteError
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.locks import write_lock
from tests.objconnect.scene.geo.made_site import rasters

Files = tuple[Path, Path]

# The command line, killed while it does the work that a line of code names.
KILLS_ITSELF = """
import os, signal
from benchmark import cli
from objconnect.ingestion.virtual import command
from objconnect.scene.colmap import database

def kill(*arguments):
    os.kill(os.getpid(), signal.SIGKILL)

{}
cli.main()
"""
# At the fourth view, whose file is begun: three are whole.
RENDERING = """
from objconnect.scene.storage import exif
encode, calls = exif._encode, []

def encode_three(*arguments):
    calls.append(arguments)
    return encode(*arguments) if len(calls) < 4 else kill()

exif._encode = encode_three
"""
LISTING = "command.write_covisibility = kill"
FINISHING = "command.finish_scene = kill"
MATCHING = "database.pycolmap.verify_matches = kill"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Orthophoto and surface model."""
    return rasters(tmp_path_factory.mktemp("rasters"), "EPSG:32632")


@pytest.fixture(scope="module")
def black(files: Files, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An orthophoto of the same grid without texture."""
    path = tmp_path_factory.mktemp("black") / "ortho.tif"
    with rasterio.open(files[0]) as file:
        profile, values = file.profile, file.read()
    with rasterio.open(path, "w", **profile) as file:
        file.write(np.zeros_like(values))
    return path


def words(files: Files, out: Path, *others: str) -> list[str]:
    """The arguments of the command; later options replace earlier ones."""
    given = ["map", "--ortho", *map(str, files[:1]), "--dsm", str(files[1]), "--out", str(out)]
    return [*given, "--altitude", "34", "--overlap", "0.4", *others]


def run(files: Files, out: Path, *others: str) -> Result:
    return CliRunner().invoke(app, words(files, out, *others))


def kill(files: Files, out: Path, moment: str) -> None:
    """Run the command, which is killed at a moment."""
    program = KILLS_ITSELF.format(moment)
    child = subprocess.run([sys.executable, "-c", program, *words(files, out)], check=False)
    assert child.returncode == -signal.SIGKILL


def contents(folder: Path) -> dict[str, str]:
    """Digests of all files, hidden ones included."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): sha256_of(path) for path in paths}


@pytest.fixture(scope="module")
def undisturbed(files: Files, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The scene of a run without interruption, and what the run printed."""
    out = tmp_path_factory.mktemp("undisturbed") / "scene"
    result = run(files, out)
    assert result.exit_code == 0, result.output
    return out, result.stdout


@pytest.mark.parametrize(
    "moment",
    [
        pytest.param(RENDERING, marks=pytest.mark.thorough),
        pytest.param(LISTING, marks=pytest.mark.thorough),
        pytest.param(FINISHING, marks=pytest.mark.thorough),
        MATCHING,
    ],
)
def test_the_same_command_continues(
    files: Files,
    undisturbed: tuple[Path, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    moment: str,
) -> None:
    """Killed at any step: then the scene is that of one run, and no temporary file is left."""
    out = tmp_path / "scene"
    kill(files, out, moment)
    assert any(name.rpartition("/")[2].startswith(".objconnect-") for name in contents(out))
    if moment == MATCHING:
        monkeypatch.setattr(rendering, "_write", None)  # no view is rendered again
    result = run(files, out)
    assert result.exit_code == 0, result.output
    assert result.stdout == undisturbed[1]
    assert contents(out) == contents(undisturbed[0])
    assert list(tmp_path.iterdir()) == [out]


def test_a_finished_scene_is_mapped_again(
    files: Files, undisturbed: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by the command with SCENE, and without rendering."""
    before = contents(undisturbed[0])
    monkeypatch.setattr(rendering, "_write", None)
    result = run(files, undisturbed[0])
    assert (result.exit_code, result.stdout) == (0, undisturbed[1])
    assert contents(undisturbed[0]) == before


@pytest.mark.parametrize(
    ("moment", "says"), [(RENDERING, "an unfinished scene"), (MATCHING, "a scene"), (None, "a sce")]
)
def test_other_files_and_options_are_refused(
    files: Files,
    black: Path,
    undisturbed: tuple[Path, str],
    tmp_path: Path,
    moment: str | None,
    says: str,
) -> None:
    """In a folder of views, of all views without a map, and of a finished scene."""
    out = undisturbed[0]
    if moment is not None:
        out = tmp_path / "scene"
        kill(files, out, moment)
        (out / ".objconnect-lock").unlink()
    if moment == RENDERING:
        with pytest.raises(InputError, match="not a finished scene.*ingest or map --ortho again"):
            Scene.open(out)
    before = contents(out)
    same_name = tmp_path / "dsm.tif"
    same_name.write_bytes(files[1].read_bytes() + b"\0")
    cases: list[tuple[Files, tuple[str, ...]]] = [
        ((black, files[1]), ()),
        ((files[0], same_name), ()),
        (files, ("--altitude", "33")),
        (files, ("--tilt", "20")),
        (files, ("--undulation", "48")),
        (files, ("--georeference", "0.5")),
        (files, ("--method", "sfm")),
    ]
    for rasters_given, options in cases:
        result = run(rasters_given, out, *options)
        assert result.exit_code == 2
        assert f"{out} holds {says}" in result.stderr
        assert "of other files or options: choose another folder or remove it" in result.stderr
        assert len(result.stderr.splitlines()) == 1
        assert contents(out) == before


def test_a_scene_of_another_command_is_refused(files: Files, tmp_path: Path) -> None:
    """Also one of the same views without a map, which is not a part of this command's work."""
    out = tmp_path / "scene"
    photograph_orthophoto(*files, out, options=ViewOptions(altitude=34, overlap=0.4))
    before = contents(out)
    result = run(files, out)
    assert (result.exit_code, contents(out)) == (2, before)
    assert "holds a scene of other files or options" in result.stderr


def test_a_surface_without_texture(files: Files, black: Path, tmp_path: Path) -> None:
    """Nothing is left of the failed run, so another orthophoto can be given."""
    out = tmp_path / "scene"
    result = run((black, files[1]), out)
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert "no point could be triangulated from the " in line
    assert f" views of {black}: its surface shows no texture to match" in line
    assert not list(tmp_path.iterdir())


def test_a_failure_removes_no_finished_map_and_no_other_files(
    files: Files, undisturbed: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise NoPointsError("no point")

    before = contents(undisturbed[0])
    out = tmp_path / "scene"
    kill(files, out, MATCHING)
    (out / "sessions" / "virtual" / "notes.txt").write_text("mine")
    monkeypatch.setattr("objconnect.mapping.build.triangulate", fail)
    for folder in (undisturbed[0], out):
        assert "shows no texture" in run(files, folder).stderr
    assert contents(undisturbed[0]) == before
    assert list(contents(out)) == ["sessions/virtual/notes.txt"]


@pytest.mark.parametrize(("error", "is_kept"), [(WriteError, True), (InputError, False)])
def test_failures_while_views_are_rendered(
    files: Files,
    undisturbed: tuple[Path, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: type[InputError],
    is_kept: bool,
) -> None:
    """A full disk leaves work to continue; a damaged file leaves nothing."""
    out = tmp_path / "scene"

    def write_some(path: Path, rgb: NDArray[np.uint8], exif: Exif) -> None:
        if path.stem == "000002":
            raise error("what failed")
        write_jpeg(path, rgb, exif)

    with monkeypatch.context() as patch:
        patch.setattr(rendering, "write_jpeg", write_some)
        result = run(files, out)
    assert result.exit_code == 2 and "what failed" in result.stderr
    assert out.exists() == is_kept
    if is_kept:
        assert run(files, out).exit_code == 0
        assert contents(out) == contents(undisturbed[0])


def test_one_process_writes(files: Files, tmp_path: Path) -> None:
    out = tmp_path / "scene"
    with write_lock(out):
        before = contents(out)
        result = run(files, out)
        assert result.exit_code == 2
        assert f"another run is writing {out}: wait for it to end" in result.stderr
        assert contents(out) == before
    assert not out.exists()
