"""Exports to photogrammetry, hloc, COLMAP's database and rerun, read back by formulas or libraries.

A surface point of a frame, projected with the numbers of the file alone and the formulas of the
program's documentation, falls on the pixel that it came from.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pycolmap
import pyproj
import pytest
import rerun
from numpy.typing import NDArray

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.imports.formats import read_foreign
from objconnect.scene.maps.features import read_features
from tests.objconnect.scene.exports.test_exports import EXACT, all_frames, with_cameras

Array = NDArray[np.float64]

SESSION = "summer-noon-nadir-map"
LENS = Camera("OPENCV", 320, 320, (300.0, 303.0, 150.0, 165.0, -0.1, 0.02, 1e-3, -2e-3))
FISHEYE = Camera("OPENCV_FISHEYE", 320, 320, (200.0, 202.0, 150.0, 165.0, 0.05, -0.01, 0.0, 0.0))


def surface_point(scene: Scene, session: str = SESSION) -> tuple[Array, Array]:
    """A point of the first frame's depth map in the world, and its (x, y) = (X/Z, Y/Z)."""
    frames = scene.frames(session)
    with scene.layers(session) as dense:
        depth = dense.read("depth", 0)
    row, column = np.argwhere(depth > 0)[-40]
    (fx, fy), (cx, cy) = frames.cameras[0].focal, frames.cameras[0].principal
    ray = np.array([(column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy])
    local = float(depth[row, column]) * np.array([*ray, 1.0])
    return (np.linalg.inv(frames.cam_from_world[0]) @ [*local, 1.0])[:3], ray


def bent(camera: Camera, ray: Array) -> Array:
    """The pixel of a ray under COLMAP's formulas of OPENCV and OPENCV_FISHEYE."""
    (fx, fy), (cx, cy), (k1, k2, c, d) = camera.focal, camera.principal, camera.distortion
    x, y = ray
    r = np.hypot(x, y)
    if camera.is_fisheye:
        angle = np.arctan(r)
        stretch = angle / r * (1 + k1 * angle**2 + k2 * angle**4)
        u, v = x * stretch, y * stretch
    else:
        u = x * (1 + k1 * r**2 + k2 * r**4) + 2 * c * x * y + d * (r**2 + 2 * x**2)
        v = y * (1 + k1 * r**2 + k2 * r**4) + 2 * d * x * y + c * (r**2 + 2 * y**2)
    return np.array([fx * u + cx, fy * v + cy])


def rotation(vector: Array) -> Array:
    """Rodrigues."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


@pytest.mark.parametrize("camera", [LENS, FISHEYE])
def test_opensfm_projects_a_known_point(
    rendered: Scene, rendered_copy: Path, tmp_path: Path, camera: Camera
) -> None:
    point, ray = surface_point(rendered)
    with_cameras(rendered_copy, SESSION, [camera])
    export(rendered_copy, "opensfm", tmp_path / "out", [SESSION])
    (document,) = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    shot = document["shots"]["000000.jpg"]
    lens = document["cameras"][shot["camera"]]
    x, y, z = rotation(np.array(shot["rotation"])) @ point + shot["translation"]
    np.testing.assert_allclose([x / z, y / z], ray, atol=1e-9)
    r = np.hypot(x, y) / z
    if camera.is_fisheye:
        assert lens["projection_type"] == "fisheye_opencv"
        angle = np.arctan2(r, 1)
        stretch = angle / r * (1 + lens["k1"] * angle**2 + lens["k2"] * angle**4)
        u, v = x / z * stretch, y / z * stretch
    else:
        assert lens["projection_type"] == "brown"
        a, b = x / z, y / z
        radial = 1 + lens["k1"] * r**2 + lens["k2"] * r**4 + lens["k3"] * r**6
        u = a * radial + 2 * lens["p1"] * a * b + lens["p2"] * (r**2 + 2 * a**2)
        v = b * radial + 2 * lens["p2"] * a * b + lens["p1"] * (r**2 + 2 * b**2)
    # Normalized coordinates: pixels with the first one's centre at 0, plus a half, from the middle.
    normalized = np.array([lens["focal_x"] * u + lens["c_x"], lens["focal_y"] * v + lens["c_y"]])
    size = max(lens["width"], lens["height"])
    pixel_of_opencv = normalized * size - 0.5 + np.array([lens["width"], lens["height"]]) / 2
    np.testing.assert_allclose(pixel_of_opencv + 0.5, bent(camera, ray), atol=1e-6)


def test_opensfm_places_cameras_on_earth(rendered: Scene, tmp_path: Path) -> None:
    """geo.txt leads back to the poses through PROJ's own topocentric conversion."""
    export(rendered.path, "opensfm", tmp_path / "out", [SESSION])
    header, *lines = (tmp_path / "out" / "geo.txt").read_text().splitlines()
    assert header == "EPSG:4326"
    (document,) = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    reference = document["reference_lla"]
    assert tuple(reference.values()) == tuple(rendered.manifest.origin)
    topocentric = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={reference['latitude']} +lon_0={reference['longitude']} "
        f"+h_0={reference['altitude']}"
    )
    frames = rendered.frames(SESSION)
    assert len(lines) == len(frames)
    for line, matrix in zip(lines, frames.cam_from_world, strict=True):
        longitude, latitude, height = map(float, line.split()[1:])
        place = topocentric.transform(longitude, latitude, height)
        np.testing.assert_allclose(place, np.linalg.inv(matrix)[:3, 3], atol=1e-3)
    assert len(document["points"]) == len(rendered.sparse_map().xyz)


@pytest.mark.parametrize("camera", [LENS, FISHEYE])
def test_metashape_projects_a_known_point(
    rendered: Scene, rendered_copy: Path, tmp_path: Path, camera: Camera
) -> None:
    """From geocentric metres through component and camera to pixels, as the manual says."""
    point, ray = surface_point(rendered)
    with_cameras(rendered_copy, SESSION, [camera])
    export(rendered_copy, "metashape", tmp_path / "out", [SESSION])
    chunk = ET.parse(tmp_path / "out" / "cameras.xml").getroot().find("chunk")
    assert chunk is not None

    def numbers(path: str) -> Array:
        return np.array([float(word) for word in (chunk.findtext(path) or "").split()])

    component = "components/component/transform/"
    turn = numbers(component + "rotation").reshape(3, 3)
    origin = rendered.manifest.origin
    to_earth = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    centre = np.array(to_earth.transform(origin.longitude, origin.latitude, origin.altitude))
    # A metre up is a metre away from the middle of the earth, but for its flattening.
    above = to_earth.transform(origin.longitude, origin.latitude, origin.altitude + 1)
    np.testing.assert_allclose(turn @ [0, 0, 1], np.array(above) - centre, atol=1e-8)
    east = to_earth.transform(origin.longitude + 1e-5, origin.latitude, origin.altitude) - centre
    np.testing.assert_allclose(turn @ [1, 0, 0], east / np.linalg.norm(east), atol=1e-6)
    np.testing.assert_allclose(numbers(component + "translation"), centre, atol=1e-6)
    assert chunk.find("cameras/camera").get("label") == "000000"  # type: ignore[union-attr]
    chunk_from_cam = numbers("cameras/camera/transform").reshape(4, 4)
    x, y, z, _ = np.linalg.inv(chunk_from_cam) @ [*point, 1]
    np.testing.assert_allclose([x / z, y / z], ray, atol=1e-9)
    value = {
        name: float(chunk.findtext(f"sensors/sensor/calibration/{name}", "0"))
        for name in ("f", "cx", "cy", "b1", "k1", "k2", "k3", "k4", "p1", "p2")
    }
    a, b = x / z, y / z
    if camera.is_fisheye:
        scale = np.arctan(np.hypot(a, b)) / np.hypot(a, b)
        a, b = a * scale, b * scale
    r2 = a * a + b * b
    radial = 1 + value["k1"] * r2 + value["k2"] * r2**2 + value["k3"] * r2**3
    u = a * radial + value["p1"] * (r2 + 2 * a * a) + 2 * value["p2"] * a * b
    v = b * radial + value["p2"] * (r2 + 2 * b * b) + 2 * value["p1"] * a * b
    found = [
        160 + value["cx"] + u * value["f"] + u * value["b1"],
        160 + value["cy"] + v * value["f"],
    ]
    np.testing.assert_allclose(found, bent(camera, ray), atol=1e-6)


@pytest.mark.parametrize(
    ("file_format", "file"),
    [("opensfm", "reconstruction.json"), ("metashape", "cameras.xml"), ("nerfstudio", "")],
)
def test_exports_are_read_again(
    rendered: Scene, tmp_path: Path, file_format: str, file: str
) -> None:
    export(rendered.path, file_format, tmp_path / "out", [SESSION])
    back, frames = read_foreign(tmp_path / "out" / file), rendered.frames(SESSION)
    assert len(back) == len(frames)
    for row, camera in enumerate(back.cameras):
        assert camera is not None
        np.testing.assert_allclose(camera.focal, frames.cameras[row].focal, rtol=1e-12)
        np.testing.assert_allclose(camera.principal, frames.cameras[row].principal, rtol=1e-12)
    if file_format == "metashape":  # its origin is the middle of the cameras
        centres = np.linalg.inv(frames.cam_from_world)[:, :3, 3]
        apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
        found = np.linalg.norm(back.positions[:, None] - back.positions, axis=-1)
        np.testing.assert_allclose(found, apart, atol=1e-6)
    else:
        np.testing.assert_allclose(back.cam_from_world, frames.cam_from_world, atol=1e-8)
    assert (back.origin is None) == (file_format == "nerfstudio")


FORMATS = ("opensfm", "metashape", "nerfstudio")
BROWN = Camera(
    "FULL_OPENCV",
    320,
    320,
    (300.0, 303.0, 150.0, 165.0, -0.1, 0.02, 1e-3, -2e-3, 0.01, 0.0, 0.0, 0.0),
)


@pytest.mark.parametrize("file_format", FORMATS)
def test_three_radial_coefficients_are_read_again(
    rendered_copy: Path, tmp_path: Path, file_format: str
) -> None:
    with_cameras(rendered_copy, SESSION, [BROWN])
    export(rendered_copy, file_format, tmp_path / "out", [SESSION])
    files = {"opensfm": "reconstruction.json", "metashape": "cameras.xml", "nerfstudio": ""}
    (camera,) = set(read_foreign(tmp_path / "out" / files[file_format]).cameras)
    assert camera is not None and camera.model == "FULL_OPENCV"
    np.testing.assert_allclose(camera.params, BROWN.params, rtol=1e-12)


@pytest.mark.parametrize("file_format", FORMATS)
def test_a_denominator_is_refused_by_formats_that_have_none(
    rendered_copy: Path, tmp_path: Path, file_format: str
) -> None:
    rational = Camera("FULL_OPENCV", 320, 320, (*BROWN.params[:9], 0.2, 0.0, 0.01))
    with_cameras(rendered_copy, SESSION, [rational])
    with pytest.raises(InputError, match="cannot hold k4, k6 of a camera of the model FULL_OPENCV"):
        export(rendered_copy, file_format, tmp_path / "out", [SESSION])
    assert not (tmp_path / "out").exists()


def test_colmap_holds_every_coefficient(rendered_copy: Path, tmp_path: Path) -> None:
    rational = Camera("FULL_OPENCV", 320, 320, (*BROWN.params[:9], 0.2, 0.0, 0.01))
    with_cameras(rendered_copy, SESSION, [rational])
    export(rendered_copy, "colmap", tmp_path / "out", [SESSION])
    (camera,) = pycolmap.Reconstruction(tmp_path / "out").cameras.values()
    assert camera.model.name == "FULL_OPENCV"
    assert tuple(camera.params) == rational.params


@pytest.mark.parametrize("file_format", ["opensfm", "metashape"])
def test_photographs_of_one_name_are_refused(
    rendered: Scene, tmp_path: Path, file_format: str
) -> None:
    with pytest.raises(InputError, match="have the same file name"):
        export(rendered.path, file_format, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_nerfstudio_has_depth(rendered: Scene, tmp_path: Path) -> None:
    """The depth of a photograph, times nerfstudio's default of 0.001, is the scene's in metres."""
    export(rendered.path, "nerfstudio-depth", tmp_path / "out")
    document = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert len(document["frames"]) == 19
    frame = next(
        f for f in document["frames"] if f["file_path"].endswith(f"{SESSION}/images/000003.jpg")
    )
    depth = np.load(tmp_path / "out" / frame["depth_file_path"]) * 0.001
    with rendered.layers(SESSION) as dense:
        np.testing.assert_allclose(depth, dense.read("depth", 3), rtol=1e-6)
    assert depth.max() > 10


def test_hloc_features_and_matches_are_the_maps(rendered: Scene, tmp_path: Path) -> None:
    """Matches, read as hloc reads them, join keypoints whose rays meet in a point of the map."""
    export(rendered.path, "hloc-features", tmp_path / "out")
    sparse_map = rendered.sparse_map()
    own = read_features(rendered.map_path / "features.h5")
    with h5py.File(tmp_path / "out/features.h5") as features:
        for name in sparse_map.names:
            group = features[name]
            # hloc adds the half pixel when it writes COLMAP's database.
            np.testing.assert_allclose(group["keypoints"][()] + 0.5, own[name].xy, atol=1e-4)
            assert group["descriptors"].shape == (128, len(own[name].xy))
            np.testing.assert_allclose(
                np.linalg.norm(group["descriptors"][()], axis=0), 1, atol=1e-5
            )
            assert group["image_size"][()].tolist() == [320, 320]
    pairs = [line.split() for line in (tmp_path / "out/pairs.txt").read_text().splitlines()]
    assert len(pairs) > 12
    with h5py.File(tmp_path / "out/matches.h5") as matches:
        for a, b in pairs:
            to = matches[a.replace("/", "-")][b.replace("/", "-")]["matches0"][()]
            assert len(to) == len(own[a].xy)
            rows_a = sparse_map.images[a].point_rows[: len(to)][to >= 0]
            rows_b = sparse_map.images[b].point_rows[to[to >= 0]]
            np.testing.assert_array_equal(rows_a, rows_b)
            assert len(rows_a) >= 15
            assert (rows_a >= 0).all()


def test_colmap_triangulates_its_database(rendered: Scene, tmp_path: Path) -> None:
    """COLMAP builds the map again from the database and the poses of the model beside it."""
    export(rendered.path, "colmap-database", tmp_path / "out")
    model = pycolmap.Reconstruction(tmp_path / "out")
    poses = all_frames(rendered)
    with pycolmap.Database.open(tmp_path / "out/database.db") as db:
        images = db.read_all_images()
        assert {image.name for image in images} == set(poses)
        for image in images:
            assert model.image(image.image_id).name == image.name
            assert model.image(image.image_id).camera_id == image.camera_id
        first = next(image for image in images if image.name == rendered.splits.map[0])
        own = read_features(rendered.map_path / "features.h5")[first.name]
        np.testing.assert_array_equal(db.read_keypoints(first.image_id)[:, :2], own.xy)
        np.testing.assert_array_equal(db.read_descriptors(first.image_id).data, own.descriptors)
        ids, geometries = db.read_two_view_geometries()
        assert len(ids) > 12
        for geometry in geometries:
            np.testing.assert_allclose(np.linalg.norm(geometry.E), np.sqrt(2), atol=1e-6)
    found = pycolmap.triangulate_points(
        model, tmp_path / "out/database.db", rendered.images_root, tmp_path / "out"
    )
    expected = len(rendered.sparse_map().xyz)
    assert 0.9 * expected < found.num_points3D() < 1.1 * expected


def columns(path: Path, entity: str, index: str = "frame") -> dict[str, Any]:
    """The columns of an entity, by the name of the component, as lists of rows."""
    recording = rerun.dataframe.load_recording(path)
    table = recording.view(index=index, contents=entity).select().read_all()
    return {
        name.rpartition(":")[2]: table.column(name).to_pylist()
        for name in table.column_names
        if name == index or ":" in name
    }


def test_rerun_plays_the_flight(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "rerun", tmp_path / "out", [SESSION])
    path, frames = tmp_path / "out" / "scene.rrd", rendered.frames(SESSION)
    table = columns(path, f"/world/{SESSION}/camera")
    assert table["frame"] == list(range(len(frames)))
    for row, (cam_from_world, camera) in enumerate(
        zip(frames.cam_from_world, frames.cameras, strict=True)
    ):
        world_from_cam = np.linalg.inv(cam_from_world)
        centre = table["Translation3D"][row][0]
        np.testing.assert_allclose(centre, world_from_cam[:3, 3], atol=1e-4)
        # Stored by columns, in single precision.
        turn = np.array(table["TransformMat3x3"][row][0]).reshape(3, 3).T
        np.testing.assert_allclose(turn, world_from_cam[:3, :3], atol=1e-6)
        pinhole = np.array(table["PinholeProjection"][row][0]).reshape(3, 3).T
        np.testing.assert_allclose(pinhole, camera.calibration, atol=1e-3)
    assert "Blob" not in table


def test_rerun_holds_photographs(rendered: Scene, tmp_path: Path) -> None:
    session = "winter-dusk-oblique-query"
    export(rendered.path, "rerun-images", tmp_path / "out", [session])
    table = columns(tmp_path / "out" / "scene.rrd", f"/world/{session}/camera")
    photograph = (rendered.images_root / rendered.frames(session).names[1]).read_bytes()
    assert bytes(table["Blob"][1][0]) == photograph


@pytest.mark.parametrize("file_format", ["hloc-features", "colmap-database"])
def test_a_scene_without_a_map_has_no_features(
    rendered_copy: Path, tmp_path: Path, file_format: str
) -> None:
    (rendered_copy / "map").rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="has no map yet"):
        export(rendered_copy, file_format, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_exports_hold_exact_poses(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "opensfm", tmp_path / "out", [SESSION])
    back = read_foreign(tmp_path / "out" / "reconstruction.json")
    assert np.abs(back.cam_from_world - rendered.frames(SESSION).cam_from_world).max() < EXACT
