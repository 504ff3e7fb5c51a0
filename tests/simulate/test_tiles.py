"""Tiled places: tiles join, windows are consistent, and scenes over kilometres are complete."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.checks.validate import validate
from objconnect.scene.errors import InputError
from simulate.camera.pinhole import PinholeCamera
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.look.conditions import condition
from simulate.look.ground_images import bake_ground
from simulate.place.change import Change
from simulate.place.plan import Plan
from simulate.place.plans import ALPINE, FARMLAND, PARK, STREET, SUBURB
from simulate.place.tiles import TiledPlace
from simulate.place.town import TOWN
from simulate.render import window as windows
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import render
from simulate.render.reach import REACH_M
from simulate.render.window import build_window, find_view, move_pose
from simulate.scene_plan import plan_scene
from simulate.tiled_scene import TiledScene
from tests.simulate.blender_checks import check_rays

SIDE_M = 5000.0
CAMERA = PinholeCamera(width=64, height=64, f=55.4, cx=32, cy=32)


@cache
def town() -> TiledPlace:
    """Return a tiled town, built once in a process; no test changes it."""
    return TiledPlace(TOWN, 7, SIDE_M)


def look_down(x: float, y: float, altitude_m: float = 100.0) -> NDArray[np.float64]:
    """Return the pose of a camera that looks straight down, with its top to the north."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [x, y, altitude_m]
    return pose


def look_east(
    x: float, y: float, pitch_deg: float, altitude_m: float = 100.0
) -> NDArray[np.float64]:
    """Return the pose of a camera that looks east, ``pitch_deg`` below the horizon."""
    down = np.radians(pitch_deg)
    ahead = np.array([np.cos(down), 0.0, -np.sin(down)])
    right = np.array([0.0, -1.0, 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ [x, y, altitude_m]
    return pose


@pytest.mark.parametrize("plan", [TOWN, SUBURB, ALPINE], ids=["town", "suburb", "alpine"])
def test_neighbouring_tiles_have_equal_heights_and_roads_on_their_border(plan: Plan) -> None:
    place = TiledPlace(plan, 3, SIDE_M)
    for west, east in (((4, 6), (4, 7)), ((0, 0), (0, 1))):
        one, other = place.tile(west), place.tile(east)
        assert_allclose(one.terrain.nodes[:, -1], other.terrain.nodes[:, 0], atol=1e-9)
        assert_array_equal(one.ground.labels[:, -1], other.ground.labels[:, 0])
        assert (one.ground.labels[:, -1] == CLASSES["road"]).all()
        assert_array_equal(one.ground.tone[:, -1], other.ground.tone[:, 0])
    south, north = place.tile((4, 6)), place.tile((5, 6))
    assert_allclose(south.terrain.nodes[-1], north.terrain.nodes[0], atol=1e-9)
    assert_array_equal(south.ground.labels[-1], north.ground.labels[0])


def test_tiles_are_different_and_do_not_depend_on_order_or_on_others() -> None:
    tile = town().tile((7, 7))
    alone = TiledPlace(TOWN, 7, SIDE_M).tile((7, 7))
    assert_array_equal(tile.ground.labels, alone.ground.labels)
    assert [o.centre.tolist() for o in tile.objects] == [o.centre.tolist() for o in alone.objects]
    other = town().tile((7, 8))
    assert tile.seed != other.seed
    assert (tile.ground.labels != other.ground.labels).mean() > 0.1


def test_objects_of_a_tile_lie_in_it() -> None:
    half = 0.5 * town().tile_m
    for item in town().tile((7, 7)).objects:
        assert np.abs(item.footprint()).max() <= half + 1e-6


def test_an_assembled_world_equals_its_tiles() -> None:
    place = town()
    first = (6, 7)
    tiles = [[place.tile((first[0] + r, first[1] + c)) for c in range(2)] for r in range(2)]
    world = place.assemble(tiles)
    assert world.side_m == pytest.approx(2 * place.tile_m)
    middle = place.window_centre(first, 2)
    rng = np.random.default_rng(0)
    for row in range(2):
        for column in range(2):
            index = (first[0] + row, first[1] + column)
            points = rng.uniform(-0.49, 0.49, (200, 2)) * place.tile_m
            shift = place.centre(index) - middle
            moved, tile = points + shift, place.tile(index)
            expected = tile.terrain.height(*points.T)
            assert_allclose(world.terrain.height(*moved.T), expected, atol=1e-6)
            assert_array_equal(world.ground.label(*moved.T), tile.ground.label(*points.T))
            assert_array_equal(place.index(moved + middle), [index] * len(points))
    assert len(world.objects) == sum(len(tile.objects) for row in tiles for tile in row)


@pytest.mark.parametrize("name", ["summer-noon", "leaffall-noon-flood", "melt-noon"])
def test_the_ground_of_a_tile_looks_the_same_beside_any_neighbours(name: str) -> None:
    place, look = town(), condition(name)
    west, east = (
        place.assemble([[place.tile((7 + r, k + c)) for c in range(2)] for r in range(2)])
        for k in (6, 7)
    )
    n = len(place.tile((7, 7)).ground.labels)
    for one, other in zip(bake_ground(west, look), bake_ground(east, look), strict=True):
        assert_array_equal(one[:, n:], other[:, :n])


@pytest.mark.parametrize(
    ("x", "y"), [(0.0, 0.0), (166.0, 166.0), (-1500.0, 820.0), (2490.0, -2490.0)]
)
def test_the_window_of_a_photograph_holds_all_that_may_light_it(x: float, y: float) -> None:
    place = town()
    view = find_view(place, CAMERA, look_down(x, y), (-5.0, 5.0))
    assert view.side == 3
    centre, half = place.window_centre(view.first, view.side), 0.5 * view.side * place.tile_m
    reach = 100.0 * 32 / 55.4 + REACH_M
    for corner in ((x - reach, y - reach), (x + reach, y + reach)):
        inside = np.clip(corner, -0.5 * SIDE_M, 0.5 * SIDE_M)
        assert (np.abs(inside - centre) <= half + 1e-6).all()
    under = place.index(np.array([x, y]))
    assert tuple(under.tolist()) in view.shown


def test_a_tilted_view_needs_more_tiles_and_shows_those_ahead() -> None:
    place = town()
    view = find_view(place, CAMERA, look_east(10.0, 10.0, 45.0), (-5.0, 5.0))
    assert view.side == 5
    ahead = place.index(np.array([300.0, 10.0]))
    assert tuple(ahead.tolist()) in view.shown
    behind = place.index(np.array([-300.0, 10.0]))
    assert tuple(behind.tolist()) not in view.shown


@pytest.mark.parametrize(("pitch_deg", "altitude_m"), [(5.0, 60.0), (30.0, 40.0), (5.0, 400.0)])
def test_a_view_of_the_horizon_shows_all_tiles_of_its_window_that_lie_ahead(
    pitch_deg: float, altitude_m: float
) -> None:
    place = town()
    pose = look_east(10.0, 10.0, pitch_deg, altitude_m)
    view = find_view(place, CAMERA, pose, (-5.0, 5.0))
    for index in windows.square_of_tiles(view.first, view.side):
        corners = np.array([[a, b] for a in (-1, 1) for b in (-1, 1)]) * 0.5 * place.tile_m
        ground = np.column_stack([place.centre(index) + 0.9 * corners, np.zeros(4)])
        local = ground @ pose[:3, :3].T + pose[:3, 3]
        pixels = CAMERA.f * local[:, :2] / local[:, 2:] + [CAMERA.cx, CAMERA.cy]
        if ((local[:, 2] > 0) & (pixels >= 0).all(1) & (pixels <= 64).all(1)).any():
            assert index in view.shown


def test_a_photograph_of_more_than_a_window_is_refused() -> None:
    find_view(town(), CAMERA, look_down(0.0, 0.0, 900.0), (-5.0, 5.0))
    with pytest.raises(InputError, match=r"it shows ground of 18.. x 18.. m, more than 5 x 5"):
        find_view(town(), CAMERA, look_down(0.0, 0.0, 1600.0), (-5.0, 5.0))


def test_a_flight_under_the_ground_is_refused(tmp_path: Path) -> None:
    flight = {"kind": "corridor", "line": [[0, 0], [60, 0]], "altitude_m": 0.1}
    sessions = [{"condition": "summer-noon", "flight": flight, "role": "map", "frames": 2}]
    config = scene_config(sessions=sessions, position_jitter_m=5.0)
    with pytest.raises(InputError, match="photograph 1 is .* below the minimum clearance"):
        plan_scene(config, tmp_path, None)


def test_heights_of_the_place_are_those_of_its_tiles() -> None:
    place = TiledPlace(PARK, 2, SIDE_M)
    index = (7, 7)
    tile = place.tile(index)
    water = np.argwhere(tile.ground.labels == CLASSES["water"])
    assert len(water)
    texel = tile.ground.texel_m
    points = (water[::500, ::-1] + 0.5 - 0.5 * len(tile.ground.labels)) * texel
    expected = tile.terrain.height(*points.T)
    x, y = (points + place.centre(index)).T
    assert_allclose(place.land().terrain.height(x, y), expected, atol=1e-6)


def test_fields_do_not_reach_over_streets() -> None:
    tile = TiledPlace(FARMLAND, 3, SIDE_M).tile((5, 5))
    half = 0.5 * tile.side_m
    points = np.concatenate([road.line for road in tile.roads])
    points = points[(np.abs(points) < half).all(1)]
    labels = tile.ground.label(*points.T)
    assert np.isin(labels, [CLASSES["road"], CLASSES["path"]]).all()


def test_flights_follow_the_roads_in_the_middle() -> None:
    roads = town().land().roads
    assert len(roads) == 12
    assert max(np.abs(road.line).max() for road in roads) <= 1000.0


def test_every_part_of_an_alpine_place_has_valleys() -> None:
    place = TiledPlace(ALPINE, 3, SIDE_M)
    for index in ((1, 1), (7, 7), (12, 4), (3, 13)):
        rows = [
            place.tile((index[0] + r, index[1] + c)) for r in range(-1, 2) for c in range(-1, 2)
        ]
        assert np.ptp(np.concatenate([tile.terrain.nodes.ravel() for tile in rows])) > 20.0


def scene_config(**options: object) -> SimulateConfig:
    """Return a scene of few small photographs over a tiled town."""
    sessions = [
        {
            "condition": "summer-noon",
            "flight": {"kind": "corridor", "line": [[-40, 0], [400, 60]]},
            "role": "map",
            "frames": 4,
        },
        {
            "condition": "summer-noon",
            "flight": {"kind": "corridor", "line": [[100, 10], [220, 40]]},
            "role": "query",
            "frames": 3,
            "change": {"cars_moved": 0.5, "objects_added": 0.2},
        },
    ]
    values = {"preset": "town", "seed": 7, "area": SIDE_M, "size": 64, "sessions": sessions}
    return SimulateConfig.model_validate(values | options)


def test_ids_denote_the_same_objects_in_the_scene_and_in_every_window(tmp_path: Path) -> None:
    config = scene_config()
    plan = plan_scene(config, tmp_path, None)
    ids = [item.id for item in plan.objects]
    assert ids == sorted(set(ids))
    assert ids[-1] <= windows.MAX_SCENE_ID
    by_id = {item.id: item for item in plan.objects}
    place = TiledPlace(TOWN, config.seed, config.area)
    for session, planned in zip(config.sessions, plan.sessions, strict=True):
        assert sorted(k for w in planned.windows for k in w.frames) == list(
            range(len(planned.poses))
        )
        window = planned.windows[0]
        world = build_window(place, window, session.world_change)
        middle = place.window_centre(window.first, window.side)
        listed = [item for item in world.objects if item.id in by_id]
        assert len(listed) > 500
        for item in listed:
            assert_allclose(item.centre[:2] + middle, by_id[item.id].centre[:2], atol=1e-6)
            assert item.class_name == by_id[item.id].class_name
    moved, added = plan.worlds[1].declared.moved, plan.worlds[1].declared.added
    assert moved
    assert added
    assert {k for pair in moved for k in pair} | set(added) <= by_id.keys()
    assert not plan.worlds[0].declared.moved


def test_planned_flights_keep_clear_of_the_objects_of_tiles() -> None:
    scene = TiledScene(town(), [Change()])
    tile = town().tile((7, 7))
    item = next(o for o in tile.objects if o.class_name == "building")
    inside = item.centre + np.array([*town().centre((7, 7)), 0.0])
    positions = np.stack([inside, inside + np.array([0.0, 0.0, 60.0])])
    assert scene.free_test(0)(positions).tolist() == [False, True]


def test_a_place_too_large_or_of_several_quarters_is_refused() -> None:
    with pytest.raises(InputError, match="area must be at most 20000 m, got 30000"):
        TiledPlace(TOWN, 0, 30_000.0)
    with pytest.raises(InputError, match="a place of several quarters cannot be tiled"):
        TiledPlace(STREET, 0, SIDE_M)


def test_more_objects_than_ids_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulate.tiled_scene.MAX_SCENE_ID", 1000)
    with pytest.raises(InputError, match="the photographs show more than 1000 objects"):
        plan_scene(scene_config(), tmp_path, None)


def test_a_pose_is_moved_to_the_coordinates_of_a_window() -> None:
    pose = look_east(300.0, -20.0, 30.0)
    moved = move_pose(pose, (250.0, -50.0))
    centre = -moved[:3, :3].T @ moved[:3, 3]
    assert_allclose(centre, [50.0, 30.0, 100.0], atol=1e-9)


def corner_job(shift: int = 0) -> RenderJob:
    """Return the job of a photograph over a corner of four tiles.

    Its window lies ``shift`` columns to the east of the one that it would get.
    """
    place, pose = town(), look_down(0.5 * town().tile_m - 5.0, 0.5 * town().tile_m + 10.0)
    scene = TiledScene(place, [Change()])
    ((frame, view),) = scene.find_views("corner", CAMERA, pose[None]).items()
    numbered = scene.number([{frame: view}])
    moved = view._replace(first=(view.first[0], view.first[1] + shift))
    return RenderJob(
        seed=7,
        side_m=SIDE_M,
        condition="winter-dusk",
        camera=CAMERA,
        poses={frame: pose.tolist()},
        windows=numbered.windows(0, {frame: moved}),
        thermal=True,
    )


@pytest.mark.slow
def test_a_photograph_is_the_same_in_two_windows_and_as_exact(tmp_path: Path) -> None:
    frames = []
    for shift in range(2):
        render(corner_job(shift), tmp_path / str(shift))
        with np.load(frame_path(tmp_path / str(shift), 0)) as layers:
            frames.append(dict(layers))
    one, other = frames
    assert len(np.unique(one["instance"])) > 10
    assert_allclose(one["depth"], other["depth"], atol=5e-3)
    assert_array_equal(one["semantic"], other["semantic"])
    assert_array_equal(one["instance"], other["instance"])
    assert np.abs(one["rgb"].astype(float) - other["rgb"]).mean() < 0.3
    # Shade lies on a grid of cells, which differs between windows by less than a cell.
    assert np.percentile(np.abs(one["thermal"] / other["thermal"] - 1), 99) < 0.01
    check_rays(corner_job(), [one], tmp_path)


@pytest.mark.slow
def test_a_scene_over_kilometres_is_complete_and_valid(tmp_path: Path) -> None:
    config = scene_config()
    scene = simulate(config, tmp_path / "scene")
    assert isinstance(scene, Scene)
    report = validate(scene.path)
    assert report.ok, report
    objects = {item.id for item in scene.objects.objects}
    shown = set()
    for name in config.session_names():
        with scene.layers(name) as layers:
            for k in range(len(scene.frames(name))):
                shown |= set(np.unique(layers.read("instance", k)).tolist())
    assert len(shown) > 100
    assert shown - {0} <= objects
