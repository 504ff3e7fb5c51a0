"""Changes of a place: only declared objects differ, and an id always means the same object."""

from __future__ import annotations

import numpy as np
import pytest

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.rectangle import overlap
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.look.props import shape_mesh
from simulate.place.change import (
    LOOSE,
    VEHICLES,
    Change,
    change_world,
    change_worlds,
    list_objects,
)
from simulate.place.kerbs import PavementHeights
from simulate.place.world import MAX_OBJECT_ID, World
from tests.simulate.towns import cached_town

LARGE_CHANGE = Change(cars_moved=0.5, objects_removed=0.2, objects_added=0.3, bare_trees=True)


@pytest.fixture(scope="module")
def town() -> World:
    return cached_town(5, 120)


def test_what_is_not_declared_stays(town: World) -> None:
    changed = change_world(town, LARGE_CHANGE)
    declared, before = changed.declared, {o.id: o for o in town.objects}
    after = {o.id: o for o in changed.world.objects}
    assert len(after) == len(changed.world.objects)
    moved = dict(declared.moved)
    assert before.keys() - after.keys() == {*declared.removed, *moved}
    assert after.keys() - before.keys() == {*declared.added, *moved.values()}
    for number in before.keys() & after.keys():
        if number in declared.bare:
            assert before[number].shape.startswith("broadleaf")
            assert after[number].shape.startswith("bare")
            assert np.array_equal(before[number].size, after[number].size)
        else:
            assert before[number] is after[number]
    for old, new in declared.moved:
        a, b = before[old], after[new]
        assert (a.class_name, a.shape, a.colour) == (b.class_name, b.shape, b.colour)
        assert not overlap(a.footprint(), b.footprint())
    assert changed.world.ground is town.ground


def test_shares_are_kept(town: World) -> None:
    loose = [o for o in town.objects if o.class_name in LOOSE]
    vehicles = [o for o in loose if o.class_name in VEHICLES]
    declared = change_world(town, Change(objects_removed=0.25)).declared
    assert len(declared.removed) == round(0.25 * len(loose))
    assert not (declared.moved or declared.added or declared.bare)
    declared = change_world(town, Change(cars_moved=0.3)).declared
    assert 0.8 * 0.3 * len(vehicles) < len(declared.moved) <= round(0.3 * len(vehicles))
    assert {old for old, _ in declared.moved} <= {o.id for o in vehicles}
    assert change_world(town, Change()).world.objects == town.objects


def test_new_places_are_free_and_on_the_ground(town: World) -> None:
    changed = change_world(town, LARGE_CHANGE)
    items = changed.world.objects
    new = {*changed.declared.added, *(number for _, number in changed.declared.moved)}
    assert len(new) > 15
    rises = PavementHeights(town.kerbs)
    for item in items:
        if item.id in new:
            box = item.footprint()
            assert np.abs(box).max() <= 0.5 * town.side_m
            base = item.centre[2] - 0.5 * item.size[2]
            at = item.centre[:2]
            assert base == pytest.approx(float(town.terrain.height(*at)) + rises.height_at(at))
            assert not any(overlap(box, o.footprint()) for o in items if o is not item)


def test_an_id_means_one_object_in_every_session(town: World) -> None:
    other = LARGE_CHANGE.model_copy(update={"seed": 1})
    none, first, again, second = change_worlds(town, [Change(), LARGE_CHANGE, LARGE_CHANGE, other])
    assert first is again
    assert none.world.objects == town.objects
    new = [{o.id for o in w.world.objects} - {o.id for o in town.objects} for w in (first, second)]
    assert new[0] and new[1] and not new[0] & new[1]
    assert max(new[1]) <= MAX_OBJECT_ID
    listed = [o.id for o in list_objects(town, [none, first, second])]
    assert listed == sorted({o.id for o in town.objects} | new[0] | new[1])
    # A renderer that is told the change and the first id makes the same world.
    told = change_world(town, other, second.first_new_id)
    assert told.declared == second.declared
    for a, b in zip(told.world.objects, second.world.objects, strict=True):
        assert (a.id, a.shape, a.yaw, *a.centre) == (b.id, b.shape, b.yaw, *b.centre)


def test_too_many_objects_are_refused(town: World) -> None:
    with pytest.raises(InputError, match="more than 32767 objects: lower cars_moved"):
        change_world(town, LARGE_CHANGE, MAX_OBJECT_ID)


def test_bare_trees_fill_the_box_of_the_tree() -> None:
    vertices = shape_mesh("bare_2").vertices
    assert np.allclose([vertices.min(0), vertices.max(0)], [[-0.5] * 3, [0.5] * 3], atol=1e-5)


def test_a_share_is_a_share() -> None:
    session = {"condition": "summer-noon", "flight": "nadir", "role": "map"}
    with pytest.raises(InputError, match=r"'sessions.0.change.cars_moved'"):
        SimulateConfig.load(None, {"sessions": [{**session, "change": {"cars_moved": 1.5}}]})


@pytest.fixture(scope="module")
def two_sessions(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The same poses over the place as built, and over it changed and leafless in the rain."""
    changed = "leafoff-dusk-wet:oblique:map:cars_moved=0.4,objects_removed=0.2,objects_added=0.3"
    config = SimulateConfig.model_validate(
        {
            "seed": 5, "area": 120, "size": 160, "spp": 1, "frames": 2,
            "position_jitter_m": 0, "attitude_jitter_deg": 0,
            "sessions": ["summer-noon:oblique:map", changed],
        }
    )  # fmt: skip
    path = tmp_path_factory.mktemp("changed") / "scene"
    simulate(config, path)
    return Scene.open(path)


@pytest.mark.thorough
def test_pixels_differ_only_where_the_manifest_declares_it(two_sessions: Scene) -> None:
    """Every layer, bit for bit: whatever pixel differs shows an object of the change record."""
    scene = two_sessions
    ids = [item.id for item in scene.objects.objects]
    assert len(set(ids)) == len(ids)
    seen = dict.fromkeys(("gone", "new", "bare"), 0)
    (before, as_built), (after, session) = scene.sessions.items()
    assert not any(as_built.change.model_dump().values())
    declared = session.change
    named = {
        "gone": [*declared.removed, *(old for old, _ in declared.moved)],
        "new": [*declared.added, *(new for _, new in declared.moved)],
        "bare": [*declared.bare],
    }
    assert {number for part in named.values() for number in part} <= set(ids)
    poses = [scene.frames(name).cam_from_world for name in (before, after)]
    assert np.array_equal(*poses)
    with scene.layers(before) as a, scene.layers(after) as b:
        for k in range(len(poses[0])):
            was, now = a.read("instance", k), b.read("instance", k)
            assert not np.isin(now, named["gone"]).any()
            assert not np.isin(was, named["new"]).any()
            shown = {
                "gone": np.isin(was, named["gone"]),
                "new": np.isin(now, named["new"]),
                "bare": np.isin(was, named["bare"]) | np.isin(now, named["bare"]),
            }
            differs = was != now
            for layer in ("depth", "semantic", "normal"):
                unlike = a.read(layer, k) != b.read(layer, k)
                differs |= unlike.any(-1) if unlike.ndim == 3 else unlike
            assert not (differs & ~(shown["gone"] | shown["new"] | shown["bare"])).any()
            apart = np.abs(a.read("depth", k) - b.read("depth", k)) > 0.3
            for part, where in shown.items():
                seen[part] += int((apart & where).sum())
    assert min(seen.values()) > 20, seen  # and what is declared is there to see


@pytest.mark.thorough
def test_what_is_declared_is_all_that_was_rendered_elsewhere(two_sessions: Scene) -> None:
    """Depth lifted to the world: what is new stands in its own box of objects.json."""
    scene = two_sessions
    session = "leafoff-dusk-wet-oblique-map"
    declared = scene.sessions[session].change
    boxes = {item.id: item for item in scene.objects.objects}
    frames = scene.frames(session)
    checked = 0
    with scene.layers(session) as dense:
        for k, pose in enumerate(frames.cam_from_world):
            instance, depth = dense.read("instance", k), dense.read("depth", k)
            fx, fy, cx, cy = frames.cameras[k].params
            rows, columns = np.nonzero(np.isin(instance, [new for _, new in declared.moved]))
            z = depth[rows, columns]
            seen = np.stack([(columns + 0.5 - cx) / fx * z, (rows + 0.5 - cy) / fy * z, z], -1)
            world = (seen - pose[:3, 3]) @ pose[:3, :3]
            for number in np.unique(instance[rows, columns]).tolist():
                mine, box = world[instance[rows, columns] == number], boxes[number]
                turn = np.radians(box.yaw_deg)
                ahead = np.array([np.cos(turn), np.sin(turn), 0])
                axes = np.stack([ahead, [-ahead[1], ahead[0], 0], [0, 0, 1]])
                local = (mine - box.centre) @ axes.T
                assert (np.abs(local) <= 0.5 * np.array(box.size) + 0.01).all()
                checked += 1
    assert checked > 2


def test_a_session_in_words_declares_its_change() -> None:
    words = ["summer-noon:nadir", "snow-dusk:oblique:cars_moved=0.3,bare_trees=true",
             "snow-noon:grid:query:objects_removed=0.1,seed=2"]  # fmt: skip
    first, second, third = SimulateConfig.load(None, {"sessions": words}).sessions
    assert (first.role, first.change) == ("map", Change())
    assert (second.role, second.change) == ("query", Change(cars_moved=0.3, bare_trees=True))
    assert (third.flight.kind, third.role) == ("grid", "query")
    assert third.change == Change(objects_removed=0.1, seed=2)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("cars_moved=2", "'sessions.1.change.cars_moved'"),
        ("cars_gone=0.2", "unknown key 'sessions.1.change.cars_gone'"),
        ("cars_moved=0.2,bare_trees", "a change is written NAME=VALUE"),
        ("cars_moved=much", "'sessions.1.change.cars_moved'"),
    ],
)
def test_a_mistaken_change_is_refused(word: str, message: str) -> None:
    words = ["summer-noon:nadir", f"snow-noon:nadir:{word}"]
    with pytest.raises(InputError, match=message) as caught:
        SimulateConfig.load(None, {"sessions": words})
    assert "\n" not in str(caught.value)
