"""Random legal plans: the reader finds the photographs, or names a command that it cannot follow.

Each plan is written from a flight whose photographs are computed here, on straight lines in time
and distance, without the reader's own steps.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from simulate.flight.qgroundcontrol import read_plan

Array = NDArray[np.float64]
Item = dict[str, Any]

ORIGIN = Geodetic(47.0, 8.0, 450.0)
GEOID_M = 48.0
PLANS = 350


def hills(x: Any, y: Any) -> Any:
    return 4 * np.sin(np.asarray(x) / 40) + 3 * np.cos(np.asarray(y) / 25)


@dataclass
class Truth:
    """A flight and its photographs.

    Attributes:
        items: What the plan says.
        faults: Commands that the plan may be refused for, by number.
        shots: Position, heading and pitch of each photograph.
    """

    items: list[Item] = field(default_factory=list)
    faults: set[int] = field(default_factory=set)
    shots: list[tuple[Array, float, float]] = field(default_factory=list)


class Flight:
    """Writes a plan, one command after the other, beside what it photographs."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.truth = rng, Truth()
        self.autopilot = int(rng.choice([3, 12]))
        self.hover_m_s = float(rng.uniform(3, 9))
        self.speed = self.hover_m_s
        self.home = np.array([*rng.uniform(-20, 20, 2), 0.0])
        self.home[2] = hills(*self.home[:2])
        self.at = self.home
        self.nose, self.aim = 0.0, ("angles", -90.0, 0.0, False)

    def say(self, number: int, *params: float | None, frame: int = 2, mode: Any = None) -> None:
        params = (*params, *[0.0] * (7 - len(params)))
        known: Item = {"command": number, "frame": frame, "doJumpId": len(self.truth.items) + 1}
        if mode is not None:
            known |= {"AltitudeMode": mode, "Altitude": params[6], "AMSLAltAboveTerrain": None}
        match int(self.rng.integers(4)):
            case 0:
                known |= {"type": "SimpleItem", "params": params[:4], "coordinate": params[4:]}
            case 1:
                known |= {f"param{k + 1}": params[k] for k in range(4)}
                known |= {"type": "missionItem", "coordinate": params[4:]}
            case _:
                known |= {"type": "SimpleItem", "params": params}
        self.truth.items.append(known | {"autoContinue": True})

    def coordinates(self, place: Array) -> tuple[tuple[float, float, float], int, int]:
        """Return latitude, longitude and height of a place in a random reference."""
        latitude, longitude, _ = geodetic_from_enu(np.array([*place[:2], 0.0]), ORIGIN)
        reference = int(self.rng.integers(3))
        base = [ORIGIN.altitude - GEOID_M, -self.home[2], -hills(*place[:2])][reference]
        frame = [(0, 5), (3, 6), (10, 11)][reference][int(self.rng.integers(2))]
        return (latitude, longitude, place[2] + base), frame, [2, 1, 4][reference]

    def photograph(self, place: Array, towards: Array | None = None) -> None:
        kind, *told = self.aim
        heading, pitch = 0.0, 0.0
        if kind == "angles":
            pitch, yaw, locked = told
            heading = yaw if locked else self.nose + yaw
        else:
            way = told[0] - place if kind == "region" else towards
            assert way is not None
            heading = np.degrees(np.arctan2(way[0], way[1]))
            pitch = np.degrees(np.arctan2(way[2], np.hypot(way[0], way[1])))
            if kind == "next":
                pitch, heading = pitch + told[0], heading + told[1]
        self.truth.shots.append((place, heading, pitch))

    def wait(self, place: Array, time_s: float, left: Array) -> None:
        """Say a random condition that is met at a place on the way."""
        match int(self.rng.integers(3)):
            case 0:
                self.say(112, time_s)
            case 1:
                self.say(114, float(np.hypot(*left[:2])))
            case 2:
                aside = np.array([left[1], -left[0], 0.0]) / np.hypot(*left[:2])
                told, frame, _ = self.coordinates(place + self.rng.uniform(-5, 5) * aside)
                self.say(4501, 0, 1, 0, 0, *told, frame=frame)

    def fly(self, to: Array, hold_s: float, yaw: float | None, release: tuple[str, float]) -> None:
        """Go to a waypoint, with photographs from where the aircraft is to there."""
        place, frame, mode = self.coordinates(to)
        told = mode if self.rng.random() < 0.6 else None
        start, way = self.at, to - self.at
        length = float(np.linalg.norm(way))
        kind, every = release
        share = self.rng.uniform(0.1, 0.9)
        if kind == "on the way":
            self.wait(start + share * way, share * length / self.speed, (1 - share) * way)
            self.say(203, None, 0, 0, 0, 1)
        if kind == "at once":
            self.photograph(start, way)
        if kind in ("distance", "interval", "cycle") and self.truth.items:
            self.photograph(start, way)
        self.say(16, hold_s, 0, 0, yaw, *place, frame=frame, mode=told)
        self.nose = np.degrees(np.arctan2(way[0], way[1]))
        if yaw is not None and self.autopilot == 12:
            self.nose = yaw
        times = {"distance": every, "interval": every * self.speed, "cycle": every * self.speed}
        step = times.get(kind, np.inf)
        flown = step
        if kind == "on the way":
            step = np.inf
            flown = share * length
        while flown < length:
            share = flown / length
            here = start + share * way
            if mode == 4:  # above the ground all along
                over = [end[2] - hills(*end[:2]) for end in (start, to)]
                here[2] = hills(*here[:2]) + (1 - share) * over[0] + share * over[1]
            self.photograph(here, to - here)
            flown += step
        if kind in ("interval", "cycle"):
            waited = (flown - length) / self.speed
            while waited < hold_s:
                self.photograph(to, way)
                waited += every
        self.at = to
        if kind == "waypoints":
            self.photograph(to, way)


def draw_position(rng: np.random.Generator) -> Array:
    east, north = rng.uniform(-90, 90, 2)
    return np.array([east, north, hills(east, north) + rng.uniform(25, 90)])


def point_camera(flight: Flight) -> None:
    """Say a random command that points the camera."""
    rng = flight.rng
    pitch, yaw = float(rng.uniform(-90, 0)), float(rng.uniform(-170, 170))
    match int(rng.integers(7)):
        case 0:
            flight.say(205, pitch, 0, yaw, 0, 0, 0, 2)
            flight.aim = ("angles", pitch, yaw, False)
        case 1:
            flight.say(1000, pitch, yaw, None, None, [0, 32][int(rng.integers(2))])
            flight.aim = ("angles", pitch, yaw, False)
        case 2:
            flight.say(1000, pitch, yaw, None, 0, [16, 80][int(rng.integers(2))])
            flight.aim = ("angles", pitch, yaw, True)
        case 3 | 4:
            region = draw_position(rng) - [0, 0, 40]
            place, frame, _ = flight.coordinates(region)
            if rng.random() < 0.5:
                flight.say(195, 0, 0, 0, 0, *place, frame=frame)
            else:
                flight.say(int(rng.choice([201, 80])), 3, 0, 0, 0, *place, frame=frame)
            flight.aim = ("region", region)
        case 5:
            flight.say(196, 0, 0, 0, 0, pitch / 4, 0, yaw)
            flight.aim = ("next", pitch / 4, yaw)
        case 6 if flight.aim[0] != "angles":
            flight.say(197)
            flight.aim = ("angles", -90.0, 0.0, False)


def release_camera(flight: Flight, kind: str) -> tuple[str, float]:
    """Say how the camera is released from here on."""
    rng = flight.rng
    every = float(rng.uniform(1.1, 4.3))
    match kind:
        case "at once" if rng.random() < 0.5:
            flight.say(203, None, 0, 0, 0, 1)
        case "at once":
            flight.say(2000, 0, None, 1, 0, None, None, None)
        case "distance":
            every *= 5
            flight.say(206, every, 0, 1)
        case "interval":
            flight.say(2000, 0, every, 0)
        case "cycle":
            flight.say(214, 1000 * every, -1)
    return kind, every


def stop_camera(flight: Flight, kind: str) -> None:
    match kind:
        case "distance":
            flight.say(206, 0, 0, 0)
        case "interval":
            flight.say(2001)
        case "cycle":
            flight.say(2003, 0, 0, 0)


HARMLESS = (189, 200, 207, 530, 2500, 2501, 1001)
# Commands that move the aircraft or the camera, and are not followed.
UNSUPPORTED = (
    *((17, (0, 0, 0, 0)), (30, (0,)), (34, (20, 5)), (113, (1,)), (186, (50,)), (192, (5,))),
    *((198, (1,)), (220, (1,)), (260, (10, 0, 0, 3, 20, -60)), (2800, (1,)), (42702, (1,))),
    *((12345, ()), (177, (2, -1)), (205, (0, 0, 0, 0, 0, 0, 3)), (1000, (0, 0, 0, 0, 2))),
    *((2000, (0, 0, 5)), (206, (None,)), (214, (None,)), (203, (0, 0, 0, 0, None)), (601, (9, 1))),
    *((178, (1, None)), (178, (9, 5)), (195, (0, 0, 0, 0, None, 8.0, 0)), (112, (-3,))),
)


KINDS = ("waypoints", "at once", "on the way", "distance", "interval", "cycle")


def make_plan(seed: int) -> Flight:
    """Return a random flight; with one chance in three, one of its commands cannot be followed."""
    rng = np.random.default_rng(seed)
    flight = Flight(rng)
    kind = str(rng.choice(KINDS))
    if rng.random() < 0.5:
        flight.speed = float(rng.uniform(4, 12))
        flight.say(178, int(rng.integers(2)), flight.speed, -1)
    flight.fly(draw_position(rng), 0.0, None, ("waypoints" if kind == "waypoints" else "none", 0.0))
    odd = int(rng.integers(1, 4)) if rng.random() < 0.33 else None
    for row in range(int(rng.integers(1, 5))):
        if rng.random() < 0.6:
            point_camera(flight)
        if rng.random() < 0.3:
            flight.say(int(rng.choice(HARMLESS)))
        if row == odd:
            number, params = UNSUPPORTED[int(rng.integers(len(UNSUPPORTED)))]
            flight.truth.faults.add(number)
            flight.say(number, *params)
        elif rng.random() < 0.2:
            flight.say(178, 1, -1, -1)
        release = release_camera(flight, kind)
        yaw = float(rng.uniform(-180, 180)) if rng.random() < 0.3 else None
        hold_s = float(rng.uniform(0, 9)) if rng.random() < 0.4 else 0.0
        flight.fly(draw_position(rng), hold_s, yaw, release)
        stop_camera(flight, kind)
    if rng.random() < 0.5:
        flight.say(20)
    return flight


def write_plan(flight: Flight, path: Path) -> Path:
    latitude, longitude, _ = geodetic_from_enu(np.array([*flight.home[:2], 0.0]), ORIGIN)
    items = flight.truth.items
    if flight.rng.random() < 0.3:  # a survey that QGroundControl saved with its items
        first, last = sorted(int(row) for row in flight.rng.integers(0, len(items), 2))
        survey: Item = {"type": "ComplexItem", "complexItemType": "survey", "version": 5}
        survey["TransectStyleComplexItem"] = {"Items": items[first : last + 1], "version": 2}
        items = [*items[:first], survey, *items[last + 1 :]]
    mission = {
        "cruiseSpeed": 15,
        "firmwareType": flight.autopilot,
        "hoverSpeed": flight.hover_m_s,
        "items": items,
        "plannedHomePosition": [latitude, longitude, None],
        "vehicleType": 2,
        "version": 2,
    }
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission, "version": 1}))
    return path


def test_the_truth_or_the_name_of_a_command(tmp_path: Path) -> None:
    found = refused = 0
    for seed in range(PLANS):
        flight = make_plan(seed)
        truth, path = flight.truth, write_plan(flight, tmp_path / "a.plan")
        try:
            aims = read_plan(path, ORIGIN, 200.0, hills, -90.0, GEOID_M)
        except InputError as error:
            assert truth.faults, (seed, str(error))
            named = {int(number) for number in re.findall(r"\((\d+), ", str(error))}
            assert named & truth.faults, (seed, str(error), truth.faults)
            refused += 1
            continue
        assert truth.faults <= {112, 205, 1000}, (seed, truth.faults)  # these may be without effect
        places, heading, pitch = (np.array(part) for part in zip(*truth.shots, strict=True))
        assert len(aims.centres) == len(places), seed
        assert_allclose(aims.centres, places, atol=0.02, err_msg=str(seed))
        off = (np.degrees(aims.heading) - heading + 180) % 360 - 180
        assert_allclose(off, 0, atol=0.2, err_msg=str(seed))
        assert_allclose(np.degrees(aims.pitch), pitch, atol=0.2, err_msg=str(seed))
        found += 1
    assert found > 0.6 * PLANS
    assert refused > 0.1 * PLANS


def test_a_wrong_truth_is_noticed(tmp_path: Path) -> None:
    flight = make_plan(0)
    flight.truth.items[0]["frame"] = 3 if flight.truth.items[0]["frame"] != 3 else 10
    with pytest.raises((AssertionError, InputError)):
        aims = read_plan(write_plan(flight, tmp_path / "a.plan"), ORIGIN, 200.0, hills, -90.0)
        assert_allclose(aims.centres, np.array([shot[0] for shot in flight.truth.shots]), atol=0.02)
