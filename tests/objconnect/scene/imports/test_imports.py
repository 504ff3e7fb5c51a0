"""Readers of poses of other programs, against points projected by hand with each one's formulas."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pycolmap import Camera as ColmapCamera

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import (
    Geodetic,
    ecef_from_geodetic,
    enu_axes,
    enu_from_geodetic,
)
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.imports.formats import read_foreign
from objconnect.scene.imports.lens import BrownLens
from objconnect.scene.imports.names import match_files
from objconnect.scene.imports.poses import ForeignPoses

# East of north by 30 degrees, looking down and ahead: no axis of camera and world is parallel.
YAW = np.radians(30.0)
RIGHT = np.array([np.cos(YAW), -np.sin(YAW), 0.0])
FORWARD = np.array([0.6 * np.sin(YAW), 0.6 * np.cos(YAW), -0.8])
DOWN = np.cross(FORWARD, RIGHT)
CENTRE = np.array([12.0, -7.0, 80.0])
# 3 m to the right of the axis, 2 m below it, 50 m ahead.
POINT = CENTRE + 3 * RIGHT + 2 * DOWN + 50 * FORWARD


def pixel(poses: ForeignPoses, row: int, point: np.ndarray) -> np.ndarray:
    """Where a world point falls, by this project's conventions."""
    camera = poses.cameras[row]
    assert camera is not None
    pose = Pose.from_matrix(poses.cam_from_world[row])
    return camera.project(pose.transform(torch.from_numpy(point)[None])).xy[0].numpy()


def rotation_vector(rotation: np.ndarray) -> list[float]:
    """The axis times the angle, from the trace and the skew part."""
    angle = np.arccos((np.trace(rotation) - 1) / 2)
    skew = rotation - rotation.T
    axis = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (2 * np.sin(angle))
    return (angle * axis).tolist()


def opensfm(folder: Path, **lens: object) -> Path:
    rows = np.stack([RIGHT, DOWN, FORWARD])
    shot = {
        "rotation": rotation_vector(rows),
        "translation": (-rows @ CENTRE).tolist(),
        "camera": "v2 dji",
        "capture_time": 0.0,
    }
    camera = {"projection_type": "brown", "width": 4000, "height": 3000, **lens}
    document = [
        {"cameras": {}, "shots": {}, "points": {}},
        {
            "cameras": {"v2 dji": camera},
            "shots": {"DJI_1.JPG": shot},
            "points": {"1": {"coordinates": [0, 0, 0], "color": [1, 2, 3]}},
            "reference_lla": {"latitude": 47.0, "longitude": 8.0, "altitude": 400.0},
            "frame": "topocentric",
        },
    ]
    path = folder / "reconstruction.json"
    path.write_text(json.dumps(document))
    return path


def test_opensfm_of_a_point(tmp_path: Path) -> None:
    """Its documentation: pixels = middle + 4000 (c + f (x (1 + k1 r2 + k2 r4) + tangential))."""
    lens = {"focal_x": 0.8, "focal_y": 0.81, "c_x": 0.01, "c_y": -0.02}
    bent = {"k1": -0.1, "k2": 0.02, "p1": 1e-3, "p2": -2e-3, "k3": 0.0}
    poses = read_foreign(opensfm(tmp_path, **lens, **bent))
    assert poses.names == ("DJI_1.JPG",)
    assert poses.origin == Geodetic(47.0, 8.0, 400.0)
    np.testing.assert_allclose(poses.positions, [CENTRE], atol=1e-9)
    x, y = 3 / 50, 2 / 50
    r2 = x * x + y * y
    radial = 1 - 0.1 * r2 + 0.02 * r2 * r2
    u = x * radial + 2 * 1e-3 * x * y - 2e-3 * (r2 + 2 * x * x)
    v = y * radial + 1e-3 * (r2 + 2 * y * y) - 2 * 2e-3 * x * y
    expected = [2000 + 4000 * (0.01 + 0.8 * u), 1500 + 4000 * (-0.02 + 0.81 * v)]
    np.testing.assert_allclose(pixel(poses, 0, POINT), expected, atol=1e-8)


def test_opensfm_of_a_fisheye(tmp_path: Path) -> None:
    lens = {"projection_type": "fisheye", "focal": 0.5, "k1": -0.03, "k2": 0.004}
    poses = read_foreign(opensfm(tmp_path, **lens))
    angle = np.arctan(np.hypot(3, 2) / 50)
    reach = angle * (1 - 0.03 * angle**2 + 0.004 * angle**4) / np.hypot(3, 2)
    expected = [2000 + 2000 * reach * 3, 1500 + 2000 * reach * 2]
    np.testing.assert_allclose(pixel(poses, 0, POINT), expected, atol=1e-8)


METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
<sensors next_id="1"><sensor id="0" label="FC6310" type="frame">
<resolution width="5472" height="3648"/>
<calibration type="frame" class="initial"><f>1</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="5472" height="3648"/>
<f>3600</f><cx>12.5</cx><cy>-8</cy><b1>4</b1>{bent}<p1>0.002</p1><p2>-0.001</p2></calibration>
</sensor></sensors>
<components next_id="1" active_id="0"><component id="0">{transform}</component></components>
<cameras><group id="0">
<camera id="0" sensor_id="0" component_id="0" label="DJI_1"><transform>{matrix}</transform></camera>
</group><camera id="1" sensor_id="0" label="DJI_2"/>
<camera id="2" sensor_id="0" component_id="0" label="DJI_3" enabled="false">
<transform>1 2</transform></camera></cameras>
<reference>GEOGCS["WGS 84"]</reference></chunk></document>
"""


def metashape(folder: Path, bent: str = "<k1>-0.1</k1><k2>0.02</k2>", local: bool = False) -> Path:
    """One camera in a chunk whose frame is turned, scaled by 1/20 and far from the world's."""
    spin = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    axes = enu_axes(ORIGIN) if not local else np.eye(3)
    middle = ecef_from_geodetic(ORIGIN) if not local else np.zeros(3)
    scale, shift = 20.0, middle + np.array([5.0, 6.0, 7.0])
    world_axes = axes.T @ np.stack([RIGHT, DOWN, FORWARD], -1)
    centre = middle + axes.T @ CENTRE
    matrix = np.eye(4)
    matrix[:3, :3] = spin.T @ world_axes
    matrix[:3, 3] = spin.T @ (centre - shift) / scale
    words = [" ".join(map(repr, part.ravel().tolist())) for part in (spin, shift, matrix)]
    transform = (
        f"<transform><rotation locked='false'>{words[0]}</rotation>"
        f"<translation>{words[1]}</translation><scale>{scale}</scale></transform>"
    )
    path = folder / "cameras.xml"
    path.write_text(METASHAPE.format(bent=bent, transform=transform, matrix=words[2]))
    return path


ORIGIN = Geodetic(47.0, 8.0, 400.0)


def metashape_pixel(k: tuple[float, ...] = (-0.1, 0.02)) -> list[float]:
    """Its manual: u = w/2 + cx + x' f + x' B1, x' = x (1 + K1 r2 ..) + P1 (r2 + 2 x2) + 2 P2 x y.

    The lines of y have y for x and P2 for P1.
    """
    x, y = 3 / 50, 2 / 50
    r2 = x * x + y * y
    radial = 1 + sum(value * r2 ** (power + 1) for power, value in enumerate(k))
    u = x * radial + 0.002 * (r2 + 2 * x * x) - 2 * 0.001 * x * y
    v = y * radial - 0.001 * (r2 + 2 * y * y) + 2 * 0.002 * x * y
    return [2736 + 12.5 + u * 3600 + u * 4, 1824 - 8 + v * 3600]


def test_metashape_of_a_point(tmp_path: Path) -> None:
    poses = read_foreign(metashape(tmp_path))
    assert poses.names == ("DJI_1",)
    # One photograph: the origin is its centre, with its own vertical 80 m above the map's.
    assert poses.origin is not None
    np.testing.assert_allclose(poses.positions, [[0, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(enu_from_geodetic(poses.origin, ORIGIN), CENTRE, atol=1e-4)
    turned = enu_axes(poses.origin) @ enu_axes(ORIGIN).T
    np.testing.assert_allclose(
        pixel(poses, 0, turned @ (POINT - CENTRE)), metashape_pixel(), atol=1e-4
    )


def test_metashape_of_a_local_system(tmp_path: Path) -> None:
    poses = read_foreign(metashape(tmp_path, local=True))
    assert poses.origin is None
    np.testing.assert_allclose(poses.positions, [CENTRE], atol=1e-9)
    np.testing.assert_allclose(pixel(poses, 0, POINT), metashape_pixel(), atol=1e-6)


def test_metashape_of_a_lens_with_more_coefficients(tmp_path: Path) -> None:
    """Three are FULL_OPENCV's; of four, the nearest camera is near everywhere."""
    bent = "<k1>-0.1</k1><k2>0.02</k2><k3>-0.006</k3>"
    poses = read_foreign(metashape(tmp_path, bent, local=True))
    expected = metashape_pixel((-0.1, 0.02, -0.006))
    np.testing.assert_allclose(pixel(poses, 0, POINT), expected, atol=1e-6)
    poses = read_foreign(metashape(tmp_path, f"{bent}<k4>1e-3</k4>", local=True))
    np.testing.assert_allclose(pixel(poses, 0, POINT), expected, atol=0.3)
    steep = "<k1>-0.1</k1><k2>0.02</k2><k3>-0.6</k3><k4>9</k4><b2>30</b2>"
    with pytest.raises(InputError, match="px from the nearest FULL_OPENCV camera"):
        read_foreign(metashape(tmp_path, steep, local=True))


def test_a_brown_lens_is_colmaps(tmp_path: Path) -> None:
    params = (900.0, 905.0, 510.0, 380.0, -0.2, 0.05, 1e-3, -2e-3)
    lens = BrownLens((1000, 750), params[:2], params[2:4], (-0.2, 0.05, 0.01, 0.0), params[6:])
    fitted = lens.camera()
    full = ColmapCamera(
        model="FULL_OPENCV", width=1000, height=750, params=[*params, 0.01, 0.0, 0.0, 0.0]
    )
    for x, y in ((0.0, 0.0), (0.5, -0.35), (-0.55, 0.4), (0.2, 0.1)):
        expected = full.img_from_cam(np.array([[x, y, 1.0]]))[0]
        found = fitted.project(torch.tensor([[x, y, 1.0]], dtype=torch.float64)).xy[0].numpy()
        np.testing.assert_allclose(found, expected, atol=1e-9)


def nerfstudio(folder: Path) -> Path:
    applied = np.array([[0.0, 1.0, 0.0, 2.0], [0.0, 0.0, 1.0, -3.0], [1.0, 0.0, 0.0, 4.0]])
    world_from_gl = np.eye(4)
    world_from_gl[:3, :3] = np.stack([RIGHT, -DOWN, -FORWARD], -1)
    world_from_gl[:3, 3] = CENTRE
    matrix = np.vstack([applied, [0, 0, 0, 1]]) @ world_from_gl
    document = {
        "camera_model": "OPENCV",
        "w": 640,
        "h": 480,
        "fl_x": 500.0,
        "applied_transform": applied.tolist(),
        "frames": [
            {"file_path": "images/a.jpg", "transform_matrix": matrix.tolist(), "cx": 330.0},
            {
                "file_path": "images/b.jpg",
                "transform_matrix": matrix.tolist(),
                "fl_y": 510.0,
                "k1": 0.1,
                "camera_model": "OPENCV_FISHEYE",
            },
        ],
    }
    path = folder / "transforms.json"
    path.write_text(json.dumps(document))
    return path


def test_nerfstudio_of_a_point(tmp_path: Path) -> None:
    poses = read_foreign(nerfstudio(tmp_path))
    assert poses.names == ("images/a.jpg", "images/b.jpg")
    assert poses.origin is None
    np.testing.assert_allclose(pixel(poses, 0, POINT), [330 + 500 * 0.06, 240 + 500 * 0.04])
    assert poses.cameras[1] == Camera(
        "OPENCV_FISHEYE", 640, 480, (500.0, 510.0, 320.0, 240.0, 0.1, 0.0, 0.0, 0.0)
    )
    assert len(read_foreign(tmp_path)) == 2


def test_tum_of_a_pose(tmp_path: Path) -> None:
    """Half a turn about the east axis: the camera looks down."""
    (tmp_path / "t.txt").write_text("# comment\n1.5 1 2 3 1 0 0 0\n")
    poses = read_foreign(tmp_path / "t.txt")
    assert poses.names == ("1.5",)
    assert poses.cameras == (None,)
    np.testing.assert_allclose(poses.positions, [[1, 2, 3]])
    np.testing.assert_allclose(poses.cam_from_world[0, :3, :3], np.diag([1, -1, -1]), atol=1e-12)
    np.testing.assert_allclose(poses.cam_from_world[0, :3, 3], [-1, 2, 3], atol=1e-12)


def test_tables_of_positions(tmp_path: Path) -> None:
    file = tmp_path / "p.csv"
    file.write_text("name,lat,lon,alt\na.jpg,47,8,400\nb.jpg,47.001,8,450\nc.jpg,47,8,400\n")
    poses = read_foreign(file)
    assert poses.origin == Geodetic(47.0, 8.0, 400.0)
    assert not poses.has_attitude
    # A minute of latitude at 47 degrees is 1852.9 m long.
    np.testing.assert_allclose(poses.positions[1, :2], [0, 111.18], atol=0.01)
    file.write_text("name,e,n,u,more\na.jpg,1,2,3,x\n")
    assert read_foreign(file).origin is None
    np.testing.assert_array_equal(read_foreign(file).positions, [[1, 2, 3]])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", "[]", "holds no reconstruction"),
        ("a.json", '[{"cameras": {}, "shots": {}}]', "no photograph with a pose"),
        (
            "a.json",
            '[{"cameras":{},"shots":{"a":{"rotation":[0,0,0],"translation":[0,0,0],"camera":"x"}}}]',
            "camera 'x', which the file lacks",
        ),
        ("a.json", "[1", "not valid JSON"),
        ("a.json", '{"frames": []}', "no photograph with a pose"),
        (
            "a.json",
            '{"frames": [{"file_path": "a", "transform_matrix": '
            "[[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}",
            "is scaled, sheared or mirrored",
        ),
        ("a.xml", "<document/>", "has no chunk"),
        ("a.xml", "<document>", "not valid XML"),
        ("a.xml", '<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>', "document type"),
        (
            "a.xml",
            "<d><chunk><camera label='a'><transform>1 2</transform></camera></chunk></d>",
            "must be 16 finite numbers",
        ),
        ("a.txt", "1 2 3\n", "expected the numbers timestamp"),
        ("a.txt", "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "'1' is listed twice"),
        ("a.csv", "name,lat\na,1\n", "expected the columns"),
        ("a.csv", "name,e,n,u\na,nan,1,1\n", "not finite"),
        ("a.csv", "name,lat,lon,alt\na,91,1,1\n", "is not a place on earth"),
        ("a.pdf", "x", "is not a file of poses: it is neither a folder of a COLMAP model, nor"),
    ],
)
def test_faults_are_named(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_foreign(tmp_path / name)


def test_names_mean_photographs() -> None:
    where = Path("poses.xml")
    files = ["a/1.JPG", "b/1.JPG", "c.jpg"]
    assert match_files(files, ["b/1.JPG", "1.jpg", "images/C"], where) == {
        "a/1.JPG": "1.jpg",
        "b/1.JPG": "b/1.JPG",
        "c.jpg": "images/C",
    }
    with pytest.raises(InputError, match=r"'1.JPG' may be 'a/1.JPG' or 'b/1.JPG'"):
        match_files(files, ["1.JPG"], where)
    assert match_files(["x.jpg"], ["y.jpg"], where) == {}


def test_a_name_without_a_folder_means_one_photograph() -> None:
    """It is not taken for the one in the root where another folder has one of that name."""
    with pytest.raises(InputError, match=r"'a\.jpg' may be 'a\.jpg' or 'b/a\.jpg': give names"):
        match_files(["a.jpg", "b/a.jpg"], ["a.jpg"], Path("poses.csv"))
    both = match_files(["a.jpg", "b/a.jpg"], ["a.jpg", "b/a.jpg"], Path("poses.csv"))
    assert both == {"a.jpg": "a.jpg", "b/a.jpg": "b/a.jpg"}
