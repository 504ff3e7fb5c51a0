"""Structure scans of QGroundControl: layers that look inwards, and fields that define no flight."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from simulate.flight.gimbal import Aims
from simulate.flight.qgroundcontrol import read_plan

ORIGIN = Geodetic(47.0, 8.0, 450.0)


def geodetic_of(east: float, north: float) -> list[float]:
    latitude, longitude, _ = geodetic_from_enu(np.array([east, north, 0.0]), ORIGIN)
    return [latitude, longitude]


# Clockwise, 20 m a side.
HOUSE = [geodetic_of(-10, -10), geodetic_of(-10, 10), geodetic_of(10, 10), geodetic_of(10, -10)]
CAMERA = {
    "version": 2,
    "DistanceToSurface": 15,
    "DistanceMode": 1,
    "AdjustedFootprintSide": 10,
    "AdjustedFootprintFrontal": 8,
}
SCAN: dict[str, Any] = {
    "type": "ComplexItem",
    "complexItemType": "StructureScan",
    "version": 3,
    "polygon": HOUSE,
    "EntranceAltitude": 60,
    "ScanBottomAlt": 0,
    "StructureHeight": 24,
    "Layers": 3,
    "GimbalPitch": -10,
    "StartFromTop": True,
    "CameraCalc": CAMERA,
}


def fly(folder: Path, **fields: Any) -> Aims:
    mission = {
        "items": [SCAN | fields],
        "plannedHomePosition": [47.0, 8.0, 0.0],
        "firmwareType": 12,
        "vehicleType": 2,
        "hoverSpeed": 5,
        "cruiseSpeed": 15,
    }
    path = folder / "scan.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission, "version": 1}))
    return read_plan(path, ORIGIN, 200.0, lambda x, y: np.zeros(np.shape(x)), -90.0, 0.0)


@pytest.mark.parametrize("from_top", [True, False])
def test_each_round_looks_at_the_structure(tmp_path: Path, from_top: bool) -> None:
    aims = fly(tmp_path, StartFromTop=from_top)
    # 15 m outside a square of 20 m, four sides of 50 m are flown, with a photograph every 10 m.
    assert_allclose(np.abs(aims.centres[:, :2]).max(1), 25, atol=0.05)
    heights = [20.0, 12.0, 4.0] if from_top else [4.0, 12.0, 20.0]
    assert_allclose(aims.centres[:, 2], np.repeat(heights, 21), atol=0.05)
    assert_allclose(aims.centres[[0, 20, 21], :2], [[-25, -25]] * 3, atol=0.05)
    steps = np.linalg.norm(np.diff(aims.centres[:21, :2], axis=0), axis=1)
    assert_allclose(steps, 10, atol=0.02)
    assert_allclose(np.degrees(aims.pitch), -10, atol=0.05)
    looks = np.column_stack([np.sin(aims.heading), np.cos(aims.heading)])
    assert ((aims.centres[:, :2] * looks).sum(1) < -20).all()
    assert_allclose(np.degrees(aims.heading[[1, 7, 12, 18]]) % 360, [90, 180, 270, 360], atol=0.1)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"version": 2}, "version 2"),
        ({"polygon": HOUSE[::-1]}, "clockwise"),
        ({"polygon": [HOUSE[0], *HOUSE]}, "a corner twice"),
        ({"polygon": HOUSE[:2]}, "2 corners"),
        ({"polygon": [[99.0, 8.0], *HOUSE[1:]]}, "not on earth"),
        ({"polygon": [HOUSE[0], geodetic_of(-10, 0), *HOUSE[1:]]}, "corner on a straight side"),
        ({"Layers": 0}, "0 Layers"),
        ({"Layers": 4}, "4 Layers, but StructureHeight"),
        ({"StructureHeight": None}, "'StructureHeight'"),
        ({"GimbalPitch": "down"}, "'GimbalPitch'"),
        ({"CameraCalc": {}}, "'DistanceToSurface'"),
        ({"CameraCalc": CAMERA | {"AdjustedFootprintSide": 0}}, "'AdjustedFootprintSide'"),
    ],
)
def test_a_scan_that_tells_no_flight_is_named(
    tmp_path: Path, fields: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError) as raised:
        fly(tmp_path, **fields)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
