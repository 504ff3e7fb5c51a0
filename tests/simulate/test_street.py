"""The preset street: its surroundings, its kerbs and its default sessions."""

import json
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.datasets.open import open_datasets
from objconnect.scene.bundle.labels import CLASSES
from simulate.config import SimulateConfig
from simulate.flight.gimbal import camera_centres
from simulate.look.conditions import condition
from simulate.look.terrain import ground_mesh, kerbs_mesh
from simulate.place.kerbs import KERB_HEIGHT_M, PavementHeights
from simulate.place.presets import preset
from simulate.place.world import MIRRORED_M, World
from simulate.planner import plan_session

AREA = 300.0


@pytest.fixture(scope="module", params=[1, pytest.param(2, marks=pytest.mark.thorough)])
def street(request: pytest.FixtureRequest) -> World:
    return preset("street")(request.param, AREA)


def lies_inside(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    line = outline.astype(np.float32)
    return np.array([cv2.pointPolygonTest(line, (x, y), False) >= 0 for x, y in points.tolist()])


def test_surroundings_cover_the_place_once(street: World) -> None:
    assert [part.name for part in street.surroundings] == ["urban", "suburban", "park"]
    points = np.random.default_rng(0).uniform(-0.5 * AREA, 0.5 * AREA, (2000, 2))
    inside = np.array([lies_inside(part.outline, points) for part in street.surroundings])
    assert (inside.sum(0) == 1).all()
    assert (inside.mean(1) > 0.15).all()


def test_each_surroundings_hold_what_their_name_says(street: World) -> None:
    urban, suburban, park = (
        [o for o in street.objects if lies_inside(part.outline, o.centre[None, :2])[0]]
        for part in street.surroundings
    )
    fronts, houses = ([o.shape for o in part].count for part in (urban, suburban))
    assert fronts("front") > 15
    assert fronts("house") == 0
    assert houses("house") > 15
    assert houses("front") == 0
    assert not [o for o in park if o.class_name == "building"]
    trees = [sum(o.class_name == "tree" for o in part) for part in (urban, park)]
    assert trees[1] > trees[0]


def test_one_road_leads_through_all_surroundings(street: World) -> None:
    """So that one drive sees them all."""
    through = [
        all(lies_inside(part.outline, road.line).any() for part in street.surroundings)
        for road in street.roads
    ]
    assert sum(through) >= 2


def test_pavements_stand_above_the_carriageways(street: World) -> None:
    assert 0.10 <= KERB_HEIGHT_M <= 0.15
    rises = PavementHeights(street.kerbs)
    on_road = raised = total = 0
    rng = np.random.default_rng(0)
    for road in street.roads:
        for a, b in pairwise(road.line):
            middle, along = 0.5 * (a + b), (b - a) / np.linalg.norm(b - a)
            if np.abs(middle).max() > 0.5 * AREA - 5:
                continue
            across = np.array([-along[1], along[0]])
            lane = middle + rng.uniform(-0.4, 0.4) * road.width_m * across
            on_road += rises.height_at(lane) > 0
            for side in (-1, 1):
                foot = middle + side * (0.5 * road.width_m + 0.8) * across
                if street.ground.label(*foot) == CLASSES["pavement"]:
                    total += 1
                    raised += rises.height_at(foot) > 0.9 * KERB_HEIGHT_M
    assert total > 200
    assert on_road == 0
    assert raised > 0.75 * total  # the rest are corners and dropped kerbs


def test_the_kerbs_mesh_stands_on_the_ground(street: World) -> None:
    mesh = kerbs_mesh(street)
    assert mesh is not None
    above = mesh.vertices[:, 2] - street.terrain.height(*mesh.vertices[:, :2].astype(float).T)
    assert above.max() == pytest.approx(KERB_HEIGHT_M, abs=1e-4)
    assert above.min() < -0.02
    faces = mesh.vertices[mesh.corners.reshape(-1, 4)].astype(float)
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    tops = np.abs(normal[:, 2]) > 0.9 * np.linalg.norm(normal, axis=1)
    assert 0.45 < tops.mean() < 0.55
    assert (mesh.vertices[:, :2].max(0) < 0.5 * AREA + 5).all()


def test_country_goes_on_beyond_the_place(street: World) -> None:
    """No edge of the world: the ground goes on without a step, and hills close the horizon."""
    mesh = ground_mesh(street, condition("summer-noon"))
    grid = mesh.vertices.reshape(round(len(mesh.vertices) ** 0.5), -1, 3).astype(float)
    beyond = np.abs(grid[..., :2]).max(-1) - 0.5 * AREA
    assert beyond.max() > 2000
    slope = np.abs(np.diff(grid[..., 2], axis=1)) / np.diff(grid[..., 0], axis=1)
    assert slope.max() < 0.5
    assert grid[..., 2][beyond > 2000].min() > 15
    far = np.array([0.5 * AREA + MIRRORED_M + 1, 0.0])
    assert street.ground.label(*far) == CLASSES["grass"]


def test_a_place_without_parts_names_none() -> None:
    assert preset("town")(1, 120.0).surroundings == ()


@pytest.fixture(scope="module")
def defaults() -> SimulateConfig:
    return SimulateConfig.load(None, {"preset": "street", "seed": 1, "size": 256})


def test_the_usual_sessions_are_drives_with_two_cameras(defaults: SimulateConfig) -> None:
    assert {session.flight.kind for session in defaults.sessions} == {"street"}
    left, right = (defaults.photo_camera(session) for session in defaults.sessions[:2])
    assert {defaults.photo_camera(session) for session in defaults.sessions} == {left, right}
    assert (left.model, right.model) == ("OPENCV", "OPENCV")
    assert left.params != right.params
    seasons = {s.condition.split("-")[0] for s in defaults.sessions if s.role == "query"}
    assert seasons == {"summer", "winter"}
    assert SimulateConfig.model_validate_json(defaults.model_dump_json()) == defaults


def test_what_is_said_wins_over_the_usual() -> None:
    said = SimulateConfig.load(
        None, {"preset": "street", "sessions": ["snow-noon:street"], "frames": 4, "area": 200}
    )
    assert [s.condition for s in said.sessions] == ["snow-noon"]
    assert (said.frames, said.area, said.sessions[0].camera) == (4, 200, None)
    assert SimulateConfig.load(None, {"preset": "town"}).sessions[0].flight.kind == "nadir"


def test_drives_see_all_surroundings_from_tracks_of_their_own(
    defaults: SimulateConfig,
) -> None:
    world = preset("street")(defaults.seed, defaults.area)
    rng = np.random.default_rng(0)
    map_left, map_right, query_left, _, winter_left, _ = (
        plan_session(session, defaults, defaults.photo_camera(session), world, rng)
        for session in defaults.sessions
    )
    assert_allclose(camera_centres(map_left), camera_centres(map_right))
    looks = (map_left[:, 2, :3] * map_right[:, 2, :3]).sum(1)
    assert_allclose(looks, 0, atol=1e-9)  # a right angle between the cameras
    for poses in (map_left, query_left, winter_left):
        at = camera_centres(poses)
        seen = [lies_inside(part.outline, at[:, :2]).mean() for part in world.surroundings]
        assert min(seen) > 0.12
        assert np.abs(at[:, :2]).max() <= 0.5 * defaults.area - 25
        height = at[:, 2] - world.terrain.height(*at[:, :2].T)
        assert 1.5 <= height.min() <= height.max() <= 2.5
    # Each query has a map photograph that looks where it looks, in a track beside its own.
    for poses in (query_left, winter_left):
        apart = np.linalg.norm(
            camera_centres(poses)[:, None, :2] - camera_centres(map_left)[:, :2], axis=-1
        )
        alike = poses[:, 2, :3] @ map_left[:, 2, :3].T > np.cos(np.radians(20))
        assert np.where(alike, apart, np.inf).min(1).max() < 12
        assert apart.min() > 0.3


@pytest.mark.slow
def test_a_tree_from_one_command_is_localized_in(tmp_path: Path) -> None:
    scene, results = tmp_path / "street", tmp_path / "results"
    config = Path(__file__).parents[2] / "simulate" / "configs" / "street.yaml"
    words = ["simulate", "--config", str(config), "--out", str(scene), "--export", "cmu"]
    made = CliRunner().invoke(app, words)
    assert made.exit_code == 0, made.output
    tree = tmp_path / "street-cmu"
    names = [dataset.name for dataset in open_datasets(tree)]
    assert names == ["cmu-urban-slice2", "cmu-suburban-slice9", "cmu-park-slice18"]
    photograph = next((tree / "slice2" / "query").iterdir())
    with Image.open(photograph) as picture:
        assert picture.size == (400, 300)
    ran = CliRunner().invoke(
        app, ["evaluate", str(tree), "--method", "sift", "--out", str(results)]
    )
    assert ran.exit_code == 0, ran.output
    recall = {
        (name, day): summary["recall"]["5m_10deg"]["value"]
        for name in names
        for day, summary in json.loads((results / name / "sift.json").read_text())[
            "by_condition"
        ].items()
    }
    assert len(recall) == 6
    for name in names[:2]:
        assert recall[name, "2025-07-02"] > 60
