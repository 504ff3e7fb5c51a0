"""Models of COLMAP that are read as another one, against COLMAP's own projection."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
import torch

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.geometry.colmap_models import (
    CONVERTIBLE_MODELS,
    MODEL_IDS,
    convert_model,
    parameter_count,
)

FOCAL = (500.0, 510.0)
MIDDLE = (322.0, 237.5)
EXACT = {
    "SIMPLE_FISHEYE": (500.0, *MIDDLE),
    "FISHEYE": (*FOCAL, *MIDDLE),
    "SIMPLE_RADIAL_FISHEYE": (500.0, *MIDDLE, 0.03),
    "RADIAL_FISHEYE": (500.0, *MIDDLE, 0.03, -0.004),
    "FULL_OPENCV": (*FOCAL, *MIDDLE, -0.1, 0.02, 1e-3, -2e-3, 0, 0, 0, 0),
    "THIN_PRISM_FISHEYE": (*FOCAL, *MIDDLE, 0.03, -0.004, 0, 0, 1e-3, -2e-4, 0, 0),
    "RAD_TAN_THIN_PRISM_FISHEYE": (*FOCAL, *MIDDLE, 0.03, -0.004, 1e-3, -2e-4, *[0.0] * 8),
    "DIVISION": (*FOCAL, *MIDDLE, 0.0),
    "SIMPLE_DIVISION": (500.0, *MIDDLE, 0.0),
}


def test_names_and_counts_are_colmaps() -> None:
    known = {name: m for name, m in pycolmap.CameraModelId.__members__.items() if name != "INVALID"}
    for name, native in known.items():
        number = int(native.value) if hasattr(native, "value") else int(native)
        assert MODEL_IDS[number] == name
        if name in CONVERTIBLE_MODELS or name in MODELS:
            made = pycolmap.Camera.create_from_model_name(0, name, 500.0, 640, 480)
            assert (parameter_count(name) or len(MODELS[name])) == len(made.params)


@pytest.mark.parametrize("name", EXACT)
def test_it_projects_as_colmap_does(name: str) -> None:
    params = EXACT[name]
    ours = Camera.parse([name, "640", "480", *map(repr, map(float, params))])
    assert ours.model in MODELS
    native = pycolmap.Camera(model=name, width=640, height=480, params=list(map(float, params)))
    rays = np.array([[0.0, 0.0, 1.0], [0.4, -0.3, 1.0], [-0.5, 0.4, 1.0], [0.2, 0.45, 1.0]])
    found = ours.project(torch.from_numpy(rays))
    assert bool(found.valid.all())
    np.testing.assert_allclose(found.xy.numpy(), native.img_from_cam(rays), atol=1e-9)
    back, valid = ours.unproject(found.xy)
    assert bool(valid.all())
    np.testing.assert_allclose(back.numpy(), rays, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "place", "message"),
    [
        ("THIN_PRISM_FISHEYE", 10, "THIN_PRISM_FISHEYE is supported only where sx1 is zero"),
        ("THIN_PRISM_FISHEYE", 7, "p2 is zero"),
        ("RAD_TAN_THIN_PRISM_FISHEYE", 15, "s4 is zero"),
        ("DIVISION", 4, "k is zero"),
    ],
)
def test_a_coefficient_that_we_lack_is_named(name: str, place: int, message: str) -> None:
    params = list(EXACT[name])
    params[place] = 0.01
    with pytest.raises(InputError, match=message):
        convert_model(name, params)


@pytest.mark.parametrize("place", range(8, 12))
def test_full_opencv_is_opencv_only_without_its_tail(place: int) -> None:
    params = [*EXACT["FULL_OPENCV"]]
    assert convert_model("FULL_OPENCV", params) == ("OPENCV", EXACT["FULL_OPENCV"][:8])
    params[place] = 0.01
    assert convert_model("FULL_OPENCV", params) == ("FULL_OPENCV", tuple(params))
