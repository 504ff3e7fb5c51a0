"""Ground control points: their list, where marks put them, and the fit to them.

Marks are exact projections with the true poses; the model that the points correct is the true one
turned, stretched and shifted, as errors of GPS do it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import torch
from numpy.typing import NDArray

from objconnect.ingestion.adjustment import AdjustedModel
from objconnect.ingestion.command import ingest
from objconnect.ingestion.control import control_text, fit_to_control, triangulate_marks
from objconnect.ingestion.control_points import ControlPoint, read_control_points
from objconnect.ingestion.georegister import Georegistration
from objconnect.ingestion.options import IngestOptions
from objconnect.ingestion.photographs import SESSION, Flight, FlightImage
from objconnect.ingestion.report import Residuals, gps_remark
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.colmap.structure_from_motion import RefinedLenses
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.exif import Exif

Array = NDArray[np.float64]
ORIGIN = Geodetic(47.0, 8.0, 400.0)
CAMERA = Camera("SIMPLE_RADIAL", 1000, 750, (800.0, 500.0, 375.0, -0.02))
MAP_SESSION = "summer-noon-nadir-map"


def true_model(folder: Path) -> SparseMap:
    """A strip of nine cameras at 60 m over rolling ground, with exact observations."""
    poses = {}
    for k in range(9):
        centre = np.array([25.0 * (k % 3) - 25, 25.0 * (k // 3) - 25, 60.0 + k % 2])
        tilt = so3_exp(torch.tensor([0.05 * (k - 4), 0.02 * k, 0.3 * k], dtype=torch.float64))
        pose = np.eye(4)
        pose[:3, :3] = tilt.numpy() @ np.diag([1.0, -1.0, -1.0])
        pose[:3, 3] = -pose[:3, :3] @ centre
        poses[f"{k}.jpg"] = pose
    ground = np.random.default_rng(3).uniform([-60, -60, 0], [60, 60, 8], (500, 3))
    nothing = np.zeros((0, 2)), np.zeros(0, np.int64)
    blank = {name: MapImage(name, CAMERA, pose, *nothing) for name, pose in poses.items()}
    seen_often = sum(project(image, ground)[1].astype(int) for image in blank.values()) >= 2
    ground = ground[seen_often]
    images = {}
    for name, image in blank.items():
        xy, there = project(image, ground)
        images[name] = replace(image, xy=xy[there], point_rows=np.flatnonzero(there))
    count = len(ground)
    colours = np.zeros((count, 3), np.uint8)
    whole = SparseMap(images, ground, colours, np.zeros(count), np.full(count, 2))
    posed = [PosedImage(i.name, i.camera, i.cam_from_world) for i in images.values()]
    write_with_poses(posed, whole, folder)
    return read_model(folder)


def project(image: MapImage, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    seen = image.camera.project(image.pose.transform(torch.from_numpy(points)))
    there = seen.valid & image.camera.contains(seen.xy)
    return seen.xy.numpy(), there.numpy()


def survey(model: SparseMap, moved: Mapping[str, Array], checks: set[str]) -> list[ControlPoint]:
    """Seven points with exact marks; the surveyed positions of some are wrong by ``moved``."""
    places = [[-22, -25, 1], [23, -20, 2], [20, 18, 5], [-24, 21, 3], [0, 2, 7], [12, -9, 0]]
    points = []
    for name, place in zip("ABCDEF", np.array(places, float), strict=True):
        marks = {}
        for image in model.images.values():
            xy, there = project(image, place[None])
            if there[0]:
                marks[image.name] = xy[0]
        told = geodetic_from_enu(place + moved.get(name, np.zeros(3)), ORIGIN)
        points.append(ControlPoint(name, told, name in checks, marks))
    return points


def place_by_gps(model: SparseMap, folder: Path) -> AdjustedModel:
    """The model as GPS of metres would place it."""
    turn = so3_exp(torch.tensor([0.01, -0.015, 0.02], dtype=torch.float64)).numpy()
    wrong = np.column_stack([1.004 * turn, [1.5, -2.0, 3.0]])
    moved = model.transform(wrong)
    posed = [PosedImage(i.name, i.camera, i.cam_from_world) for i in moved.images.values()]
    folder.mkdir()
    write_with_poses(posed, moved, folder)
    placed = Georegistration(np.eye(4)[:3], "gps", (), np.ones(3))
    return AdjustedModel(read_model(folder), placed, RefinedLenses(()), 0.0, {}, folder)


def fit(
    tmp_path: Path, moved: Mapping[str, Array], checks: set[str], sigma: float = 0.02
) -> tuple[SparseMap, AdjustedModel, dict[str, Any], list[str]]:
    (tmp_path / "true").mkdir()
    model = true_model(tmp_path / "true")
    points = survey(model, moved, checks)
    photographs = [Photograph(name, CAMERA, "lens", True, True) for name in model.names]
    options = IngestOptions(control_sigma_m=sigma)
    adjusted, residuals = fit_to_control(
        place_by_gps(model, tmp_path / "gps"), points, ORIGIN, photographs, tmp_path, options
    )
    return model, adjusted, {r.name: r for r in residuals}, control_text(residuals)


@pytest.mark.parametrize(
    ("scale", "shift"), [(1.0, (0.0, 0.0, 300.0)), (40.0, (900.0, -500.0, 20.0))]
)
def test_points_place_a_model_that_was_moved_after_it_was_written(
    scale: float, shift: tuple[float, float, float], tmp_path: Path
) -> None:
    (tmp_path / "true").mkdir()
    model = true_model(tmp_path / "true")
    photographs = [Photograph(name, CAMERA, "lens", True, True) for name in model.names]
    adjusted = place_by_gps(model, tmp_path / "gps")
    moved = adjusted.model.transform(np.column_stack([scale * np.eye(3), shift]))
    adjusted = replace(adjusted, model=moved)
    points = survey(model, {}, set())
    fitted, _ = fit_to_control(adjusted, points, ORIGIN, photographs, tmp_path, IngestOptions())
    assert worst_centre(model, fitted) < 1e-3


def worst_centre(model: SparseMap, adjusted: AdjustedModel) -> float:
    return float(np.linalg.norm(adjusted.model.centres - model.centres, axis=1).max())


def test_marks_show_a_point(tmp_path: Path) -> None:
    model = true_model(tmp_path)
    (point, *_) = survey(model, {}, set())
    assert len(point.marks) >= 3
    seen = triangulate_marks(model, point.marks)
    assert seen is not None
    np.testing.assert_allclose(seen[0], [-22, -25, 1], atol=1e-6)
    assert seen[1] < 1e-6
    name, xy = next(iter(point.marks.items()))
    assert triangulate_marks(model, {name: xy, "elsewhere.jpg": xy}) is None
    # A mark that is 30 px off in one of n photographs: most of it stays in that photograph.
    spoiled = triangulate_marks(model, point.marks | {name: xy + np.array([30.0, 0.0])})
    assert spoiled is not None
    assert 30 / len(point.marks) < spoiled[1] < 30


def test_exact_points_correct_the_model(tmp_path: Path) -> None:
    model, adjusted, points, text = fit(tmp_path, {}, set())
    assert {p.role for p in points.values()} == {"used"}
    assert worst_centre(model, adjusted) < 1e-3
    assert adjusted.georegistration.level == "control"
    for name in model.names:
        assert (
            np.abs(
                adjusted.model.images[name].cam_from_world - model.images[name].cam_from_world
            ).max()
            < 1e-3
        )
    assert text == ["6 ground control points used: horizontal 0.000 m rms, vertical 0.000 m rms"]
    assert len(adjusted.model.xyz) == len(model.xyz)
    assert [len(i.xy) for i in adjusted.model.images.values()] == [
        len(i.xy) for i in model.images.values()
    ]


def test_a_wrong_point_is_named_and_not_used(tmp_path: Path) -> None:
    planted = np.array([3.0, 0.0, -4.0])
    model, adjusted, points, text = fit(tmp_path, {"D": planted}, set())
    roles = {name: p.role for name, p in points.items()}
    assert roles == {**dict.fromkeys("ABCEF", "used"), "D": "wrong"}
    assert worst_centre(model, adjusted) < 1e-3
    np.testing.assert_allclose(points["D"].off, -planted, atol=1e-2)
    assert "wrong ground control point: D: 5.00 m off, not used" in text


def test_a_check_point_is_reported_and_not_used(tmp_path: Path) -> None:
    planted = np.array([0.0, 0.3, 0.4])
    model, adjusted, points, text = fit(tmp_path, {"E": planted}, {"E"})
    assert points["E"].role == "check"
    assert worst_centre(model, adjusted) < 1e-3
    np.testing.assert_allclose(points["E"].off, -planted, atol=1e-2)
    assert (
        "1 ground control points as check points: horizontal 0.300 m rms, vertical 0.400 m rms"
        in text
    )


def test_sigma_is_the_weight_of_a_point(tmp_path: Path) -> None:
    """A point that is 5 cm off bends the model where coordinates are said to be exact to
    millimetres. Where they are said to be exact to a metre, its marks stay where they are."""
    found = {}
    for sigma in (0.005, 1.0):
        folder = tmp_path / str(sigma)
        folder.mkdir()
        found[sigma] = fit(folder, {"F": np.array([0.0, 0.0, 0.05])}, set(), sigma)[2]["F"]
        assert found[sigma].role == "used"
    exact, rough = found.values()
    assert np.linalg.norm(exact.off) < 0.9 * np.linalg.norm(rough.off)
    assert rough.mark_px < 1e-3 < 5e-3 < exact.mark_px


@pytest.mark.parametrize("names", ["A", "AB"])
def test_few_points_shift_the_model(tmp_path: Path, names: str) -> None:
    checks = set("ABCDEF") - set(names)
    model, adjusted, points, _ = fit(tmp_path, {}, checks)
    off = np.array([points[name].off for name in names])
    np.testing.assert_allclose(off.mean(0), 0, atol=1e-6)
    assert adjusted.georegistration.level == "gps"
    assert 0.1 < worst_centre(model, adjusted) < 3


def made_flight() -> Flight:
    images = [
        FlightImage(f"line/{n}", f"{SESSION}/images/line/{n}", n, Exif(None, None), (4000, 3000))
        for n in ("DJI_1.JPG", "DJI_2.JPG")
    ]
    return Flight(tuple(images), {})


@pytest.mark.parametrize(
    "header", ["EPSG:32632", "WGS84 UTM 32N", "+proj=utm +zone=32 +datum=WGS84"]
)
def test_a_list_in_the_format_of_odm(tmp_path: Path, header: str) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(
        f"{header}\n# comment\n500000 5200000 431.5 100 200 DJI_1.JPG corner A\n"
        "500000 5200000 431.5 300.5 400 dji_2.jpg corner A\n\n"
        "500010\t5200000\t430\t1\t2\tDJI_1.JPG\n500010 5200000 430 5 6 elsewhere.jpg\n"
    )
    first, second = read_control_points(path, made_flight(), 1000, ["corner A"])
    assert (first.name, first.check, second.name, second.check) == (
        "corner A",
        True,
        "point 2",
        False,
    )
    to_degrees = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True)
    longitude, latitude = to_degrees.transform(500000, 5200000)
    np.testing.assert_allclose(first.geodetic, [latitude, longitude, 431.5], atol=1e-9)
    # A quarter of the size; the middle of the first pixel is (0, 0) there and (0.5, 0.5) here.
    one, two = (f"{SESSION}/images/line/DJI_{k}.JPG" for k in (1, 2))
    np.testing.assert_allclose(first.marks[one], [100.5 / 4, 200.5 / 4])
    np.testing.assert_allclose(first.marks[two], [301 / 4, 400.5 / 4])
    assert set(second.marks) == {one}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "gcp.txt:1: .*is not a coordinate reference system"),
        ("1 2 3 4 5 DJI_1.JPG a\n", "gcp.txt:1: .*is not a coordinate reference system"),
        ("EPSG:32632\n", "names none of the photographs: its first name is ''"),
        ("EPSG:32632\n1 2 3 4 DJI_1.JPG\n", "gcp.txt:2: expected x y z px py photograph"),
        (
            "EPSG:32632\n5e5 52e5 nan 4 5 DJI_1.JPG\n",
            "gcp.txt:2: x y z px py must be finite numbers",
        ),
        ("EPSG:32632\n5e5 52e5 0 4 5 D\x07.JPG\n", "gcp.txt:2: .* has a control character"),
        (
            "EPSG:32632\n5e5 52e5 3 4 5 DJI_9.JPG a\n",
            "its first name is 'DJI_9.JPG', the first of the folder",
        ),
        (
            "EPSG:32632\n5e5 52e5 3 4 5 DJI_1.JPG a\n5e5 53e5 3 4 5 DJI_2.JPG a\n",
            "gcp.txt:3: 'a' has other coordinates than in an earlier line",
        ),
        (
            "EPSG:32632\n5e5 52e5 3 4 5 DJI_1.JPG a\n5e5 52e5 3 9 9 DJI_1.JPG a\n",
            "gcp.txt:3: 'a' is marked twice in DJI_1.JPG",
        ),
        ("EPSG:4326\n8 97 3 4 5 DJI_1.JPG a\n", "are not on earth|is not a position in"),
        ("EPSG:32632\n5e5 52e5 3 4 5 DJI_1.JPG a\n", "has no point 'B' for --gcp-check; it has a"),
    ],
)
def test_lists_that_do_not_do(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gcp.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_control_points(path, made_flight(), 1000, ["B"])


def write_list(scene: Scene, path: Path, moved: Mapping[int, Array]) -> None:
    """A list of points of the ground of a rendered session, with exact marks where they are seen.

    A mark stands in every photograph whose depth at the pixel is that of the point.
    """
    frames = scene.frames(MAP_SESSION)
    with scene.layers(MAP_SESSION) as dense:
        depths = [dense.read("depth", k) for k in range(len(frames))]
    to_utm = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:32632", always_xy=True)
    lines, point = ["EPSG:32632"], 0
    for k in range(len(frames)):
        (fx, fy), (cx, cy) = frames.cameras[k].focal, frames.cameras[k].principal
        z = float(depths[k][160, 170])
        ray = np.array([(170.5 - cx) / fx, (160.5 - cy) / fy, 1.0])
        place = (np.linalg.inv(frames.cam_from_world[k]) @ [*(z * ray), 1.0])[:3]
        marks = []
        for j in range(len(frames)):
            x, y, depth, _ = frames.cam_from_world[j] @ [*place, 1.0]
            u, v = fx * x / depth + cx, fy * y / depth + cy
            inside = 4 < u < 316 and 4 < v < 316
            if inside and abs(depths[j][int(v), int(u)] - depth) < 0.05:
                marks.append(f"{u - 0.5:.4f} {v - 0.5:.4f} {Path(frames.names[j]).name}")
        if len(marks) < 3:
            continue
        told = geodetic_from_enu(place + moved.get(point, np.zeros(3)), scene.manifest.origin)
        east, north, up = to_utm.transform(told.longitude, told.latitude, told.altitude)
        lines += [f"{east:.4f} {north:.4f} {up:.4f} {mark} P{point}" for mark in marks]
        point += 1
    path.write_text("\n".join(lines) + "\n")
    assert point >= 7


def test_a_scene_of_photographs_and_points(rendered: Scene, tmp_path: Path) -> None:
    """Points bring a scene from the metres of its GPS to centimetres."""
    photographs, path = rendered.images_root / MAP_SESSION / "images", tmp_path / "gcp_list.txt"
    write_list(rendered, path, {2: np.array([4.0, 3.0, 0.0])})
    out = tmp_path / "scene"
    report = ingest(photographs, out, gcp=path, checks=["P4"])
    points = {point.name: point for point in report.control}
    assert points["P2"].role == "wrong"
    assert "wrong ground control point: P2: " in report.text()
    assert points["P4"].role == "check"
    assert points["P4"].off is not None
    assert np.linalg.norm(points["P4"].off) < 0.3
    used = [p for p in report.control if p.role == "used"]
    assert len(used) >= 5
    made, truth = Scene.open(out), rendered.frames(MAP_SESSION)
    place = {Path(n).name: k for k, n in enumerate(truth.names)}
    frames = made.frames("flight")
    rows = [place[Path(n).name] for n in frames.names]
    shift = enu_from_geodetic(made.manifest.origin, rendered.manifest.origin)
    off = np.linalg.inv(frames.cam_from_world)[:, :3, 3] + shift
    off -= np.linalg.inv(truth.cam_from_world[rows])[:, :3, 3]
    worst = np.linalg.norm(off, axis=1).max()
    print(f"{report.text()}\ncameras are {worst:.2f} m off at most")
    assert worst < 0.3
    assert report.gps is not None
    assert report.gps.horizontal_rms > 0.5


@pytest.mark.thorough
def test_points_only_check_given_poses(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "opensfm", tmp_path / "given", [MAP_SESSION])
    path = tmp_path / "gcp_list.txt"
    write_list(rendered, path, {})
    report = ingest(
        rendered.images_root / MAP_SESSION / "images",
        tmp_path / "scene",
        poses=tmp_path / "given" / "reconstruction.json",
        gcp=path,
    )
    assert {point.role for point in report.control} == {"check"}
    for point in report.control:
        assert point.off is not None
        assert point.mark_px is not None
        assert np.linalg.norm(point.off) < 0.02
        assert point.mark_px < 0.1


def test_check_points_need_a_list(rendered: Scene, tmp_path: Path) -> None:
    photographs = rendered.images_root / MAP_SESSION / "images"
    with pytest.raises(InputError, match="give --gcp"):
        ingest(photographs, tmp_path / "scene", checks=["A"])


def placed_flight(latitude: float, longitude: float) -> Flight:
    """The made flight with GPS positions in its photographs."""
    images = [
        replace(image, exif=replace(image.exif, position=Geodetic(latitude, longitude, 500.0)))
        for image in made_flight().images
    ]
    return Flight(tuple(images), {})


# A point in Minnesota, 160 m above the ellipsoid.
_PLACE = Geodetic(46.8427, -91.994, 160.0)
_US_FOOT = 1200 / 3937


def list_of_one(path: Path, header: str, system: str, unit: float, turned: bool = False) -> Path:
    """Write a list of one point, with heights in a unit of so many metres."""
    to = pyproj.Transformer.from_crs("EPSG:4326", system, always_xy=True)
    x, y = to.transform(_PLACE.longitude, _PLACE.latitude)
    x, y = (y, x) if turned else (x, y)
    path.write_text(f"{header}\n{x:.9f} {y:.9f} {_PLACE.altitude / unit:.6f} 1 2 DJI_1.JPG a\n")
    return path


@pytest.mark.parametrize(
    ("header", "system", "unit"),
    [
        ("EPSG:26849 +vunits=us-ft", "EPSG:26849", _US_FOOT),
        ("EPSG:26849 +vunits=m", "EPSG:26849", 1.0),
        ("+proj=utm +zone=15 +datum=WGS84 +units=us-ft +vunits=us-ft", "", _US_FOOT),
        ("+proj=utm +zone=15 +datum=WGS84 +units=ft +vunits=ft", "", 0.3048),
        ("EPSG:4326", "EPSG:4326", 1.0),
    ],
)
def test_a_list_in_feet(tmp_path: Path, header: str, system: str, unit: float) -> None:
    path = list_of_one(tmp_path / "gcp.txt", header, system or header, unit)
    (point,) = read_control_points(path, placed_flight(46.85, -91.99), 1000)
    np.testing.assert_allclose(point.geodetic[:2], _PLACE[:2], atol=3e-8)
    assert point.geodetic.altitude == pytest.approx(160.0, abs=1e-3)


@pytest.mark.parametrize(
    ("header", "system", "turned", "message"),
    [
        ("EPSG:26849", "EPSG:26849", False, "the unit of heights is unknown .*US survey foot"),
        ("EPSG:4326", "EPSG:4326", True, "are not on earth|is not a position|exchanged"),
        ("EPSG:32615", "EPSG:32615", True, "x and y are exchanged: give east|is not a position"),
        ("EPSG:32615", "EPSG:26849", False, "km from the photographs' GPS positions: check the"),
        ("EPSG:32614", "EPSG:32615", False, "km from the photographs' GPS positions: check the"),
    ],
)
def test_a_list_in_another_unit_order_or_system(
    tmp_path: Path, header: str, system: str, turned: bool, message: str
) -> None:
    path = list_of_one(tmp_path / "gcp.txt", header, system, 1.0, turned)
    with pytest.raises(InputError, match=message):
        read_control_points(path, placed_flight(46.85, -91.99), 1000)


def test_exchanged_coordinates_are_named(tmp_path: Path) -> None:
    """Latitude first, where longitudes are latitudes, too."""
    path = tmp_path / "gcp.txt"
    path.write_text("EPSG:4326\n47.0 8.0 400 1 2 DJI_1.JPG a\n")
    with pytest.raises(InputError, match="x and y are exchanged: give east or longitude first"):
        read_control_points(path, placed_flight(47.0, 8.0), 1000)


@pytest.mark.parametrize(
    ("level", "across", "up", "remark"),
    [
        ("control", 3.0, 364.0, "GPS contradicts ground control points by 364 m in height"),
        ("given", 250.0, 2.0, "GPS contradicts the imported poses by 250 m horizontally"),
        (
            "control",
            90.0,
            48.0,
            "by 90 m horizontally and 48 m in height: check the coordinate system, the unit",
        ),
        ("control", 5.0, 9.0, None),
        ("gps", 5.0, 99.0, None),
    ],
)
def test_gps_that_contradicts_gets_a_remark(
    level: str, across: float, up: float, remark: str | None
) -> None:
    gps = Residuals(
        horizontal_median=across, horizontal_rms=across, vertical_median=up, vertical_rms=up
    )
    said = "".join(gps_remark(level, gps))
    assert (remark in said) if remark else not said
