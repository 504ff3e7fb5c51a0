"""Frames and lenses of other programs that a file states twice, in parts or not at all."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.geodesy import Geodetic
from scene.imports.formats import read_foreign
from scene.imports.poses import Frame
from scene.quantities.flags import parse_flag
from scene.quantities.horizontal_axes import axes_of, convergence, utm_zone
from tests.scene.imports.made_models import (
    Truth,
    made_truth,
    move_of_odm,
    plain_project,
    projected,
    write_metashape,
)
from tests.scene.imports.test_imports import metashape, nerfstudio

LENS = {"projection_type": "brown", "width": 1200, "height": 900, "focal_x": 0.75, "focal_y": 0.75}


def shots_of(truth: Truth, matrices: Any, gps: bool) -> str:
    from tests.scene.imports.made_models import _shots

    measured = truth.world_from_cam[:, :3, 3] if gps else None
    reference = dict(zip(("latitude", "longitude", "altitude"), truth.origin, strict=True))
    shots = _shots(truth, matrices, measured)
    return json.dumps([{"cameras": {"c": LENS}, "shots": shots, "reference_lla": reference}])


@pytest.fixture
def odm(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, Truth]:
    """A project of ODM at the edge of a zone, with every file it leaves."""
    truth = made_truth(np.random.default_rng(3))
    latitude = getattr(request, "param", 47.0)
    truth.origin = Geodetic(latitude, 11.9, 0.0)
    linear, shift, header = move_of_odm(truth.origin, 32)
    offset = np.floor(shift[:2]) - 3
    (tmp_path / "opensfm").mkdir()
    (tmp_path / "odm_georeferencing").mkdir()
    path = tmp_path / "opensfm" / "reconstruction.json"
    moved = projected(truth.world_from_cam, linear, shift - [*offset, 0])
    path.write_text(shots_of(truth, moved, True))
    first = path.with_name("reconstruction.topocentric.json")
    first.write_text(shots_of(truth, truth.world_from_cam, True))
    coords = tmp_path / "odm_georeferencing" / "coords.txt"
    coords.write_text(f"{header}\n{offset[0]:.0f} {offset[1]:.0f}\n1 2 3\n")
    return path, truth


def assert_true(path: Path, truth: Truth, frame: Frame | None = None) -> None:
    poses = read_foreign(path, frame)
    assert poses.origin == truth.origin
    np.testing.assert_allclose(poses.positions, truth.world_from_cam[:, :3, 3], atol=1e-3)
    turned = poses.cam_from_world[:, :3, :3] @ truth.world_from_cam[:, :3, :3]
    np.testing.assert_allclose(turned, np.tile(np.eye(3), (len(truth.names), 1, 1)), atol=1e-5)


@pytest.mark.parametrize("odm", [47.0, -35.0, 61.0], indirect=True)
@pytest.mark.parametrize("without", [[], ["first"], ["coords"]])
def test_both_files_of_odm_are_one_reconstruction(
    odm: tuple[Path, Truth], without: list[str]
) -> None:
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    assert_true(first, truth)
    if "first" in without:
        first.unlink()
    if "coords" in without:
        (path.parents[1] / "odm_georeferencing" / "coords.txt").unlink()
    assert_true(path, truth)


def test_a_projected_file_alone_is_refused(odm: tuple[Path, Truth], tmp_path: Path) -> None:
    path, _ = odm
    alone = tmp_path / "reconstruction.json"
    alone.write_text(path.read_text())
    (tmp_path / "odm_georeferencing" / "coords.txt").unlink()
    with pytest.raises(
        InputError, match=r"in a projected system by gps_position \(turned by 2\.\d+"
    ):
        read_foreign(alone)
    with pytest.raises(InputError, match=r"by gps_position .*, but topocentric by --poses-frame"):
        read_foreign(alone, "topocentric")
    with pytest.raises(InputError, match=r"nothing tells its offset: give .*coords\.txt"):
        read_foreign(alone, "projected")


def test_without_gps_the_frame_in_a_project_of_odm_is_stated(odm: tuple[Path, Truth]) -> None:
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    first.unlink()
    document = json.loads(path.read_text())
    for shot in document[0]["shots"].values():
        del shot["gps_position"]
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"UTM zone 32N\) cannot be told .* state --poses-frame"):
        read_foreign(path)
    assert_true(path, truth, "projected")
    path.write_text(shots_of(truth, truth.world_from_cam, False))
    with pytest.raises(InputError, match="cannot be told"):
        read_foreign(path)
    assert_true(path, truth, "topocentric")


@pytest.mark.parametrize(("made", "gps"), [("moved", True), ("first", True), ("first", False)])
def test_a_stated_frame_contradicts_what_the_files_show(
    odm: tuple[Path, Truth], made: str, gps: bool
) -> None:
    """With ODM's other file beside it, with coords.txt and GPS, and by its name."""
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    if made == "first":
        path.write_text(shots_of(truth, truth.world_from_cam, gps))
    frames: tuple[Frame, Frame] = ("topocentric", "projected")
    right, wrong = frames if made == "first" else frames[::-1]
    assert_true(path, truth, right)
    with pytest.raises(InputError, match=f"are {right} by .*beside it, but {wrong} by --poses-f"):
        read_foreign(path, wrong)
    with pytest.raises(InputError, match="are topocentric by its name, but projected by"):
        read_foreign(first, "projected")
    first.unlink()
    if gps:
        with pytest.raises(InputError, match=f"{right} by gps_position.*, but {wrong} by --poses"):
            read_foreign(path, wrong)


@pytest.mark.parametrize("folder", ["opensfm", "photos"])
def test_the_project_of_plain_opensfm_tells_the_frame(
    odm: tuple[Path, Truth], tmp_path: Path, folder: str
) -> None:
    _, truth = odm
    path = tmp_path / "site" / folder / "reconstruction.json"
    path.parent.mkdir(parents=True)
    path.write_text(shots_of(truth, truth.world_from_cam, False))
    with pytest.raises(
        InputError, match=r"a UTM grid as of zone 32\) cannot be told \(gps_position"
    ):
        read_foreign(path)
    assert_true(path, truth, "topocentric")
    plain_project(path.parent)
    assert_true(path, truth)
    with pytest.raises(InputError, match="by OpenSfM's project around it, but projected by"):
        read_foreign(path, "projected")
    (path.parent / "image_list.txt").write_text("/datasets/project/images/a.jpg\n")
    with pytest.raises(InputError, match="cannot be told"):
        read_foreign(path)


def test_a_frame_is_stated_of_a_file_that_leaves_it_open(
    odm: tuple[Path, Truth], tmp_path: Path
) -> None:
    path = odm[0]
    document = json.loads(path.read_text())
    del document[0]["reference_lla"]
    path.write_text(json.dumps(document))
    assert read_foreign(path).origin is None
    with pytest.raises(InputError, match="has no reference_lla, and is placed by GPS: leave out"):
        read_foreign(path, "projected")
    with pytest.raises(
        InputError, match=r"not a reconstruction\.json of ODM or OpenSfM: leave out"
    ):
        read_foreign(nerfstudio(tmp_path), "topocentric")


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"focal_x": 3200.0, "focal_y": 3200.0}, "focal 3200 is not in longer sides"),
        ({"c_x": 0.7}, "c_x puts the principal point"),
        ({"c_y": 1500.0}, "c_y puts the principal point"),
    ],
)
def test_lenses_in_pixels_are_no_lenses_of_opensfm(
    odm: tuple[Path, Truth], keys: dict[str, float], says: str
) -> None:
    path = odm[0].with_name("reconstruction.topocentric.json")
    document = json.loads(path.read_text())
    for lens in document[0]["cameras"].values():
        lens.update(projection_type="brown", **keys)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=says):
        read_foreign(path)


def test_coordinates_of_export_geocoords_are_no_metres_from_here(
    odm: tuple[Path, Truth], tmp_path: Path
) -> None:
    _, truth = odm
    linear, shift, _ = move_of_odm(truth.origin, 32)
    path = tmp_path / "reconstruction.geocoords.json"
    (tmp_path / "odm_georeferencing" / "coords.txt").unlink()
    path.write_text(shots_of(truth, projected(truth.world_from_cam, linear, shift), False))
    with pytest.raises(InputError, match="but in a projected system, as export_geocoords writes"):
        read_foreign(path)


def test_files_of_two_reconstructions_are_refused(odm: tuple[Path, Truth]) -> None:
    path, truth = odm
    other = made_truth(np.random.default_rng(4))
    other.names, other.origin = truth.names, truth.origin
    other.world_from_cam = np.resize(other.world_from_cam, truth.world_from_cam.shape)
    first = path.with_name("reconstruction.topocentric.json")
    first.write_text(shots_of(truth, other.world_from_cam, True))
    with pytest.raises(InputError, match="are of two reconstructions"):
        read_foreign(path)
    (path.parent / "reference_lla.json").write_text(
        '{"latitude": 47.1, "longitude": 11.9, "altitude": 0}'
    )
    with pytest.raises(InputError, match="its reference_lla is not that of reference_lla.json"):
        read_foreign(path)


def test_the_turn_of_a_grid() -> None:
    """ODM's map turns axes by the convergence, on both sides of a zone and of the equator."""
    for latitude, longitude in ((47.0, 11.9), (47.0, 6.1), (-35.0, 11.9), (60.0, -179.5)):
        place = Geodetic(latitude, longitude, 0.0)
        linear, _, _ = move_of_odm(place, utm_zone(longitude))
        turn = np.arctan2(linear[1, 0], linear[0, 0])
        assert convergence(place, utm_zone(longitude)) == pytest.approx(turn, abs=2e-5)


def test_axes_that_positions_do_not_tell_are_unknown() -> None:
    rng = np.random.default_rng(1)
    gps = rng.uniform(-50, 50, (20, 2))
    cos, sin = np.cos(0.03), np.sin(0.03)
    turned = gps @ np.array([[cos, sin], [-sin, cos]]) + 7
    assert axes_of(gps + 3, gps, 0.03).value == "east and north"
    assert axes_of(turned, gps, 0.03).value == "grid"
    assert axes_of(turned, gps, -0.03).value == "grid" or not axes_of(turned, gps, -0.03).known
    assert not axes_of(turned, gps + rng.normal(0, 9, gps.shape), 0.03).known
    assert not axes_of(turned, np.full_like(gps, np.nan), 0.03).known


@pytest.mark.parametrize("value", [True, 1, 1.0, "true", "True", " TRUE ", "yes", "1"])
def test_is_fisheye_in_every_spelling(tmp_path: Path, value: object) -> None:
    assert parse_flag(value) is True
    for frames in (False, True):
        camera = transforms(tmp_path, frames, is_fisheye=value, k1=0.02, k3=0.001)
        params = (500.0, 500.0, 320.0, 240.0, 0.02, 0.0, 0.001, 0.0)
        assert camera == Camera("OPENCV_FISHEYE", 640, 480, params)


@pytest.mark.parametrize(
    ("keys", "model"),
    [
        ({"is_fisheye": False, "k1": 0.1}, "OPENCV"),
        ({"is_fisheye": "false", "k1": 0.1}, "OPENCV"),
        ({"camera_model": "simple_radial", "k1": 0.1}, "OPENCV"),
        ({"camera_model": "SIMPLE_RADIAL_FISHEYE", "k1": 0.1}, "OPENCV_FISHEYE"),
        ({"camera_model": "OPENCV_FISHEYE", "is_fisheye": 1, "k1": 0.1}, "OPENCV_FISHEYE"),
        ({"is_fisheye": True, "camera_angle_x": 640 / 500}, "OPENCV_FISHEYE"),
        ({"is_fisheye": True, "camera_angle_x": 1.138}, "OPENCV_FISHEYE"),
        ({"camera_angle_x": 1.138, "orientation_override": "none", "scale": 0.3}, "OPENCV"),
        ({"rolling_shutter": [0, 0, 0, 0], "k5": 0}, "OPENCV"),
    ],
)
def test_models_of_transforms(tmp_path: Path, keys: dict[str, Any], model: str) -> None:
    camera = transforms(tmp_path, False, **keys)
    assert camera is not None
    assert camera.model == model
    assert camera.distortion[0] == keys.get("k1", 0.0)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"is_fisheye": "maybe"}, "is_fisheye is 'maybe', neither true nor false"),
        ({"is_fisheye": True, "camera_model": "OPENCV"}, "OPENCV and is_fisheye True contradict"),
        ({"is_fisheye": 0, "camera_model": "OPENCV_FISHEYE"}, "and is_fisheye .* contradict"),
        ({"is_fisheye": True, "p1": 0.01}, "is_fisheye says OPENCV_FISHEYE, which has no p1"),
        ({"camera_model": "PINHOLE", "k1": 0.1}, "camera_model says PINHOLE, which has no k1"),
        ({"camera_model": "RADIAL", "p2": 0.1}, "camera_model says RADIAL, which has no p2"),
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model 'EQUIRECTANGULAR' is not supported"),
        ({"camera_model": "SIMPLE_PINHOLE", "fl_y": 510}, "one focal length, but fl_y is not fl_x"),
        ({"camera_angle_x": 0.8}, "fl_x 500 and camera_angle_x 0.8 contradict each other"),
        ({"camera_angle_y": 1.138}, "fl_y 500 and camera_angle_y 1.138 contradict each other"),
        ({"fl_x": 0.78}, "fl_x, fl_y 0.78, 0.78 are no focal lengths in pixels"),
        ({"cx": 0.5, "cy": 0.5}, r"cx, cy \(0.5, 0.5\) are not in pixels"),
        ({"cx": 900}, "cx puts the principal point at 900 of 640 pixels"),
        ({"cy": -3}, "cy puts the principal point at -3 of 480 pixels"),
        ({"w": 640.5}, "w is 640.5, but a picture has whole pixels"),
        ({"latlong": True}, "the key 'latlong' changes the camera"),
        ({"ftheta_p1": 0.1}, "the key 'ftheta_p1' changes the camera"),
        ({"from_na": True}, "the key 'from_na' changes the camera"),
    ],
)
def test_lenses_that_contradict_themselves(
    tmp_path: Path, keys: dict[str, Any], message: str
) -> None:
    for frames in (False, True):
        with pytest.raises(InputError, match=message):
            transforms(tmp_path, frames, **keys)


def transforms(folder: Path, frames: bool, **keys: Any) -> Camera | None:
    """Read one photograph's camera; keys are those of the file or of its frame."""
    matrix = np.eye(4).tolist()
    frame: dict[str, Any] = {"file_path": "a.jpg", "transform_matrix": matrix}
    document: dict[str, Any] = {"w": 640, "h": 480, "fl_x": 500.0, "frames": [frame]}
    (frame if frames else document).update(keys)
    path = folder / "transforms.json"
    path.write_text(json.dumps(document))
    return read_foreign(path).cameras[0]


def test_applied_scale_is_undone(tmp_path: Path) -> None:
    path = nerfstudio(tmp_path)
    before = read_foreign(path).positions
    document = json.loads(path.read_text())
    document["applied_scale"] = 0.25
    for frame in document["frames"]:
        for row in frame["transform_matrix"][:3]:
            row[3] *= 0.25
    path.write_text(json.dumps(document))
    np.testing.assert_allclose(read_foreign(path).positions, before, atol=1e-9)
    document["frames"][0]["transform_matrix"] = np.array(
        document["frames"][0]["transform_matrix"]
    ).T.tolist()
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="does not end with the row 0 0 0 1: is it transposed"):
        read_foreign(path)


EMPTY = "<sensor id='7' label='x'><calibration type='frame' class='adjusted'/></sensor>"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('<sensors next_id="1">', f"<sensors>{EMPTY}"), None),
        (("</cameras>", "<camera id='9' sensor_id='7' label='n'/></cameras>"), None),
        (("</calibration>\n</sensor>", "</calibration><bands/></sensor>"), None),
        (('<resolution width="5472" height="3648"/>\n<calib', "<calib"), None),
        (('<resolution width="5472"', '<resolution width="2736"'), "resolution 2736 x 3648"),
        (('label="FC6310" type="frame"', 'label="F" type="rpc"'), "type 'rpc' and that of"),
        (('type="frame"', 'type="spherical"'), "type 'spherical' .*not supported"),
        (("<b1>", "<p4>0.1</p4><b1>"), "the coefficient p4 is not supported"),
        (("<b1>", "<k5>0.1</k5><b1>"), "the coefficient k5 is not supported"),
        (("<b1>", "<cx>4000</cx><b1>"), "cx puts the principal point at .* outside the picture"),
        (("<scale>20.0</scale>", ""), "transform of component '' has no scale"),
        (("<scale>20.0</scale>", "<scale>-1</scale>"), "the scale of component must be positive"),
        (("<translation>", "<t>"), "has no translation"),
        (("</chunk></document>", "</chunk><chunk>C</chunk></document>"), "2 chunks, each in a"),
        (("</cameras>", "B</cameras>"), "in a component without a transform"),
    ],
)
def test_metashape_in_parts(tmp_path: Path, change: tuple[str, str], message: str | None) -> None:
    path = metashape(tmp_path)
    text, (old, new) = path.read_text(), change
    words = re.search(r"<camera id=\"0\".*</camera>", text)
    assert words is not None and (old in text)
    new = new.replace("C", words[0]) if new.startswith("</chunk>") else new
    if new.startswith("B"):
        other = words[0].replace('component_id="0"', 'component_id="5"').replace("DJI_1", "DJI_7")
        new = other + new[1:]
    text = text.replace(old, new) if "spherical" in new else text.replace(old, new, 1)
    path.write_text(text.replace("</translation>", "</t>") if "<t>" in new else text)
    if message is None:
        assert read_foreign(path).names == ("DJI_1",)
        return
    with pytest.raises(InputError, match=message):
        read_foreign(path)


def test_local_components_are_not_one_frame(tmp_path: Path) -> None:
    for seed in range(200):
        path, truth = write_metashape(np.random.default_rng(seed), tmp_path)
        text = path.read_text()
        if not truth.placed and not truth.fields:
            break
    matrix = " ".join(["1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"])
    inner = re.search(r"<transform><rot.*?</transform>", text)
    assert inner is not None
    text = text.replace("</components>", f"<component id='4'>{inner[0]}</component></components>")
    camera = f"<camera id='77' sensor_id='0' component_id='4' label='y'><transform>{matrix}"
    path.write_text(text.replace("</cameras>", f"{camera}</transform></camera></cameras>"))
    with pytest.raises(InputError, match="in 2 components, which nothing places in one frame"):
        read_foreign(path)


def test_an_initial_calibration_is_doubted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = metashape(tmp_path)
    path.write_text(path.read_text().replace('class="adjusted"', 'class="initial"'))
    with pytest.raises(InputError, match=r"positive|sensor"):
        path.write_text(path.read_text().replace("<f>1</f>", "<f>-1</f>"))
        read_foreign(path)
    assert "has an initial calibration, not an adjusted one" in caplog.text
