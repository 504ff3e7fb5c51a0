"""Mission plans of QGroundControl: photographs where the plan takes them, broken files refused."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.flight.gimbal import Aims, camera_centres
from simulate.flight.qgroundcontrol import read_plan
from simulate.planner import plan_session
from tests.simulate.test_flights import hills
from tests.simulate.towns import cached_town

ORIGIN = Geodetic(47.0, 8.0, 450.0)
AREA = 200.0
Item = dict[str, Any]

# Written by hand after a plan of QGroundControl 4.2: take-off, gimbal down, one line photographed
# every 10 m, gimbal up, one photograph at the last waypoint, return.
PLAN: Item = json.loads("""
{
  "fileType": "Plan",
  "geoFence": {"circles": [], "polygons": [], "version": 2},
  "groundStation": "QGroundControl",
  "mission": {
    "cruiseSpeed": 15, "firmwareType": 12, "globalPlanAltitudeMode": 1, "hoverSpeed": 4,
    "items": [
      {"AMSLAltAboveTerrain": null, "Altitude": 50, "AltitudeMode": 1, "autoContinue": true,
       "command": 22, "doJumpId": 1, "frame": 3, "type": "SimpleItem",
       "params": [0, 0, 0, null, 47.0, 8.0, 50]},
      {"autoContinue": true, "command": 205, "doJumpId": 2, "frame": 2, "type": "SimpleItem",
       "params": [-90, 0, 0, 0, 0, 0, 2]},
      {"AMSLAltAboveTerrain": null, "Altitude": 50, "AltitudeMode": 1, "autoContinue": true,
       "command": 16, "doJumpId": 3, "frame": 3, "type": "SimpleItem",
       "params": [0, 0, 0, null, 47.0, 7.9995, 50]},
      {"autoContinue": true, "command": 206, "doJumpId": 4, "frame": 2, "type": "SimpleItem",
       "params": [10, 0, 1, 0, 0, 0, 0]},
      {"AMSLAltAboveTerrain": null, "Altitude": 50, "AltitudeMode": 1, "autoContinue": true,
       "command": 16, "doJumpId": 5, "frame": 3, "type": "SimpleItem",
       "params": [0, 0, 0, null, 47.0, 8.0005, 50]},
      {"autoContinue": true, "command": 206, "doJumpId": 6, "frame": 2, "type": "SimpleItem",
       "params": [0, 0, 0, 0, 0, 0, 0]},
      {"autoContinue": true, "command": 1000, "doJumpId": 7, "frame": 2, "type": "SimpleItem",
       "params": [-45, 90, null, null, 0, 0, 0]},
      {"AMSLAltAboveTerrain": null, "Altitude": 40, "AltitudeMode": 1, "autoContinue": true,
       "command": 16, "doJumpId": 8, "frame": 3, "type": "SimpleItem",
       "params": [0, 0, 0, null, 47.0005, 8.0005, 40]},
      {"autoContinue": true, "command": 2000, "doJumpId": 9, "frame": 2, "type": "SimpleItem",
       "params": [0, 0, 1, 1, null, null, null]},
      {"autoContinue": true, "command": 20, "doJumpId": 10, "frame": 2, "type": "SimpleItem",
       "params": [0, 0, 0, 0, 0, 0, 0]}
    ],
    "plannedHomePosition": [47.0, 8.0, 431.0], "vehicleType": 2, "version": 2
  },
  "rallyPoints": {"points": [], "version": 2},
  "version": 1
}
""")
# A degree of longitude at 47 degrees north, from the ellipsoid's radius of curvature there.
DEGREE_EAST_M = 76_056.0


def item(command: int, *params: float | None, frame: int = 2) -> Item:
    padded = [*params, *[0.0] * (7 - len(params))]
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": padded}


def waypoint(east: float, north: float, height: float, frame: int = 3, yaw: Any = None) -> Item:
    latitude, longitude, _ = geodetic_from_enu(np.array([east, north, 0.0]), ORIGIN)
    return item(16, 0, 0, 0, yaw, latitude, longitude, height, frame=frame)


def plan_of(*items: Item) -> Item:
    plan = copy.deepcopy(PLAN)
    plan["mission"]["items"] = list(items)
    return plan


def read(tmp_path: Path, plan: Any, pitch_deg: float = -90.0) -> Aims:
    path = tmp_path / "a.plan"
    path.write_text(plan if isinstance(plan, str) else json.dumps(plan))
    return read_plan(path, ORIGIN, AREA, hills, pitch_deg)


def test_photographs_are_where_the_plan_takes_them(tmp_path: Path) -> None:
    aims = read(tmp_path, PLAN)
    line, last = aims.centres[:-1], aims.centres[-1]
    assert len(line) == 8  # 76 m, every 10 m from its start
    assert_allclose(line[:, 0], -0.0005 * DEGREE_EAST_M + 10 * np.arange(8), atol=0.01)
    assert_allclose(line[:, 1], 0, atol=0.001)
    assert_allclose(line[:, 2], hills(0, 0) + 50, atol=1e-9)  # above home's own ground
    assert_allclose(np.degrees(aims.pitch), [*[-90] * 8, -45])
    assert_allclose(np.degrees(aims.heading[1:-1]), 90, atol=0.01)
    assert last[1] == pytest.approx(55.59, abs=0.02)  # 0.0005 degrees of latitude
    assert last[2] == pytest.approx(hills(0, 0) + 40)
    assert np.degrees(aims.heading[-1]) == pytest.approx(90, abs=0.1)  # north, gimbal to its right


@given(
    places=st.lists(
        st.tuples(st.floats(-99, 99), st.floats(-99, 99), st.floats(20, 120)), min_size=1
    ),
    frame=st.sampled_from([0, 3, 5, 6, 10, 11]),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_waypoints_round_trip(
    tmp_path: Path, places: list[tuple[float, float, float]], frame: int
) -> None:
    base = {0: 450.0, 5: 450.0}.get(frame, 0.0)
    points = [waypoint(e, n, base + h, frame, yaw=30.0) for e, n, h in places]
    aims = read(tmp_path, plan_of(*points), pitch_deg=-60)
    asked = np.array(places)
    ground = {3: hills(0, 0), 6: hills(0, 0)}.get(frame, 0.0)
    if frame in (10, 11):
        ground = hills(aims.centres[:, 0], aims.centres[:, 1])
    # A plan's coordinates are on the ellipsoid: its curvature and a degree's length at height.
    assert_allclose(aims.centres[:, :2], asked[:, :2], atol=0.003)
    assert_allclose(aims.centres[:, 2] - ground, asked[:, 2], atol=0.002)
    assert_allclose(np.degrees(aims.heading), 30)
    assert_allclose(np.degrees(aims.pitch), -60)


def test_terrain_frame_follows_the_ground_between_waypoints(tmp_path: Path) -> None:
    start, end = waypoint(-90, -50, 40, frame=10), waypoint(90, 60, 60, frame=10)
    aims = read(tmp_path, plan_of(start, item(206, 5, 0, 1), end))
    x, y, z = aims.centres.T
    assert len(x) > 35
    assert_allclose(z - hills(x, y), 40 + 20 * (x + 90) / 180, atol=0.05)


def test_intervals_use_the_speed(tmp_path: Path) -> None:
    way = (waypoint(-90, 0, 40), item(2000, 0, 2, 0), waypoint(90, 0, 40))
    assert_allclose(np.diff(read(tmp_path, plan_of(*way)).centres[:, 0]), 8, atol=0.01)
    faster = (item(178, 1, 10, -1), *way, item(2001), waypoint(90, 90, 40))
    centres = read(tmp_path, plan_of(*faster)).centres
    assert_allclose(np.diff(centres[:, 0]), 20, atol=0.01)
    assert np.abs(centres[:, 1]).max() < 0.01


def test_yaw_locked_gimbal_looks_north(tmp_path: Path) -> None:
    east = (waypoint(0, 0, 40), item(1000, -45, 10, None, None, 16), waypoint(50, 0, 40))
    assert np.degrees(read(tmp_path, plan_of(*east)).heading[-1]) == pytest.approx(10)


def survey(items: list[Item] | None) -> Item:
    corners = [(-60, -40), (-60, 40), (20, 40), (20, -40)]
    points = [geodetic_from_enu(np.array([*c, 0.0]), ORIGIN)[:2] for c in corners]
    transects = {
        "CameraCalc": {
            "AdjustedFootprintFrontal": 8,
            "DistanceMode": 1,
            "DistanceToSurface": 50,
            "version": 2,
        },
        "FollowTerrain": False,
        "VisualTransectPoints": points,
        "version": 2,
    }
    if items is not None:
        transects["Items"] = items
    return {
        "TransectStyleComplexItem": transects,
        "type": "ComplexItem",
        "complexItemType": "survey",
        "angle": 0,
        "polygon": points,
        "version": 5,
    }


def test_survey_is_flown_by_its_items_or_its_transects(tmp_path: Path) -> None:
    flown = [waypoint(-60, -40, 50), item(206, 8, 0, 1), waypoint(-60, 40, 50), item(206, 0)]
    with_items = read(tmp_path, plan_of(survey(flown)))
    assert_allclose(np.diff(with_items.centres[:, 1]), 8, atol=0.01)
    assert len(with_items.centres) == 11
    transects = read(tmp_path, plan_of(survey(None)))
    assert len(transects.centres) == 31  # 240 m
    assert_allclose(transects.centres[:11, :2], with_items.centres[:, :2], atol=0.01)
    assert_allclose(transects.centres[:, 2], hills(0, 0) + 50)


def broken_plan(**mission: Any) -> Item:
    plan = copy.deepcopy(PLAN)
    plan["mission"] |= mission
    return plan


FAR = geodetic_from_enu(np.array([5000.0, 0.0, 0.0]), ORIGIN)


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ("", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ("[]", "mission plan|_Plan"),
        ({"fileType": "Plan"}, "missing key 'mission'"),
        (PLAN | {"fileType": "GeoFence"}, "fileType"),
        (broken_plan(items=3), "items"),
        (broken_plan(items=[]), "no waypoints"),
        (broken_plan(items=[{"type": "Loop"}]), "Loop"),
        (broken_plan(items=[{"type": "SimpleItem", "command": 16, "params": [1]}]), "params"),
        (
            broken_plan(items=[{"type": "ComplexItem", "complexItemType": "StructureScan"}]),
            "Structure",
        ),
        (broken_plan(plannedHomePosition=[470, 8, 0]), "plannedHomePosition"),
        (broken_plan(hoverSpeed=0), "hoverSpeed"),
        (plan_of(waypoint(0, 0, 40, frame=8)), "MAV_FRAME 8"),
        (plan_of(item(16, 0, 0, 0, 0, 91, 8, 40, frame=3)), "latitude 91"),
        (plan_of(item(16, 0, 0, 0, 0, 47, 8, 1e30, frame=3)), "height 1e"),
        (plan_of(waypoint(0, 0, 40), item(206, 0)), "takes no photographs"),
        (plan_of(waypoint(0, 0, 40), item(206, 1e-9), waypoint(9, 0, 40)), "more than 20000"),
        (plan_of(waypoint(0, 0, 40), item(206, 5e-324), waypoint(9, 0, 40)), "more than 20000"),
        (plan_of(item(16, 0, 0, 0, 0, *FAR[:2], 40, frame=3)), r"5,000 m from the centre"),
        (json.dumps(PLAN).replace("47.0,", "NaN,"), "finite"),
    ],
)
def test_hostile_plans_are_one_line(tmp_path: Path, plan: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, plan)
    assert "\n" not in str(caught.value)
    assert "a.plan" in str(caught.value)


def test_a_damaged_plan_is_refused_before_the_place_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simulate.command.plan_scene", None)
    path = tmp_path / "a.plan"
    path.write_text(json.dumps(PLAN))
    config = SimulateConfig.load(None, {"sessions": [f"summer-noon:plan={path}"], "area": 160})
    path.write_text(json.dumps(plan_of(waypoint(0, 0, 40))))
    with pytest.raises(InputError, match="has changed since"):
        simulate(config, tmp_path / "scene")
    path.write_text("{}")
    config = SimulateConfig.load(None, {"sessions": [f"summer-noon:plan={path}"], "area": 160})
    with pytest.raises(InputError, match=r"missing key 'fileType' in .*a\.plan"):
        simulate(config, tmp_path / "scene")


def test_a_plan_is_a_session(tmp_path: Path) -> None:
    path = tmp_path / "odd:name.plan"
    path.write_text(json.dumps(PLAN))
    words = [f"summer-noon:plan={path}", f"winter-dusk:plan={path}:query"]
    fields = {"sessions": words, "area": 160, "position_jitter_m": 0, "attitude_jitter_deg": 0}
    config = SimulateConfig.load(None, fields)
    assert config.session_names() == ("summer-noon-plan-map", "winter-dusk-plan-query")
    again = SimulateConfig.model_validate_json(config.model_dump_json())
    assert again == config
    world = cached_town(0, 160)
    rng = np.random.default_rng(0)
    poses = plan_session(config.sessions[0], config, config.photo_camera(), world, rng)
    aims = read_plan(path, ORIGIN, 160, world.terrain.height, -90)
    assert_allclose(camera_centres(poses), aims.centres, atol=1e-9)
    path.write_text(json.dumps(plan_of(waypoint(0, 0, 40))))
    assert SimulateConfig.load(None, fields) != config, "another plan is another configuration"
    with pytest.raises(InputError, match="has changed since"):
        plan_session(config.sessions[0], config, config.photo_camera(), world, rng)
    underground = plan_of(waypoint(0, 0, -5))
    path.write_text(json.dumps(underground))
    with pytest.raises(InputError, match="below the minimum clearance"):
        simulate(SimulateConfig.load(None, fields), tmp_path / "scene")
    with pytest.raises(InputError, match=r"no\.plan"):
        SimulateConfig.load(None, {"sessions": [f"summer-noon:plan={tmp_path}/no.plan"]})
    for file in (None, 3, ["a"]):
        flight = {"kind": "plan", "file": file}
        session = {"condition": "summer-noon", "role": "map", "flight": flight}
        with pytest.raises(InputError, match="file"):
            SimulateConfig.load(None, {"sessions": [session]})
