"""Lenses and components of other programs that a file states twice, in parts or not at all."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.imports.formats import read_foreign
from objconnect.scene.quantities.flags import parse_flag
from tests.objconnect.scene.imports.made_models import write_metashape
from tests.objconnect.scene.imports.test_imports import metashape, nerfstudio


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
        ({"fl_x": 0.78}, "fl_x, fl_y 0.78, 0.78 are not focal lengths in pixels"),
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
    with pytest.raises(InputError, match="does not end with the row 0 0 0 1: transpose it"):
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
        (
            ("</chunk></document>", "</chunk><chunk>C</chunk></document>"),
            "2 chunks, each with its own",
        ),
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
    with pytest.raises(InputError, match="in 2 components, which have no common frame"):
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
