"""Flat ground, seen from places for which everything can be computed by hand."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from benchmark.tracks.difficulty import (
    Difficulty,
    QueryRow,
    View,
    compare,
    days_between,
    ground_plane_depth,
    measure,
    write_queries,
)
from objconnect.scene.bundle.covisibility import surface_points, write_covisibility
from objconnect.scene.bundle.frames import Frames, write_frames
from objconnect.scene.bundle.manifest import (
    Manifest,
    Objects,
    Session,
    Splits,
    Surroundings,
    write_json,
)
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from simulate.annotations import measure_covisibility

# This camera sees 40 x 30 m of flat ground from 40 m.
CAMERA = Camera("PINHOLE", 80, 60, (80.0, 80.0, 40.0, 30.0))
# All lines of sight of this one are parallel within half a degree.
NARROW = Camera("PINHOLE", 80, 60, (8000.0, 8000.0, 40.0, 30.0))


def moment(year: int, month: int, day: int) -> float:
    return datetime(year, month, day, 12, tzinfo=UTC).timestamp()


def looking(centre: Sequence[float], tilt_deg: float = 0.0) -> np.ndarray:
    """A camera that looks down, tilted to the north."""
    angle = math.radians(tilt_deg)
    forward = np.array([0.0, math.sin(angle), -math.cos(angle)])
    right = np.array([1.0, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(centre, float)
    return pose


def narrow(centre: Sequence[float], tilt_deg: float = 0.0) -> View:
    return View(NARROW, looking(centre, tilt_deg), 0.0)


@pytest.mark.parametrize(
    ("query", "scale", "angle"),
    [
        (narrow((0, 0, 40)), 1.0, 0.0),
        # Twice as high: a pixel is twice as wide.
        (narrow((0, 0, 80)), 2.0, 0.0),
        (narrow((0, 0, 20)), 0.5, 0.0),
        # From 30 m further south it looks to the same place over 50 m: 3, 4 and 5 are a triangle.
        (narrow((0, -30, 40), math.degrees(math.atan(0.75))), 1.25, math.degrees(math.atan(0.75))),
    ],
)
def test_two_views_of_one_point_have_a_known_scale_and_angle(
    query: View, scale: float, angle: float
) -> None:
    ground = np.random.default_rng(0).uniform(-0.1, 0.1, (200, 3)) * [1, 1, 0]
    depth = np.full((60, 80), 40.0, np.float32)
    pair = compare(query, narrow((0, 0, 40)), ground, depth)
    assert pair is not None
    assert pair[0] == pytest.approx(scale, rel=2e-3)
    assert pair[1] == pytest.approx(angle, abs=0.15)


def test_level_ground_lies_at_its_height() -> None:
    view = narrow((3, -30, 40), 35.0)
    depth = ground_plane_depth(view, 5.0)
    points = surface_points(view.camera, view.cam_from_world, depth)
    assert np.allclose(points[:, 2], 5.0, atol=1e-4)
    up = narrow((0, 0, 40), 180.0)
    assert not ground_plane_depth(up, 5.0).any(), "the sky"


def test_the_scale_depends_on_the_focal_length() -> None:
    """A lens twice as long from twice as far shows the same."""
    tele = View(Camera("PINHOLE", 80, 60, (160.0, 160.0, 40.0, 30.0)), looking((0, 0, 80)), 0.0)
    ground = np.array([[1.0, 2.0, 0.0], [np.nan] * 3])
    depth = np.full((60, 80), 40.0, np.float32)
    pair = compare(tele, View(CAMERA, looking((0, 0, 40)), 0.0), ground, depth)
    assert pair is not None
    assert pair[0] == pytest.approx(1.0)


def test_hidden_and_missing_points_are_not_compared() -> None:
    photograph = View(CAMERA, looking((0, 0, 40)), 0.0)
    roof = np.full((60, 80), 30.0, np.float32)
    assert compare(photograph, photograph, np.zeros((1, 3)), roof) is None
    assert compare(photograph, photograph, np.full((4, 3), np.nan), roof) is None


@pytest.mark.parametrize(
    ("one", "other", "days"),
    [
        (moment(2026, 6, 1), moment(2026, 6, 1), 0),
        (moment(2026, 6, 1), moment(2024, 6, 3), 3),  # a leap year has one day more before
        (moment(2026, 6, 1), moment(2026, 1, 1), 151),
        (moment(2026, 12, 31), moment(2026, 1, 1), 1),
        (moment(2026, 1, 1), moment(2026, 7, 2), 182),
        (moment(2026, 1, 1), moment(2026, 7, 4), 181),
        (math.nan, moment(2026, 7, 4), None),
    ],
)
def test_days_wrap_around_the_year(one: float, other: float, days: int | None) -> None:
    assert days_between(one, other) == days_between(other, one) == days


def write_session(
    root: Path, name: str, centres: Sequence[Sequence[float]], time: float, sky: bool = False
) -> tuple[str, ...]:
    names = tuple(f"{name}/images/{k:06d}.jpg" for k in range(len(centres)))
    depths = [np.full((60, 80), centre[2], np.float32) for centre in centres]
    for depth in depths:
        depth[: 30 if sky else 0] = 0
    n = len(names)
    frames = Frames(
        names=names,
        cameras=(CAMERA,) * n,
        cam_from_world=np.stack([looking(centre) for centre in centres]),
        time=np.full(n, time),
        gps_prior=np.full((n, 3), np.nan),
        gps_sigma=np.full((n, 3), np.nan),
        attitude_prior=np.full((n, 4), np.nan),
        attitude_sigma_deg=np.full(n, np.nan),
    )
    (root / "sessions" / name).mkdir(parents=True)
    layers = iter([{"depth": depth} for depth in depths])
    write_frames(root / "sessions" / name / "frames.h5", frames, ("depth",), layers)  # type: ignore[arg-type]
    return names


def write_place(root: Path, parts: tuple[Surroundings, ...] = ()) -> Scene:
    """Flat ground: a map of two photographs 10 m apart, and queries that are easy to judge."""
    mapped = write_session(root, "map", [(0, 0, 40), (10, 0, 40)], moment(2026, 6, 1))
    queries = {
        "snow": write_session(
            root, "snow", [(-2, 0, 40), (0, 0, 80), (500, 0, 40)], moment(2026, 1, 1)
        ),
        "sky": write_session(root, "sky", [(10, 0, 40)], moment(2026, 6, 1), sky=True),
    }
    write_json(root / "splits.json", Splits(map=mapped, queries=queries))
    write_json(root / "objects.json", Objects(classes={}, objects=(), surroundings=parts))
    sessions = {
        name: Session(condition=condition, flight="free", role=role)
        for name, condition, role in (
            ("map", "summer-noon", "map"),
            ("snow", "snow-noon", "query"),
            ("sky", "summer-noon", "query"),
        )
    }
    manifest = Manifest(
        versions={},
        preset="park",
        seed=1,
        config={},
        origin=Geodetic(47, 8, 400),
        sessions=sessions,
        sha256={},
    )
    write_covisibility(root / "covisibility.h5", measure_covisibility(Scene(root, manifest)))
    return finish_scene(root, manifest)


def test_every_query_of_a_scene_has_a_difficulty(tmp_path: Path) -> None:
    rows = measure(write_place(tmp_path / "park-1"))
    assert [row.name for row in rows] == [
        *(f"snow/images/{k:06d}.jpg" for k in range(3)),
        "sky/images/000000.jpg",
    ]
    assert {row.part for row in rows} == {"park"}
    assert [(row.condition, row.flight) for row in rows[2:]] == [
        ("snow-noon", "snow"),
        ("summer-noon", "sky"),
    ]
    beside, above, nowhere, sky = (row.difficulty for row in rows)
    # 2 m of 40 lie outside, which is one of the sixteen columns of points, 2.5 m apart.
    assert beside.overlap == pytest.approx(15 / 16)
    assert beside.scale == pytest.approx(1.0)
    # From 40 m, 2 m aside are at most atan(2 / 40) = 2.86 degrees, and less to the sides.
    assert beside.angle_deg == pytest.approx(2.5, abs=0.36)
    assert beside.days == 151
    # Its photograph covers a quarter, and the points nearest to the edge may fall outside.
    assert above.overlap == pytest.approx(0.25, abs=0.01)
    assert above.scale == pytest.approx(2.0)
    assert nowhere == Difficulty(0.0, None, None, None)
    # Half of it is sky; what is below is the second photograph's, from the same place.
    assert sky.overlap == pytest.approx(0.5)
    assert sky.scale == pytest.approx(1.0)
    assert sky.angle_deg == pytest.approx(0.0, abs=1e-3)
    assert sky.days == 0


def test_a_street_has_parts(tmp_path: Path) -> None:
    def strip(name: str, west: float, east: float) -> Surroundings:
        corners = ((west, -50.0), (east, -50.0), (east, 50.0), (west, 50.0))
        return Surroundings(name=name, outline=corners)

    parts = (strip("urban", -50, -1), strip("suburban", -1, 50))
    rows = measure(write_place(tmp_path / "street-1", parts))
    # Beyond all parts there is only the kind of the place.
    assert [row.part for row in rows] == ["urban", "suburban", "park", "suburban"]


def test_a_contradicting_scene_is_refused(tmp_path: Path) -> None:
    scene = write_place(tmp_path / "park-1")
    splits = scene.splits.model_copy(update={"map": ("map/images/000009.jpg",)})
    write_json(scene.path / "splits.json", splits)
    with pytest.raises(InputError, match="000009.jpg in splits.json is not a frame"):
        measure(Scene.open(scene.path))


def test_the_table_has_a_row_for_each_query(tmp_path: Path) -> None:
    rows = [
        QueryRow("a,b.jpg", "snow-noon", "snow", "park", Difficulty(0.51249, 1.5, 20.04, 151)),
        QueryRow("c.jpg", "snow-noon", "snow", "park", Difficulty(0.0, None, None, None)),
    ]
    write_queries(tmp_path / "queries" / "park-1.csv", rows)
    with (tmp_path / "queries" / "park-1.csv").open(newline="") as file:
        back = list(csv.reader(file))
    assert back == [
        ["name", "condition", "flight", "part", "overlap", "scale", "angle_deg", "days"],
        ["a,b.jpg", "snow-noon", "snow", "park", "0.512", "1.500", "20.0", "151"],
        ["c.jpg", "snow-noon", "snow", "park", "0.000", "", "", ""],
    ]
