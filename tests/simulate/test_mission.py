"""Commands of missions: how each changes place, time and direction of the photographs."""

from __future__ import annotations

import copy
import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import geodetic_from_enu
from simulate.flight.commands import DOUBTFUL, HARMLESS, NAVIGATION
from simulate.flight.gimbal import Aims
from simulate.flight.qgroundcontrol import read_plan
from tests.simulate.test_qgroundcontrol import (
    AREA,
    ORIGIN,
    Item,
    hills,
    item,
    plan_of,
    survey,
    waypoint,
)

HOME_M = hills(0, 0)
NO_TRIGGER = item(206, 0)  # a trigger, so that waypoints are not photographed


def fly(tmp_path: Path, *items: Item, undulation_m: float | None = None, **mission: Any) -> Aims:
    plan = plan_of(*items)
    plan["mission"] |= mission
    path = tmp_path / "a.plan"
    path.write_text(json.dumps(plan))
    return read_plan(path, ORIGIN, AREA, hills, -90.0, undulation_m)


def geodetic_of(east: float, north: float) -> tuple[float, float]:
    latitude, longitude, _ = geodetic_from_enu(np.array([east, north, 0.0]), ORIGIN)
    return latitude, longitude


def command_at(
    number: int, east: float, north: float, height: float, *params: float | None
) -> Item:
    first = [*params, *[0.0] * (4 - len(params))]
    return item(number, *first, *geodetic_of(east, north), height, frame=3)


def looks_at(aims: Aims, row: int, target: tuple[float, float, float]) -> None:
    heading, pitch = aims.heading[row], aims.pitch[row]
    way = np.array(target) - aims.centres[row]
    looks = [np.cos(pitch) * np.sin(heading), np.cos(pitch) * np.cos(heading), np.sin(pitch)]
    assert_allclose(looks, way / np.linalg.norm(way), atol=0.002)


A, B, C = waypoint(-50, 0, 40), waypoint(50, 0, 40), waypoint(50, 50, 40)
SHOT = item(203, 0, 0, 0, 0, 1)


@pytest.mark.parametrize(
    ("roi", "height", "autopilot"),
    [
        (item(195, 0, 0, 0, 0, *geodetic_of(0, 30), 0, frame=3), HOME_M, 12),
        (item(195, 0, 0, 0, 0, *geodetic_of(0, 30), 460, frame=0), 10, 12),
        (item(195, 0, 0, 0, 0, *geodetic_of(0, 30), 2, frame=10), hills(0, 30) + 2, 3),
        (item(201, 3, 0, 0, 0, *geodetic_of(0, 30), 5, frame=6), HOME_M + 5, 12),
        (item(201, 0, 0, 0, 0, *geodetic_of(0, 30), 5, frame=3), HOME_M + 5, 3),
        (item(80, 3, 0, 0, 0, *geodetic_of(0, 30), 0, frame=3), HOME_M, 12),
        (item(205, 0, 0, 0, 5, *geodetic_of(0, 30), 4, frame=2), HOME_M + 5, 3),
        (item(205, 0, 0, 0, 455, *geodetic_of(0, 30), 4, frame=2), 5, 12),
        (item(205, 0, 0, 0, 5, *geodetic_of(0, 30), 4, frame=3), HOME_M + 5, 0),
    ],
)
def test_the_camera_looks_at_a_region(
    tmp_path: Path, roi: Item, height: float, autopilot: int
) -> None:
    aims = fly(tmp_path, A, roi, B, C, firmwareType=autopilot, undulation_m=0)
    assert_allclose(np.degrees(aims.pitch[0]), -90)
    for row in (1, 2):
        looks_at(aims, row, (0, 30, height))
    back = fly(tmp_path, A, roi, B, item(197), C, firmwareType=autopilot, undulation_m=0)
    assert_allclose(np.degrees(back.pitch), [-90, np.degrees(aims.pitch[1]), -90])


def test_the_camera_looks_towards_waypoints(tmp_path: Path) -> None:
    ahead = item(196, 0, 0, 0, 0, -20, 0, 90)
    aims = fly(tmp_path, A, ahead, SHOT, B, SHOT, waypoint(50, 50, 90))
    assert_allclose(np.degrees(aims.heading), [180, 90], atol=0.01)
    assert_allclose(np.degrees(aims.pitch), [-20, 25], atol=0.01)


@pytest.mark.parametrize(
    ("commands", "said"),
    [
        ([item(195, 0, 0, 0, 0, None, 8, 0, frame=3)], r"195, .*params\[4\]"),
        ([item(195, 0, 0, 0, 0, *geodetic_of(0, 9), 0, frame=2)], "195, .*MAV_FRAME 2"),
        ([item(201, 2, 3, 0, 0, *geodetic_of(0, 9), 0, frame=3)], "201, .*mode 2"),
        ([item(198, 1)], "198, DO_SET_ROI_SYSID"),
        ([item(196, 0, 0, 0, 0, 0, 5, 0)], r"196, .*params\[5\]"),
        ([item(205, -30, 10, 0, 0, 0, 0, 2)], r"205, .*params\[1\]"),
        ([item(205, None, 0, 0, 0, 0, 0, 2)], r"205, .*params\[0\]"),
        ([item(205, 0, 0, 0, 0, 0, 0, 0), SHOT], "205, .*mode 0"),
        ([item(205, 0, 0, 0, 0, 0, 0, 1), SHOT], "205, .*mode 1"),
        ([item(204, 2, 0, 0, 0, 0, 1, 0)], "204, .*rates"),
        ([item(1000, 0, 0, None, None, 2), SHOT], "1000, .*neutral"),
        ([item(1000, None, None, 5, None, 0), SHOT], "1000, .*continuously"),
        ([item(1000, -90, 30, None, None, 64)], r"1000, .*params\[4\]"),
        ([item(1000, -90, 30, None, None, 48)], r"1000, .*params\[4\]"),
        ([item(1000, 0, 0, 9, None, 0), SHOT], "10.0 s before"),
        ([item(260, 10, 0, 0, 3, 30, -60)], "260, OBLIQUE_SURVEY"),
        ([item(2000, 0, None, 3)], r"2000, .*params\[1\]"),
        ([item(2000, 0, 0, 0)], r"2000, .*params\[1\]"),
        ([item(2000, 0, 2, None)], r"2000, .*params\[2\]"),
        ([item(2000, 2, 3, -1)], r"2000, .*params\[2\]"),
        ([item(214, None)], r"214, .*params\[0\]"),
        ([item(214, 2)], r"214, .*2 ms \(params\[0\]\).*not seconds"),
        ([item(2000, 0, 0.01, 3)], r"2000, .*params\[1\]"),
        ([item(205, -9000, 0, 0, 0, 0, 0, 2)], r"205, .*-9000 degrees \(params\[0\]\)"),
        ([item(1000, -45, 4500, None, None, 0)], r"1000, .*params\[1\]"),
        ([item(196, 0, 0, 0, 0, -20, 0, 9000)], r"196, .*params\[6\]"),
        ([item(206, -5)], r"206, .*params\[0\]"),
        ([item(203, 0, 0, 0, 0, None)], r"203, .*params\[4\]"),
        ([item(2003, 1)], "2003, .*own trigger"),
        ([item(178, 1, None)], r"178, .*params\[1\]"),
        ([item(178, None, 5)], r"178, .*params\[0\]"),
        ([item(178, 1, 0)], r"178, .*params\[1\]"),
        ([item(177, 1, -1)], "177, .*without an end"),
        ([item(177, 99, 1)], "177, .*no commands"),
        ([item(601, 4, 1)], "601, .*no commands"),
        ([item(600, 4), item(600, 4), item(601, 4, 1)], "601, .*2 commands"),
        ([command_at(17, 0, 0, 40)], "17, NAV_LOITER_UNLIM"),
        ([command_at(18, 0, 0, 40, 2, 0, 20), SHOT], "203, .*circles"),
        ([item(206, 9), command_at(18, 0, 0, 40, 2, 0, 20)], "18, .*206"),
        ([item(206, 9), command_at(82, 0, 0, 40)], "82, .*206"),
        ([item(114, 500), SHOT, item(20)], "114, .*not met"),
        ([item(112, 500), SHOT, C], "112, .*not met"),
        ([item(214, 2000), waypoint(0, 0, 40, yaw=5) | {"AltitudeMode": 2}], "AltitudeMode"),
        ([command_at(16, 0, 0, 40, 0, 0, 5)], r"16, .*params\[2\]"),
        ([item(186, 50)], "186, DO_CHANGE_ALTITUDE"),
        ([item(179, 1)], "179, DO_SET_HOME"),
        ([item(31010)], "31010, USER_1"),
        ([item(4242)], "4242, unknown command"),
        ([{**command_at(16, 0, 0, 40), "frame": None}], "frame is missing"),
        ([{**command_at(16, 0, 0, 40), "Altitude": 60, "AltitudeMode": 1}], "Altitude is 60"),
    ],
)
def test_what_is_not_followed_is_named(tmp_path: Path, commands: list[Item], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        fly(tmp_path, A, NO_TRIGGER, *commands, B)
    assert "\n" not in str(caught.value)


def test_every_command_is_of_one_class() -> None:
    assert not HARMLESS & DOUBTFUL
    assert not set(NAVIGATION) & (HARMLESS | DOUBTFUL)


@pytest.mark.parametrize(
    ("commands", "count"),
    [
        ([item(214, 2000)], 13),  # 100 m at 4 m/s
        ([item(2000, 0, 2, 3)], 3),
        ([item(2000, 0, None, 1, 7)], 1),
        ([item(2000, 0, 2, 0)], 13),
        ([item(214, 2000), item(214, -1)], 13),  # -1 is to be ignored
        ([item(214, 2000), item(2003, 0)], 1),
        ([item(206, 30, 0, 0)], 3),
        ([item(206, 30, -1, 1)], 4),
        ([item(206, 30, 0, 1), item(206, 0, 0, 1)], 2),  # and once more where it stops
        ([item(2000, 0, 5, 0), item(206, 30, 0, 0)], 6 + 3),
        ([item(2500, 0, 1, 1), item(2000, 0, 5, 0), item(2501)], 6),
    ],
)
def test_photographs_are_counted(tmp_path: Path, commands: list[Item], count: int) -> None:
    assert len(fly(tmp_path, A, *commands, B).centres) == count


def test_photographs_go_on_while_the_aircraft_waits(tmp_path: Path) -> None:
    stays = command_at(16, 50, 0, 40, 7, 0, 0, None)
    aims = fly(tmp_path, A, item(2000, 0, 5, 0), stays, item(93, 4), C, vehicleType=2)
    assert_allclose(aims.centres[5:8, :2], [[50, 0]] * 3, atol=0.01)  # at 25, 30 and 35 s
    assert_allclose(aims.centres[8, :2], [50, 16], atol=0.01)  # at 40 s, 36 s were on the way
    plane = fly(tmp_path, A, item(2000, 0, 1, 0), stays, C, vehicleType=1, cruiseSpeed=20)
    assert_allclose(np.diff(plane.centres[:6, 0]), 20, atol=0.01)
    assert len(plane.centres) == 8
    with pytest.raises(InputError, match="19, NAV_LOITER_TIME.*2000"):
        fly(tmp_path, A, item(2000, 0, 1, 0), command_at(19, 0, 9, 40, 5), C, vehicleType=1)
    hovers = fly(tmp_path, A, item(2000, 0, 1, 0), command_at(19, -50, 0, 40, 5), item(2001), C)
    assert len(hovers.centres) == 6


def test_speeds_are_those_of_the_aircraft(tmp_path: Path) -> None:
    def step(*commands: Item, **mission: Any) -> float:
        aims = fly(tmp_path, A, *commands, item(2000, 0, 1, 0), B, **mission)
        return float(aims.centres[1, 0] - aims.centres[0, 0])

    assert step() == pytest.approx(4, abs=0.01)
    assert step(vehicleType=1) == pytest.approx(15, abs=0.01)
    assert step(item(3000, 4), vehicleType=22) == pytest.approx(15, abs=0.01)
    assert step(item(3000, 4), item(3000, 3), vehicleType=22) == pytest.approx(4, abs=0.01)
    assert step(item(178, 0, 7, -1)) == pytest.approx(7, abs=0.01)
    assert step(item(178, 1, 7, -1), item(178, 1, -1, 50)) == pytest.approx(7, abs=0.01)
    assert step(item(178, 1, 7, -1), item(178, 1, -2, -1)) == pytest.approx(4, abs=0.01)
    assert step(item(178, 2, 7, -1)) == pytest.approx(4, abs=0.01)  # of climbing
    with pytest.raises(InputError, match="hoverSpeed is missing"):
        step(hoverSpeed=None)
    with pytest.raises(InputError, match="vehicleType is missing"):
        step(vehicleType=None)


def test_jumps_repeat_a_part(tmp_path: Path) -> None:
    parts = [A | {"doJumpId": 1}, B | {"doJumpId": 2}, item(177, 1, 2), C]
    assert_allclose(fly(tmp_path, *parts).centres[:, 0], [-50, 50] * 3 + [50], atol=0.01)
    tagged = [A, item(600, 9), B, C, item(601, 9, 1)]
    aims = fly(tmp_path, *tagged)
    assert_allclose(aims.centres[:, 1], [0, 0, 50, 0, 50], atol=0.01)
    assert len(fly(tmp_path, A, B | {"doJumpId": 5}, item(177, 5, 0)).centres) == 2
    with pytest.raises(InputError, match="177, .*longer than"):
        fly(tmp_path, A | {"doJumpId": 1}, item(177, 1, 1_000_000))


def test_the_nose_is_turned(tmp_path: Path) -> None:
    aims = fly(tmp_path, A, item(115, 200, 0, 1, 0), B, C)
    assert_allclose(np.degrees(aims.heading[1:]), [200, 0], atol=0.01)
    left = fly(tmp_path, A, B, item(115, 30, 0, -1, 1), C)
    assert np.degrees(left.heading[-1]) == pytest.approx(60, abs=0.01)
    # ArduPilot does not turn to the yaw of a waypoint, which is then 0 in its plans.
    apm = fly(tmp_path, A, waypoint(50, 0, 40, yaw=0), firmwareType=3)
    assert np.degrees(apm.heading[-1]) == pytest.approx(90, abs=0.01)
    px4 = fly(tmp_path, A, waypoint(50, 0, 40, yaw=0), firmwareType=12)
    assert np.degrees(px4.heading[-1]) == pytest.approx(0, abs=0.01)


def test_mounts_turn_from_the_nose_or_from_north(tmp_path: Path) -> None:
    to_south = item(205, -30, 0, 180, 0, 0, 0, 2)
    assert np.degrees(fly(tmp_path, A, to_south, B).heading[-1]) == pytest.approx(270)
    absolute = item(204, 2, 1, 1, 1, 0, 0, 2)
    assert np.degrees(fly(tmp_path, A, absolute, to_south, B).heading[-1]) == pytest.approx(180)
    slow = item(1000, -30, 0, 9, None, 0)
    aims = fly(tmp_path, A, slow, B)
    assert np.degrees(aims.pitch[-1]) == pytest.approx(-30), "it has turned on the way"
    kept = fly(tmp_path, A, item(1000, -30, 10, None, None, 16), item(1000, -50, None), B)
    assert_allclose(np.degrees([kept.pitch[-1], kept.heading[-1]]), [-50, 10])


@pytest.mark.parametrize("turn_m", [0, 20])
def test_gates_of_surveys_are_passed_in_flight(tmp_path: Path, turn_m: float) -> None:
    """QGroundControl writes gates, to which PX4 does not fly, where photographs begin and end."""
    gate = [item(4501, 0, 1, 0, 0, *geodetic_of(east, 3), 40, frame=3) for east in (-30, 30)]
    on, off = item(206, 20, 0, 1), item(206, 0, 0, 1)
    flown = [A, gate[0], on, gate[1], off, B] if turn_m else [A, on, B, off]
    aims = fly(tmp_path, survey(flown), item(20))
    edge = 30 if turn_m else 50
    assert_allclose(aims.centres[:, 0], np.arange(-edge, edge + 1, 20), atol=0.01)
    assert_allclose(aims.centres[:, 1], 0, atol=0.01)


def test_takeoffs_and_landings_take_no_photographs(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    up = item(22, 0, 0, 0, None, None, None, 30, frame=3)
    aims = fly(tmp_path, up, SHOT, A, item(206, 50, 0, 1), B, item(20))
    assert_allclose(aims.centres[0], [0, 0, HOME_M + 30], atol=0.01)
    assert len(aims.centres) == 4
    assert "NAV_RETURN_TO_LAUNCH" in caplog.text and "DO_SET_CAM_TRIGG_DIST" in caplog.text
    caplog.clear()
    stopped = fly(tmp_path, A, item(206, 50), B, item(206, 0), item(20))
    assert len(stopped.centres) == 2
    assert not caplog.records
    with pytest.raises(InputError, match="203, .*not at its first waypoint"):
        fly(tmp_path, SHOT, A)
    with pytest.raises(InputError, match="22, .*206|206, .*not at its first"):
        fly(tmp_path, item(206, 9), up, A)
    again = fly(tmp_path, A, SHOT, item(21, frame=3), up, B, SHOT)
    assert_allclose(again.centres[:, 0], [-50, 50], atol=0.01)


@pytest.mark.parametrize("stops", [True, False])
def test_landing_patterns_end_the_photographs(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, stops: bool
) -> None:
    landing = {"type": "ComplexItem", "complexItemType": "vtolLandingPattern"}
    aims = fly(tmp_path, A, item(206, 50), B, landing | {"stopTakingPhotos": stops})
    assert len(aims.centres) == 2
    assert ("vtolLandingPattern" in caplog.text) is not stops


def test_servos_and_zooms_are_left_out_with_a_word(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    fly(tmp_path, A, item(183, 9, 1500), item(531, 2, 50), item(208, 1), B)
    said = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert len(said) == 2
    assert "DO_SET_SERVO" in said[0] and "SET_CAMERA_ZOOM" in said[1]


def without_items(**camera: Any) -> Item:
    made = copy.deepcopy(survey(None))
    transects = made["TransectStyleComplexItem"]
    del transects["CameraCalc"]["DistanceMode"]
    transects |= {key: camera.pop(key) for key in list(camera) if key[0] in "HFTV"}
    if "in_turnarounds" in camera:
        transects["CameraTriggerInTurnAround"] = camera.pop("in_turnarounds")
    transects["CameraCalc"] |= camera
    return made


@pytest.mark.parametrize(
    ("camera", "height"),
    [
        ({"DistanceMode": 1}, HOME_M + 50),
        ({"DistanceMode": 2, "DistanceToSurface": 550}, 100 + 30),
        ({"DistanceMode": 3, "FollowTerrain": True}, None),
        ({"DistanceMode": 4}, None),
        ({"DistanceToSurfaceRelative": True}, HOME_M + 50),
        ({"DistanceToSurfaceRelative": False, "DistanceToSurface": 550}, 100 + 30),
        ({"DistanceToSurfaceRelative": True, "FollowTerrain": True}, None),
    ],
)
def test_distances_to_the_surface_have_a_reference(
    tmp_path: Path, camera: dict[str, Any], height: float | None
) -> None:
    centres = fly(tmp_path, without_items(**camera), undulation_m=30).centres
    expected = hills(*centres.T[:2]) + 50 if height is None else height
    assert_allclose(centres[:, 2], expected, atol=0.01)
    assert len(centres) in (31, 32)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ({}, "DistanceMode"),
        ({"DistanceMode": 0}, "DistanceMode is 0"),
        ({"DistanceMode": 7}, "DistanceMode is 7"),
        ({"DistanceMode": 2, "DistanceToSurfaceRelative": True}, "contradicts"),
        (
            {"DistanceMode": 1, "HoverAndCapture": True, "TurnAroundDistance": 10},
            "do not determine",
        ),
    ],
)
def test_unknown_references_of_surveys_are_named(
    tmp_path: Path, camera: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        fly(tmp_path, without_items(**camera))


def test_surveys_without_items_stop_in_turns(tmp_path: Path) -> None:
    kept = fly(tmp_path, without_items(DistanceMode=1, in_turnarounds=False)).centres
    assert set(np.round(kept[:, 0])) == {-60, 20}, "none between the lines"
    assert len(kept) == 22
    hovers = fly(tmp_path, without_items(DistanceMode=1, HoverAndCapture=True)).centres
    assert len(hovers) == 4


def test_heights_above_the_sea_are_not_those_above_the_ellipsoid(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    high = waypoint(0, 0, 500, frame=0)
    assert fly(tmp_path, high, undulation_m=47.0).centres[0, 2] == pytest.approx(97, abs=0.01)
    assert not caplog.records
    fly(tmp_path, high)  # without PROJ's grid, it is said
    said = "undulation_m" in caplog.text
    centres = fly(tmp_path, high).centres
    assert said == (abs(centres[0, 2] - 50) < 0.01)
    caplog.clear()
    fly(tmp_path, A)
    assert not caplog.records


def test_heights_that_were_not_computed_are_above_the_ground(tmp_path: Path) -> None:
    told = {"AltitudeMode": 3, "Altitude": 40, "AMSLAltAboveTerrain": None}
    item_of = item(16, 0, 0, 0, None, *geodetic_of(30, 20), None, frame=0) | told
    assert fly(tmp_path, A, item_of).centres[-1, 2] == pytest.approx(hills(30, 20) + 40)
