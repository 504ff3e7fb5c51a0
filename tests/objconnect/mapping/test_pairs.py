"""Flights of two orthophotos of different dates."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin
from typer.testing import CliRunner

from baselines.sift import SiftConfig, SiftLocalizer
from benchmark.cli import app
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import parse_start
from benchmark.report.tables import tables
from objconnect.ingestion.virtual.command import VirtualReport
from objconnect.mapping.pairs.command import PairReport, ingest_pair
from objconnect.mapping.pairs.options import PairQueryOptions
from objconnect.mapping.pairs.photographs import query_camera
from objconnect.mapping.pairs.rasters import read_homography
from objconnect.scene.errors import InputError
from objconnect.scene.flights.reference_error import (
    REFERENCE_ERROR,
    ReferencePoseError,
    read_reference_error,
)
from objconnect.scene.flights.textfiles import read_cameras, read_poses
from objconnect.scene.storage.images import read_rgb

pytestmark = pytest.mark.usefixtures("extracted_once")

Array = NDArray[np.float64]

PIXEL = 0.2
SIDE = 360
EAST, NORTH = 500_000.0, 5_300_000.0
# The other date is so many pixels too far to the east and north.
WRONG = (2, 1)
SMALL = PairQueryOptions(queries=4, size=160, height_m=(24, 30), seed=3)
PLAIN = SMALL.model_copy(update={"noise": 0, "blur_px": 0, "vignetting": 0, "jpeg_quality": 100})


def texture(seed: int) -> Array:
    """Colours (SIDE, SIDE, 3) in 0..1 with details of many sizes."""
    rng = np.random.default_rng(seed)
    layers = []
    for size in (1.2, 3.0, 8.0, 25.0):
        noise = rng.normal(size=(SIDE, SIDE, 3)).astype(np.float32)
        layers.append(cv2.GaussianBlur(noise, (0, 0), size) * size)
    return np.asarray(0.5 + 0.45 * np.tanh(2.5 * np.sum(layers, 0)), np.float64)


def season(colours: Array) -> Array:
    """The same ground in another season: other colours, brown fields, another light."""
    mixed = np.clip(colours @ np.array([[0.6, 0.3, 0], [0.3, 0.5, 0.1], [0.1, 0.1, 0.5]]), 0, 1)
    fields = cv2.GaussianBlur(texture(77), (0, 0), 20).mean(-1) > 0.52
    brown = 0.5 * mixed + 0.5 * np.array([0.45, 0.33, 0.2])
    return np.asarray(np.where(fields[..., None], brown, mixed**0.8))


def write(path: Path, colours: Array, shift: tuple[int, int] = (0, 0), **changes: Any) -> Path:
    """Write colours as an orthophoto, with its west end moved by pixels to the east and north."""
    pixel, crs = changes.get("pixel", PIXEL), changes.get("crs", "EPSG:32632")
    corner = (EAST + shift[0] * pixel, NORTH + shift[1] * pixel)
    values = np.rint(255 * colours).astype(np.uint8).transpose(2, 0, 1)
    place = {} if crs is None else {"crs": crs, "transform": from_origin(*corner, pixel, pixel)}
    size = {"width": values.shape[2], "height": values.shape[1], "count": 3}
    kind = {"driver": "GTiff", "dtype": "uint8", "photometric": "RGB"}
    with rasterio.open(path, "w", **kind, **size, **place) as file:
        file.write(values)
    return path


@dataclass(frozen=True)
class Pair:
    mapped: Path
    other: Path
    colours: Array


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    folder, ground = tmp_path_factory.mktemp("pair"), texture(5)
    later = season(ground)
    files = write(folder / "summer.tif", ground), write(folder / "autumn.tif", later, WRONG)
    return Pair(*files, later)


@pytest.fixture
def unmapped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the map, which the test does not look at."""
    reports = VirtualReport(4, 50.0, 0.2, 0), SimpleNamespace(text=lambda: "no map")
    monkeypatch.setattr("objconnect.mapping.pairs.command._write_map", lambda *_: reports)


@pytest.fixture(scope="module")
def made(pair: Pair, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PairReport]:
    out = tmp_path_factory.mktemp("made") / "flight"
    return out, ingest_pair(pair.mapped, pair.other, out, options=SMALL)


def test_queries_of_another_season_are_found(made: tuple[Path, PairReport], tmp_path: Path) -> None:
    out = tmp_path / "flight"
    shutil.copytree(made[0], out)
    assert open_datasets(out)[0].unjudged == ()
    (out / REFERENCE_ERROR).write_text('{"metres": null, "source": "unknown"}')
    assert open_datasets(out)[0].unjudged == ("0.25 m 2°", "0.5 m 5°", "1 m", "5 m 10°")
    (out / REFERENCE_ERROR).write_text('{"metres": 0.2, "source": "stated"}')
    (dataset,) = open_datasets(out)
    assert dataset.map_conditions == ("map-date",)
    assert {query.condition for query in dataset.queries} == {"other-date"}
    start = parse_start("error=3m,5deg")
    results = evaluate(dataset, SiftLocalizer(SiftConfig()), tmp_path / "results", start)
    assert results.summary.recall["0.25m_2deg"] is None, "these reference poses do not judge it"
    found = results.summary.recall["0.5m_5deg"]
    assert found is not None and found.value == 100
    assert results.summary.median_t_m is not None and results.summary.median_t_m < PIXEL / 2
    (table,) = tables([tmp_path / "results"])
    assert table.facts().endswith("The reference poses are too inexact to judge 0.25 m 2°.")


def test_the_offset_is_measured_and_taken_out(made: tuple[Path, PairReport]) -> None:
    out, report = made
    assert np.allclose(report.moved_m, np.multiply(WRONG, -PIXEL), atol=0.1 * PIXEL)
    assert report.registration.windows == 16 and report.registration.agreeing >= 15
    assert report.registration.largest_m is not None
    assert report.registration.largest_m < 0.2 * PIXEL
    error = read_reference_error(out)
    assert error is not None and (error.metres, error.source) == (
        report.registration.largest_m,
        "measured",
    )
    record = json.loads((out / "pair.json").read_text())
    assert record["other"]["file"] == "autumn.tif" and record["options"]["seed"] == 3
    assert tuple(record["moved_m"]) == report.moved_m


def test_poses_are_exact(pair: Pair, tmp_path: Path, unmapped: None) -> None:
    """Pixels of a query have the colour that the file has where their rays meet the ground."""
    out = tmp_path / "flight"
    options = PLAIN.model_copy(update={"queries": 2})
    report = ingest_pair(pair.mapped, pair.other, out, options=options)
    origin = (EAST + SIDE * PIXEL / 2, NORTH - SIDE * PIXEL / 2)
    camera, moved = query_camera(options), np.multiply(report.moved_m, 0.9996)
    assert list(read_cameras(out / "queries.txt").values()) == [camera, camera]
    rays = camera.unproject(camera.pixel_grid())[0].numpy()
    for name, pose in read_poses(out / "reference_poses.txt").items():
        directions = rays @ pose.rotation.numpy()
        centre = pose.centre().numpy()
        assert 24 <= centre[2] <= 30
        ground = centre[:2] + directions[..., :2] * (centre[2] / -directions[..., 2])[..., None]
        # A metre of the UTM grid is 1.0004 m on its middle meridian.
        left, top = EAST + WRONG[0] * PIXEL + moved[0], NORTH + WRONG[1] * PIXEL + moved[1]
        columns = (origin[0] + 0.9996 * ground[..., 0] - left) / PIXEL - 0.5
        rows = (top - origin[1] - 0.9996 * ground[..., 1]) / PIXEL - 0.5
        expected = cv2.remap(
            np.float32(255 * pair.colours),
            columns.astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        inside = (columns > 2) & (columns < SIDE - 3) & (rows > 2) & (rows < SIDE - 3)
        unlike = np.abs(read_rgb(out / "images" / name) - expected).max(-1)[inside]
        assert np.percentile(unlike, 90) < 12


@pytest.mark.thorough
def test_a_seed_repeats_a_flight(pair: Pair, tmp_path: Path, unmapped: None) -> None:
    poses = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        options = SMALL.model_copy(update={"seed": seed, "queries": 2})
        ingest_pair(pair.mapped, pair.other, tmp_path / name, options=options)
        poses.append((tmp_path / name / "reference_poses.txt").read_bytes())
    assert poses[0] == poses[1] != poses[2]
    one, other = (tmp_path / name / "images" / "q0000.jpg" for name in ("a", "b"))
    assert one.read_bytes() == other.read_bytes()


def test_a_picture_is_placed_by_a_homography(pair: Pair, tmp_path: Path, unmapped: None) -> None:
    """A turned and finer picture without georeference."""
    turn, side = np.deg2rad(1), 2 * SIDE
    matrix = np.eye(3)
    matrix[:2, :2] = 0.5 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    matrix[:2, 2] = SIDE / 2 - matrix[:2, :2] @ [side / 2, side / 2]
    size = (side, side)
    back = cv2.WARP_INVERSE_MAP | cv2.INTER_CUBIC
    colours = np.float32(np.clip(255 * pair.colours, 0, 255))
    picture = cv2.warpPerspective(colours, matrix, size, flags=back)
    cv2.imwrite(str(tmp_path / "other.png"), np.uint8(np.clip(picture, 0, 255))[..., ::-1])
    np.savetxt(tmp_path / "h.txt", matrix)
    report = ingest_pair(
        pair.mapped,
        tmp_path / "other.png",
        tmp_path / "flight",
        homography=tmp_path / "h.txt",
        options=SMALL,
    )
    assert np.hypot(*report.moved_m) < 0.1 * PIXEL
    assert report.registration.largest_m is not None
    assert report.registration.largest_m < 0.3 * PIXEL


@pytest.mark.thorough
def test_another_system_is_converted(pair: Pair, tmp_path: Path, unmapped: None) -> None:
    """The other date in the neighbouring UTM zone, where north is turned by some degrees."""
    from rasterio.warp import Resampling, reproject

    colours = np.rint(255 * pair.colours).astype(np.uint8).transpose(2, 0, 1)
    place = from_origin(EAST, NORTH, PIXEL, PIXEL)
    east, north = rasterio.warp.transform("EPSG:32632", "EPSG:32633", [EAST], [NORTH])
    target = from_origin(east[0] - 10, north[0] + 10, PIXEL, PIXEL)
    turned = np.zeros((3, SIDE + 100, SIDE + 100), np.uint8)
    reproject(
        colours,
        turned,
        src_transform=place,
        src_crs="EPSG:32632",
        dst_transform=target,
        dst_crs="EPSG:32633",
        resampling=Resampling.cubic,
    )
    path = tmp_path / "zone33.tif"
    size = {"width": SIDE + 100, "height": SIDE + 100, "count": 3, "dtype": "uint8"}
    kind = {"driver": "GTiff", "photometric": "RGB", "nodata": 0, "crs": "EPSG:32633"}
    with rasterio.open(path, "w", transform=target, **size, **kind) as file:
        file.write(turned)
    report = ingest_pair(pair.mapped, path, tmp_path / "flight", options=SMALL)
    assert report.registration.largest_m is not None and np.hypot(*report.moved_m) < 0.1 * PIXEL


def test_dates_that_do_not_agree_are_told(pair: Pair, tmp_path: Path, unmapped: None) -> None:
    stranger, out = write(tmp_path / "stranger.tif", texture(9)), tmp_path / "flight"
    command = ["ingest", str(stranger), "--pair", str(pair.mapped), "--out", str(out)]
    settings = ["--set", "queries=2", "--set", "size=128", "--set", "height_m=[24, 30]"]
    result = CliRunner().invoke(app, [*command, *settings])
    assert result.exit_code == 0, result.output
    (line,) = (x for x in result.output.splitlines() if x.startswith("registration unknown: "))
    assert line.endswith("compare the two files; if you know the error, give --residual METRES")
    assert "recall cannot be measured" in result.output
    error = read_reference_error(out)
    assert error is not None and (error.metres, error.source) == (None, "unknown")


@pytest.mark.parametrize(
    ("metres", "judged"), [(0.0, (0.25, 0.5, 5)), (0.12, (0.25, 0.5, 5)), (0.2, (0.5, 5)), (3, ())]
)
def test_what_an_error_judges(metres: float, judged: tuple[float, ...]) -> None:
    error = ReferencePoseError(metres=metres, source="stated")
    assert tuple(t for t in (0.25, 0.5, 5) if error.can_judge(t)) == judged


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"shift": (5000, 0)}, "do not overlap"),
        ({"pixel": 1.0}, "may differ by a factor of 4"),
        ({"crs": None}, "other.tif"),
        ({"crs": "EPSG:4326"}, "other.tif"),
        ({"shift": (SIDE - 40, 0)}, "lie within both orthophotos"),
    ],
)
def test_bad_pairs_are_refused(
    changes: dict[str, Any], says: str, pair: Pair, tmp_path: Path
) -> None:
    other = write(tmp_path / "other.tif", pair.colours, **changes)
    with pytest.raises(InputError, match=says) as error:
        ingest_pair(pair.mapped, other, tmp_path / "flight", options=SMALL)
    assert "\n" not in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["other.tif"], "nothing is left"


@pytest.mark.parametrize("swapped", [False, True])
def test_an_orthophoto_without_contrast_is_refused(
    swapped: bool, pair: Pair, tmp_path: Path
) -> None:
    even = write(tmp_path / "even.tif", np.full_like(pair.colours, 0.4))
    files = (even, pair.mapped) if swapped else (pair.mapped, even)
    with pytest.raises(InputError, match=r"even.tif has no contrast") as error:
        ingest_pair(*files, tmp_path / "flight", residual=0.1, options=SMALL)
    assert "\n" not in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["even.tif"], "nothing is left"


def test_windows_without_edges_are_not_clear(pair: Pair, tmp_path: Path, unmapped: None) -> None:
    colours = pair.colours.copy()
    colours[:, 150:] = 0.4
    other = write(tmp_path / "half.tif", colours, WRONG)
    registration = ingest_pair(pair.mapped, other, tmp_path / "flight", options=SMALL).registration
    assert registration.windows == 16
    assert 0 < registration.clear <= 8


def test_a_map_that_is_too_small_is_refused(pair: Pair, tmp_path: Path) -> None:
    small = write(tmp_path / "small.tif", pair.colours[:200])
    with pytest.raises(InputError, match=r"small.tif covers 72 x 40 m, a map needs 72 x 72 m"):
        ingest_pair(small, pair.other, tmp_path / "flight", options=SMALL)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 0 0\n0 1 0\n", "9 numbers"),
        ("1 0 0 0 1 0 0 0 nan", "not finite"),
        ("1 0 0 0 1 0 0 0 0", "ends in 0"),
        ("-1 0 0 0 1 0 0 0 1", "mirrors"),
        ("a b c d e f g h i", "9 numbers"),
    ],
)
def test_bad_homographies_are_refused(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "h.txt").write_text(text)
    with pytest.raises(InputError, match=says):
        read_homography(tmp_path / "h.txt")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--every", "3"], "--every is for photographs"),
        (["--set", "tilt_deg=80"], "tilt_deg"),
        (["--set", "height_m=[30, 20]"], "the lower height comes first"),
        (["--undulation", "48"], "give --dsm"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    words: list[str], says: str, pair: Pair, tmp_path: Path
) -> None:
    command = ["ingest", str(pair.other), "--pair", str(pair.mapped)]
    result = CliRunner().invoke(app, [*command, "--out", str(tmp_path / "flight"), *words])
    assert result.exit_code == 2 and says in result.output
    assert not list(tmp_path.iterdir())


def test_options_of_pairs_need_a_pair(tmp_path: Path) -> None:
    command = ["ingest", str(tmp_path), "--out", str(tmp_path / "x"), "--set", "queries=2"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2 and "--set is for two orthophotos: give --pair" in result.output
