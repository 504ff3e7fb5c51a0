"""Declared change: only what is declared differs, and an id means one thing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scene.bundle import Scene
from scene.errors import InputError
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.look.props import shape_mesh
from simulate.place.change import (
    LOOSE,
    VEHICLES,
    Change,
    changed_world,
    changed_worlds,
    every_object,
)
from simulate.place.kerbs import Rises
from simulate.place.town import build_town
from simulate.place.world import MAX_OBJECT_ID, World, overlap

MUCH = Change(cars_moved=0.5, objects_removed=0.2, objects_added=0.3, bare_trees=True)


@pytest.fixture(scope="module")
def town() -> World:
    return build_town(5, 120)


def test_what_is_not_declared_stays(town: World) -> None:
    changed = changed_world(town, MUCH)
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
    declared = changed_world(town, Change(objects_removed=0.25)).declared
    assert len(declared.removed) == round(0.25 * len(loose))
    assert not (declared.moved or declared.added or declared.bare)
    declared = changed_world(town, Change(cars_moved=0.3)).declared
    assert 0.8 * 0.3 * len(vehicles) < len(declared.moved) <= round(0.3 * len(vehicles))
    assert {old for old, _ in declared.moved} <= {o.id for o in vehicles}
    assert changed_world(town, Change()).world.objects == town.objects


def test_new_places_are_free_and_on_the_ground(town: World) -> None:
    changed = changed_world(town, MUCH)
    things = changed.world.objects
    new = {*changed.declared.added, *(number for _, number in changed.declared.moved)}
    assert len(new) > 15
    rises = Rises(town.kerbs)
    for thing in things:
        if thing.id in new:
            box = thing.footprint()
            assert np.abs(box).max() <= 0.5 * town.area_m
            base = thing.centre[2] - 0.5 * thing.size[2]
            at = thing.centre[:2]
            assert base == pytest.approx(float(town.terrain.height(*at)) + rises.at(at))
            assert not any(overlap(box, o.footprint()) for o in things if o is not thing)


def test_an_id_means_one_object_in_every_session(town: World) -> None:
    other = MUCH.model_copy(update={"seed": 1})
    none, first, again, second = changed_worlds(town, [Change(), MUCH, MUCH, other])
    assert first is again
    assert none.world.objects == town.objects
    new = [{o.id for o in w.world.objects} - {o.id for o in town.objects} for w in (first, second)]
    assert new[0] and new[1] and not new[0] & new[1]
    assert max(new[1]) <= MAX_OBJECT_ID
    listed = [o.id for o in every_object(town, [none, first, second])]
    assert listed == sorted({o.id for o in town.objects} | new[0] | new[1])
    # A renderer that is told the change and the first id makes the same world.
    told = changed_world(town, other, second.first_new_id)
    assert told.declared == second.declared
    for a, b in zip(told.world.objects, second.world.objects, strict=True):
        assert (a.id, a.shape, a.yaw, *a.centre) == (b.id, b.shape, b.yaw, *b.centre)


def test_too_many_objects_are_refused(town: World) -> None:
    with pytest.raises(InputError, match="more than 32767 objects: lower cars_moved"):
        changed_world(town, MUCH, MAX_OBJECT_ID)


def test_bare_trees_fill_the_box_of_the_tree() -> None:
    vertices = shape_mesh("bare_2").vertices
    assert np.allclose([vertices.min(0), vertices.max(0)], [[-0.5] * 3, [0.5] * 3], atol=1e-5)


def test_a_share_is_a_share() -> None:
    session = {"condition": "summer-noon", "flight": "nadir", "role": "map"}
    with pytest.raises(InputError, match=r"'sessions.0.change.cars_moved'"):
        SimulateConfig.load(None, {"sessions": [{**session, "change": {"cars_moved": 1.5}}]})


def test_pixels_differ_only_where_objects_are_declared(tmp_path: Path) -> None:
    """The same poses over the place as built, and over it changed and leafless."""
    flight = {"flight": "nadir", "role": "map", "frames": 2}
    change = {"cars_moved": 0.4, "objects_removed": 0.2, "objects_added": 0.3}
    config = SimulateConfig.model_validate(
        {
            "seed": 5, "area": 120, "size": 128, "spp": 1,
            "position_jitter_m": 0, "attitude_jitter_deg": 0,
            "sessions": [
                {"condition": "summer-noon", **flight},
                {"condition": "leafoff-noon", "change": change, **flight},
            ],
        }
    )  # fmt: skip
    simulate(config, tmp_path / "scene")
    scene = Scene.open(tmp_path / "scene")
    (before, as_built), (after, session) = scene.sessions.items()
    declared = session.change
    assert not any(as_built.change.model_dump().values())
    gone = [*declared.removed, *(old for old, _ in declared.moved)]
    new = [*declared.added, *(new for _, new in declared.moved)]
    ids = [item.id for item in scene.objects.objects]
    assert len(set(ids)) == len(ids)
    assert {*gone, *new, *declared.bare} <= set(ids)
    assert np.array_equal(scene.frames(before).cam_from_world, scene.frames(after).cam_from_world)
    seen = np.zeros(3, int)
    with scene.dense(before) as a, scene.dense(after) as b:
        for k in range(2):
            was, now = a.read("instance", k), b.read("instance", k)
            parts = [np.isin(was, gone), np.isin(now, new), np.isin(was, declared.bare)]
            told = parts[0] | parts[1] | parts[2] | np.isin(now, declared.bare)
            assert np.array_equal(was[~told], now[~told])
            assert np.array_equal(a.read("semantic", k)[~told], b.read("semantic", k)[~told])
            apart = np.abs(a.read("depth", k) - b.read("depth", k))
            assert apart[~told].max() < 1e-4
            seen += [int((apart[part] > 0.3).sum()) for part in parts]
            assert not np.isin(now, gone).any()
            assert not np.isin(was, new).any()
    assert (seen > 20).all()  # and what is declared is there to see
