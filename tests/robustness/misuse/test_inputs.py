"""Files that are not what they should be, folders that hold more than ours, disks with no room."""

from __future__ import annotations

import math
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational
from safetensors.torch import save_file
from torch import nn
from typer.testing import CliRunner

import objconnect.ingestion.command
import objconnect.scene.storage.files
from benchmark.cli import app
from benchmark.evaluation.starts import parse_start
from objconnect.ingestion.photographs import Flight, FlightImage, read_flight
from objconnect.ingestion.positions import local_positions, replace_positions
from objconnect.learning.checkpoint import load_into, read_weights, write_weights
from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.matching.features import map_features
from objconnect.localization.matching.sift import Sift
from objconnect.mapping.build import build_map
from objconnect.mapping.dense.command import DENSE, dense
from objconnect.mapping.supplement.map import add_to_map
from objconnect.scene.checks.depth_check import DepthFrames, check_depth
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.sift import extract_sift
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.flights.textfiles import read_cameras, read_priors
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import (
    Geodetic,
    enu_from_geodetic,
    geodetic_from_enu,
    median_place,
)
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import Features, read_features, write_features
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.exif import Exif, read_exif, resize_file, write_jpeg
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.images import read_rgb
from simulate.config import SimulateConfig
from tests.benchmark.made_data import MAP_NAMES, pose_at, write_flight, write_model
from tests.objconnect.scene.storage.test_full_disk import GATE, disk  # noqa: F401

ROOT = Path(__file__).parents[3]


def expect_error(read: Callable[[], object]) -> str:
    """The one line that reading ends with."""
    with pytest.raises(InputError) as caught:
        read()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


# --- what the user keeps in our folders ---------------------------------------------------------

KEPT = (
    ".snapshot.20261122/a.txt",
    ".notes.markdown",
    ".zzz.abcdefgh",
    "map/NOTES.txt",
    "map/mine.bin",
    "map/old/cameras.bin",
    "dense/NOTES.txt",
    "dense/images/poster.png",
    "dense/stereo/old/a.bin",
    "sessions/.b.12345678",
)


@pytest.mark.thorough
def test_files_of_the_user_s_outlive_every_command_that_writes_a_scene(rendered_copy: Path) -> None:
    for name in KEPT:
        (rendered_copy / name).parent.mkdir(parents=True, exist_ok=True)
        (rendered_copy / name).write_text(name)
    build_map(rendered_copy)
    add_to_map(rendered_copy, [], {})
    dense(rendered_copy, size=64)
    lost = [name for name in KEPT if not (rendered_copy / name).is_file()]
    assert lost == []
    assert (rendered_copy / DENSE / "fused.ply").is_file()
    assert [path.name for path in rendered_copy.rglob(f"{TEMPORARY_PREFIX}*")] == []


def noise_jpeg(path: Path, seed: int, place: Geodetic | None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    rgb = np.random.default_rng(seed).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    write_jpeg(path, rgb, Exif(place, None, focal_35mm=24.0))


def test_an_ingest_that_fails_removes_what_it_wrote_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photographs, out = tmp_path / "photographs", tmp_path / "scene"
    for k in range(3):
        noise_jpeg(photographs / f"{k}.jpg", k, Geodetic(47.0 + 1e-4 * k, 8.0, 100.0))

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(objconnect.ingestion.command, "_build", interrupt)
        with pytest.raises(KeyboardInterrupt):
            objconnect.ingestion.command.ingest(photographs, out)
    kept = ("NOTES.txt", "map/mine.txt", "sessions/flight/images/mine.jpg", ".notes.markdown")
    for name in kept:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(name)
    said = expect_error(lambda: objconnect.ingestion.command.ingest(photographs, out))
    assert "could be registered together" in said
    left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert left == set(kept)


# --- scratch ------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_evaluation_needs_no_room_in_the_system_s_temporary_folder(
    disk: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    """A small one ended the process with SIGABRT, though results and cache lay elsewhere."""
    out, gate = tmp_path / "results", Path(shutil.copytree(GATE, tmp_path / "gate"))
    for name in ("queries.txt", "reference_poses.txt"):
        lines = (gate / name).read_text().splitlines()
        asked = [line for line in lines if not line.startswith("#")]
        (gate / name).write_text(f"{asked[0]}\n")
    words = [sys.executable, "-m", "benchmark.cli", "evaluate", str(gate), "--method", "sift"]
    done = subprocess.run(
        [*words, "--out", str(out)],
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(disk)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(disk.iterdir()) == []
    assert [path.name for path in out.rglob(f"{TEMPORARY_PREFIX}*")] == []


def test_room_is_asked_for_where_nobody_names_a_folder(
    disk: Path,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(disk))
    names = sorted(path.name for path in (GATE / "images" / "map" / "images").iterdir())[:2]
    with pytest.raises(WriteError, match=r"has \d+ MB left and \d+ MB are needed"):
        extract_sift(GATE / "images" / "map" / "images", names, SiftOptions())
    assert list(disk.iterdir()) == []


def test_scratch_is_gone_after_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_text("no pixels")
    temporary_root = tmp_path / "cache"
    with pytest.raises(InputError, match="damaged"):
        extract_sift(tmp_path, ["a.jpg"], SiftOptions(), parent=temporary_root)
    assert not temporary_root.exists()


def test_colmap_leaves_no_logs_and_ends_quietly(tmp_path: Path) -> None:
    """SIGTERM ends a process without a handler of its own."""
    code = (
        "import os, signal, objconnect.scene.colmap.native, pycolmap\n"
        "pycolmap.logging.error('of no use'); print('done', flush=True)\n"
        "os.kill(os.getpid(), signal.SIGTERM)"
    )
    done = python(code, TMPDIR=str(tmp_path))
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGTERM, "done\n", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("installed", ["before", "after"])
def test_colmap_takes_no_signal_of_python_s(installed: str) -> None:
    install = "signal.signal(signal.SIGTERM, lambda *_: sys.exit(7));"
    code = "import os, signal, sys;"
    code += install if installed == "before" else ""
    code += "import objconnect.scene.colmap.native;"
    code += install if installed == "after" else ""
    code += "os.kill(os.getpid(), signal.SIGTERM); signal.pause()"
    done = python(code)
    assert (done.returncode, done.stderr) == (7, "")


# --- places on earth ----------------------------------------------------------------------------


@given(
    st.floats(-89.99, 89.99),
    st.floats(-180, 180),
    st.lists(st.tuples(*[st.floats(-400, 400)] * 3), min_size=3, max_size=9),
)
@example(-17.0, 180.0, [(-300.0, 0, 0), (-200.0, 0, 0), (200.0, 0, 0), (300.0, 0, 0)])
@example(51.0, -180.0, [(-300.0, 0, 0), (-200.0, 0, 0), (200.0, 0, 0), (300.0, 0, 0)])
def test_an_origin_lies_amid_its_photographs_everywhere(
    latitude: float, longitude: float, offsets: list[tuple[float, float, float]]
) -> None:
    middle = Geodetic(latitude, longitude, 100.0)
    places = [geodetic_from_enu(np.array(offset), middle) for offset in offsets]
    origin = median_place(places)
    assert -90 <= origin.latitude <= 90
    assert -180 <= origin.longitude <= 180
    # A kilometre: the meridians of a flight around a pole have no middle.
    assert np.linalg.norm(enu_from_geodetic(origin, middle)) < 1000


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_an_origin_at_a_pole(latitude: float) -> None:
    pole = Geodetic(latitude, 0.0, 10.0)
    places = [geodetic_from_enu(np.array([x, y, 0.0]), pole) for x in (-50, 50) for y in (-50, 50)]
    assert np.linalg.norm(enu_from_geodetic(median_place([pole, *places]), pole)) < 100


def test_a_few_wrong_places_do_not_move_the_origin() -> None:
    places = [Geodetic(0.0, 0.0, 0.0)] * 2 + [
        Geodetic(-17.0, 179.999 + 0.0005 * k - (360 if k > 1 else 0), 50.0) for k in range(5)
    ]
    origin = median_place(places)
    assert abs(abs(origin.longitude) - 180) < 0.01
    assert origin.latitude == -17.0


def shot(file: str, place: Geodetic | None = None) -> FlightImage:
    return FlightImage(file, f"flight/images/{file}", file, Exif(place, None), (64, 48))


def test_photographs_on_both_sides_of_longitude_180() -> None:
    longitudes = (179.9995, -179.9995, -179.9990, 179.9990)
    shots = [shot(f"{k}.jpg", Geodetic(-17.0, lon, 80.0)) for k, lon in enumerate(longitudes)]
    origin, fixes = local_positions(shots)
    assert abs(abs(origin.longitude) - 180) < 0.001
    assert max(float(np.abs(fix).max()) for fix in fixes.values()) < 250


# --- tables of positions ------------------------------------------------------------------------

HEADER = "name,lat,lon,alt\n"
CARDS = Flight((shot("card1/DJI_0000.jpg"), shot("card2/DJI_0000.jpg"), shot("c/Einzig.JPG")), {})


def read_latitudes(tmp_path: Path, text: str, roll: Flight = CARDS) -> dict[str, float | None]:
    """Latitude of each photograph."""
    table = tmp_path / "gps.csv"
    table.write_text(text)
    found = replace_positions(roll, table).images
    return {s.file: s.exif.position.latitude if s.exif.position else None for s in found}


def test_a_bare_name_on_two_cards_is_refused(tmp_path: Path) -> None:
    said = expect_error(lambda: read_latitudes(tmp_path, HEADER + "DJI_0000.jpg,1,2,3\n"))
    assert "'DJI_0000.jpg' may be 'card1/DJI_0000.jpg' or 'card2/DJI_0000.jpg'" in said
    assert "folder" in said
    root = Flight((shot("a.jpg"), shot("b/a.jpg")), {})
    assert "may be" in expect_error(
        lambda: read_latitudes(tmp_path, HEADER + "a.jpg,1,2,3\n", root)
    )


def test_names_with_their_folder_tell_cards_apart(tmp_path: Path) -> None:
    rows = "card1/DJI_0000.jpg,1,2,3\ncard2\\dji_0000.JPG,4,5,6\neinzig.jpg,7,8,9\n"
    found = read_latitudes(tmp_path, HEADER + rows)
    assert list(found.values()) == [1, 4, 7]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEADER + '"' + "x" * 200_000 + ",1,2,3\n", "stray quote"),
        ("name,lat,lon,alt,lat\na,1,2,3,4\n", "two columns lat"),
    ],
)
def test_tables_that_cannot_be_read(tmp_path: Path, text: str, said: str) -> None:
    assert said in expect_error(lambda: read_latitudes(tmp_path, text))


# --- photographs --------------------------------------------------------------------------------


def png(path: Path, depth: int, colour: int, width: int, height: int, rows: bytes) -> Path:
    """A PNG of any kind, also of those that no library here writes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


@pytest.mark.parametrize(("low", "high"), [(0, 65_535), (0, 4095), (28_000, 31_000)])
def test_grey_of_16_bits_is_seen_as_it_would_be_in_8(tmp_path: Path, low: int, high: int) -> None:
    ramp = np.linspace(low, high, 64 * 48).reshape(48, 64)
    Image.fromarray(ramp.astype(np.uint16)).save(tmp_path / "a.png")
    pixels = read_rgb(tmp_path / "a.png")
    expected = np.linspace(0, 255, 64 * 48).reshape(48, 64, 1)
    assert np.abs(pixels - expected).max() <= 1


def test_colour_of_16_bits(tmp_path: Path) -> None:
    values = np.arange(48 * 64 * 3, dtype=np.uint16).reshape(48, 64, 3) * 7
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    pixels = read_rgb(png(tmp_path / "a.png", 16, 2, 64, 48, rows))
    assert np.abs(pixels.astype(int) - (values >> 8)).max() <= 1


def test_grey_that_is_no_number(tmp_path: Path) -> None:
    Image.fromarray(np.array([[1.0, math.nan]], np.float32)).save(tmp_path / "a.tiff")
    assert "not finite" in expect_error(lambda: read_rgb(tmp_path / "a.tiff"))


def make(path: Path, kind: str) -> Path:
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/null")
        case "folder":
            path.mkdir()
        case "empty":
            path.touch()
        case "huge":
            png(path, 8, 2, 60_000, 60_000, b"")
        case "large":
            png(path, 8, 2, 15_000, 9_000, b"")
        case "text":
            path.write_text("no pixels")
        case "truncated":
            noise_jpeg(path, 0, None)
            path.write_bytes(path.read_bytes()[:1500])
        case "loop":
            path.symlink_to(path.name)
    return path


class _WaitsError(BaseException):
    """Which no reader takes for a damaged file."""


@pytest.fixture
def wake_waiting() -> Iterator[None]:
    """Whoever waits for a pipe is woken."""

    def wake(*_: object) -> None:
        raise _WaitsError

    before = signal.signal(signal.SIGALRM, wake)
    signal.alarm(300)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


KINDS = ("pipe", "device", "folder", "empty", "huge", "large", "text", "truncated", "loop")


@pytest.mark.usefixtures("wake_waiting")
@pytest.mark.parametrize("kind", KINDS)
def test_a_photograph_that_is_none_is_one_line(
    tmp_path: Path, kind: str, recwarn: pytest.WarningsRecorder
) -> None:
    path = make(tmp_path / "a.jpg", kind)
    assert "a.jpg" in expect_error(lambda: read_rgb(path))
    if kind not in ("truncated", "large"):
        assert "a.jpg" in expect_error(lambda: read_exif(path))


def test_large_and_damaged_photographs_print_no_warning(tmp_path: Path) -> None:
    """A warning of Pillow's is two lines on standard error, where the command line tunes it."""
    make(tmp_path / "a.jpg", "large")
    code = "import os, pathlib, objconnect as oc\n"
    code += "from objconnect.scene.storage.exif import read_exif\n"
    code += "with oc.ProcessTuning(): read_exif(pathlib.Path(os.environ['PHOTOGRAPH']))"
    done = python(code, PHOTOGRAPH=str(tmp_path / "a.jpg"))
    assert (done.returncode, done.stderr) == (0, "")


def tag(path: Path, change: Callable[[Image.Exif], None], **info: bytes) -> Path:
    rgb = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    tags = Image.Exif()
    change(tags)
    Image.fromarray(rgb).save(path, exif=tags.tobytes(), **info)
    return path


def set_time(text: str, digits: str = "") -> Callable[[Image.Exif], None]:
    def change(tags: Image.Exif) -> None:
        detail = tags.get_ifd(ExifTags.IFD.Exif)
        detail[ExifTags.Base.DateTimeOriginal] = text
        detail[ExifTags.Base.SubsecTimeOriginal] = digits

    return change


@pytest.mark.parametrize(
    "stamp", [("0000:00:00 00:00:00", ""), ("9999:12:31 23:59:59", "9" * 20), ("9999:12:31", "")]
)
def test_times_that_no_calendar_has(tmp_path: Path, stamp: tuple[str, str]) -> None:
    assert read_exif(tag(tmp_path / "a.jpg", set_time(*stamp))).time is None


def test_numbers_of_exif_that_say_nothing(tmp_path: Path) -> None:
    nothing = IFDRational(1, 0)

    def change(tags: Image.Exif) -> None:
        detail = tags.get_ifd(ExifTags.IFD.Exif)
        detail[ExifTags.Base.FocalLength] = nothing
        detail[ExifTags.Base.FocalPlaneXResolution] = nothing
        detail[ExifTags.Base.FocalLengthIn35mmFilm] = 65_535
        gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
        gps[ExifTags.GPS.GPSLatitudeRef], gps[ExifTags.GPS.GPSLongitudeRef] = "N", "E"
        gps[ExifTags.GPS.GPSLatitude] = (nothing,) * 3
        gps[ExifTags.GPS.GPSLongitude] = (9.0, 0.0, 0.0)

    xmp = b'<x drone-dji:GimbalYawDegree="." GimbalPitchDegree="-90" GimbalRollDegree="0"/>'
    exif = read_exif(tag(tmp_path / "a.jpg", change, xmp=xmp))
    assert (exif.position, exif.focal_35mm, exif.gimbal) == (None, None, None)


def test_exif_of_more_than_64_kb_is_copied_with_what_we_read(tmp_path: Path) -> None:
    """JPEG splits it over segments; Pillow joins them, and writes one alone."""
    write_jpeg(tmp_path / "b.jpg", np.zeros((48, 64, 3), np.uint8), Exif(Geodetic(1, 2, 3), None))
    whole = (tmp_path / "b.jpg").read_bytes()
    more = b"\xff\xe1" + struct.pack(">H", 60_008) + b"Exif\0\0" + bytes(60_000)
    at = whole.index(b"\xff\xdb")
    (tmp_path / "b.jpg").write_bytes(whole[:at] + 2 * more + whole[at:])
    with Image.open(tmp_path / "b.jpg") as image:
        assert len(image.info["exif"]) > 1 << 16
    resize_file(tmp_path / "b.jpg", tmp_path / "c.jpg", 32)
    assert read_rgb(tmp_path / "c.jpg").shape == (24, 32, 3)
    assert read_exif(tmp_path / "c.jpg").position == pytest.approx((1, 2, 3))


# --- other files --------------------------------------------------------------------------------

READERS: dict[str, Callable[[Path], object]] = {
    "text": lambda path: read_text(path, "text"),
    "digest": sha256_of,
    "configuration": lambda path: load_config(SimulateConfig, path, {}),
    "pairs": lambda path: parse_start(f"pairs={path}"),
    "priors": read_priors,
    "queries": read_cameras,
    "features": read_features,
    "weights": read_weights,
    "positions": lambda path: replace_positions(CARDS, path),
}


@pytest.mark.usefixtures("wake_waiting")
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "loop"])
@pytest.mark.parametrize("reader", list(READERS))
def test_what_is_no_file_is_not_opened(tmp_path: Path, reader: str, kind: str) -> None:
    path = make(tmp_path / "given", kind)
    assert str(path) in expect_error(lambda: READERS[reader](path))


@pytest.mark.usefixtures("wake_waiting")
def test_a_model_with_a_pipe_in_it(tmp_path: Path) -> None:
    write_model(tmp_path / "map", {name: pose_at(k) for k, name in enumerate(MAP_NAMES)})
    (tmp_path / "map" / "images.bin").unlink()
    os.mkfifo(tmp_path / "map" / "images.bin")
    assert "images.bin" in expect_error(lambda: read_model(tmp_path / "map"))


def test_texts_have_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objconnect.scene.storage.files, "_LONGEST_TEXT", 10, raising=False)
    (tmp_path / "a").write_text("0123456789")
    assert read_text(tmp_path / "a", "list") == "0123456789"
    (tmp_path / "a").write_text("0123456789+")
    assert "larger than" in expect_error(lambda: read_text(tmp_path / "a", "list"))


@pytest.mark.parametrize(
    "words", [["--frames", "100000000"], ["--spp", "100000000"], ["--size", "100000000"]]
)
def test_a_scene_of_no_end_is_refused_before_any_work(tmp_path: Path, words: list[str]) -> None:
    done = CliRunner().invoke(app, ["simulate", "--out", str(tmp_path / "scene"), *words])
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"bad value for '{words[0][2:]}'" in done.stderr
    assert not (tmp_path / "scene").exists()


# --- maps ---------------------------------------------------------------------------------------


def test_a_backslash_in_the_name_of_an_image(tmp_path: Path) -> None:
    names = ("a\\b.jpg", "a/b.jpg", "\\", "a\\\\b.jpg", "a\\.\\b.jpg")
    item = Features(np.zeros((1, 2), np.float32), np.ones(1, np.float32), np.zeros((1, 128)))
    write_features(tmp_path / "f.h5", dict.fromkeys(names, item))
    assert set(read_features(tmp_path / "f.h5")) == set(names)


def test_a_map_of_images_with_backslashes(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / "meadow")
    shutil.copy(flight / "images" / "a.jpg", flight / "images" / "x\\y.jpg")
    write_model(tmp_path / "map", {"c.jpg": pose_at(0), "x\\y.jpg": pose_at(1)})
    sparse_map = read_model(tmp_path / "map")
    kept = MapCache.of(sparse_map, flight / "images", tmp_path / "cache")
    features = map_features(kept, Sift(500))
    assert set(features) == {"c.jpg", "x\\y.jpg"}
    assert len(features["x\\y.jpg"].xy)
    said = expect_error(lambda: MapCache.of(sparse_map, tmp_path, tmp_path / "cache"))
    assert "c.jpg does not exist" in said
    (flight / "images" / "x\\y.jpg").unlink()
    said = expect_error(lambda: MapCache.of(sparse_map, flight / "images", tmp_path / "cache"))
    assert "does not exist: the model that names it was made on Windows" in said


def test_a_text_model_says_how_to_convert_it(tmp_path: Path) -> None:
    for part in ("cameras", "images", "points3D"):
        (tmp_path / f"{part}.txt").write_text("# a list\n")
    said = expect_error(lambda: read_model(tmp_path))
    assert "is a text model: convert it with 'colmap model_converter --input_path" in said


# --- weights ------------------------------------------------------------------------------------


def test_no_message_recommends_to_run_what_a_checkpoint_holds(tmp_path: Path) -> None:
    path = tmp_path / "w.tar"
    torch.save({"w": torch.ones(2)}, path, _use_new_zipfile_serialization=False)
    data = path.read_bytes()
    for broken in (data[4:], b"\x80\x02cbuiltins\neval\n(Vprint(1)\ntR.", b"(lp0\n.", data[:30]):
        path.write_bytes(broken)
        said = expect_error(lambda: read_weights(path))
        assert "weights_only" not in said
        assert "arbitrary" not in said


@pytest.mark.parametrize(
    "change",
    [
        lambda w: w.int(),
        lambda w: w.bool(),
        lambda w: w.to(torch.complex64),
        lambda w: torch.full_like(w, math.nan),
        lambda w: torch.full_like(w, math.inf),
        lambda w: torch.full_like(w, 1e300, dtype=torch.float64),
    ],
    ids=["int32", "bool", "complex", "nan", "inf", "too_large"],
)
def test_weights_that_are_no_weights(
    tmp_path: Path, change: Callable[[torch.Tensor], torch.Tensor]
) -> None:
    network = nn.Linear(3, 2)
    write_weights(tmp_path / "w.safetensors", network, {})
    tensors = read_weights(tmp_path / "w.safetensors").tensors
    load_into(network, {name: value.half() for name, value in tensors.items()}, tmp_path)
    tensors["weight"] = change(tensors["weight"]).contiguous()
    if not tensors["weight"].is_complex():
        save_file(tensors, tmp_path / "w.safetensors")
        tensors = read_weights(tmp_path / "w.safetensors").tensors
    said = expect_error(lambda: load_into(network, tensors, tmp_path / "w.safetensors"))
    assert "weight" in said


# --- validation and progress --------------------------------------------------------------------


def test_one_frame_has_nothing_to_be_compared_with() -> None:
    camera = Camera("PINHOLE", 64, 48, (50.0, 50.0, 32.0, 24.0))
    depth = np.full((48, 64), 40, np.float32)
    frame = DepthFrames(
        [camera], pose_at(0).matrix().numpy()[None], [depth], [np.ones((48, 64), np.uint16)]
    )
    check = check_depth("depth and poses agree", frame)
    assert check.ok
    assert "only one frame" in check.detail


def test_depth_that_agrees_with_no_pose_is_one_line() -> None:
    camera = Camera("PINHOLE", 64, 48, (50.0, 50.0, 32.0, 24.0))
    depths = [np.full((48, 64), metres, np.float32) for metres in (50, 100)]
    poses = np.stack([pose_at(k).matrix().numpy() for k in (0, 1)])
    objects = [np.ones((48, 64), np.uint16)] * 2
    check = check_depth("depth and poses agree", DepthFrames([camera] * 2, poses, depths, objects))
    assert not check.ok
    assert "wrong" in check.detail


def lines_of(
    capsys: pytest.CaptureFixture[str], steps: int, seconds: float, before: int = 0
) -> list[str]:
    """What a log file gets of so many steps of so many seconds."""
    now = 0.0
    with progress_bar("map", steps, clock=lambda: now) as advance:
        if before:
            advance(before)
        for done in range(before + 1, steps + 1):
            now += seconds
            advance(done)
    return capsys.readouterr().err.splitlines()


def test_a_log_shows_life(capsys: pytest.CaptureFixture[str]) -> None:
    assert lines_of(capsys, 90, 0.1) == []
    lines = lines_of(capsys, 400, 1.0)
    assert lines[0] == "map: 10 of 400, 6 min left"
    assert lines[1] == "map: 40 of 400, 6 min left"
    assert lines[-1] == "map: 400 of 400"
    assert len(lines) == 14
    # Each tenth of the whole, when it takes long enough.
    assert len(lines_of(capsys, 100, 1.5)) == 10
    assert lines_of(capsys, 2, 40_000)[-1] == "map: 2 of 2"
    # An earlier run's steps took no time.
    assert lines_of(capsys, 100, 10.0, before=50)[0] == "map: 51 of 100, 8 min left"


def test_names_in_a_log_hold_no_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("a\x1b[31m\nb", 2, clock=iter([0.0, 50.0]).__next__) as advance:
        advance(1)
    assert capsys.readouterr().err == "a\\x1b[31m\\nb: 1 of 2\n"


# --- folders of photographs ---------------------------------------------------------------------


@pytest.mark.usefixtures("wake_waiting")
def test_a_folder_of_photographs_of_every_kind(tmp_path: Path) -> None:
    for k, name in enumerate(("a.jpg", "sub/a.jpg", "sub/deeper/b c.jpg", "back\\slash.JPG")):
        noise_jpeg(tmp_path / name, k, Geodetic(1.0, 2.0, 3.0))
    shutil.copy(tmp_path / "a.jpg", tmp_path / "z.jpg")
    shutil.copy(tmp_path / "a.jpg", tmp_path / "._a.jpg")
    shutil.copy(tmp_path / "sub/a.jpg", os.fsencode(tmp_path) + b"/caf\xe9.jpg")
    for kind in KINDS:
        if kind not in ("truncated", "large"):
            make(tmp_path / f"{kind}.jpg", kind)
    roll = read_flight(tmp_path)
    assert [shot.file for shot in roll.images] == [
        "a.jpg",
        "back\\slash.JPG",
        "sub/a.jpg",
        "sub/deeper/b c.jpg",
    ]
    left_out = set(roll.left_out)
    assert left_out == {
        "z.jpg",
        "caf\\udce9.jpg",
        *(f"{kind}.jpg" for kind in ("pipe", "device", "empty", "huge", "text", "loop")),
    }
    assert "not UTF-8" in roll.left_out["caf\\udce9.jpg"]
    assert "pipe" in roll.left_out["pipe.jpg"]
    assert all(text.isprintable() for text in [*roll.left_out, *roll.left_out.values()])
