"""Pass indices of a world with more objects than there are indices."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from objconnect.scene.errors import InputError
from simulate.camera.pinhole import PinholeCamera
from simulate.look.conditions import condition
from simulate.render import stage as stages
from simulate.render.reach import Reach
from simulate.render.stage import Stage, object_name, parse_object_name
from tests.simulate.towns import cached_town

CAMERA = PinholeCamera(width=64, height=64, f=55.4, cx=32, cy=32)
SIDE_M = 600.0


class Collection(dict[str, Any]):
    """A stand-in for Blender's collection of objects."""

    def link(self, _: object) -> None:
        """Show an object."""

    def unlink(self, _: object) -> None:
        """Hide an object."""


def make_scene() -> SimpleNamespace:
    objects = Collection()
    for item in cached_town(5, SIDE_M).objects:
        name = object_name(item.id)
        objects[name] = SimpleNamespace(
            name=name, pass_index=0, delta_location=SimpleNamespace(z=0.0)
        )
    return SimpleNamespace(collection=SimpleNamespace(objects=objects))


def look_down(x: float, y: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [x, y, 30.0]
    return pose


def test_every_object_has_its_number_where_there_are_enough() -> None:
    town, scene = cached_town(5, SIDE_M), make_scene()
    stage = Stage(scene, town, condition("summer-noon"), [])
    stage.set_up(CAMERA, look_down(0.0, 0.0), 0.0)
    shown = scene.collection.objects.values()
    assert [stage.ids[o.pass_index] for o in shown] == [parse_object_name(o.name) for o in shown]


def test_with_too_many_objects_those_that_a_frame_needs_have_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stages, "MAX_OBJECT_ID", 1800)
    town, scene = cached_town(5, SIDE_M), make_scene()
    look = condition("summer-noon")
    assert len(town.objects) > 1800
    stage = Stage(scene, town, look, [])
    reach = Reach(town.objects, look.luminary.elevation)
    for x, y in ((-250.0, -250.0), (250.0, 250.0), (-250.0, 200.0)):
        pose = look_down(x, y)
        stage.set_up(CAMERA, pose, 0.0)
        needed = reach(CAMERA, pose, 0.0)
        indices = [
            scene.collection.objects[object_name(item.id)].pass_index
            for item, is_needed in zip(town.objects, needed, strict=True)
            if is_needed
        ]
        assert 100 < len(indices) == len(set(indices))
        assert min(indices) >= 1
        ids = [item.id for item, is_needed in zip(town.objects, needed, strict=True) if is_needed]
        assert stage.ids[indices].tolist() == ids
        assert sorted(stage.ids[stage.ids > 0].tolist()) == sorted(ids)


def test_a_frame_that_needs_too_many_objects_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stages, "MAX_OBJECT_ID", 100)
    stage = Stage(make_scene(), cached_town(5, SIDE_M), condition("summer-noon"), [])
    with pytest.raises(InputError, match="a photograph needs .* objects, more than 100"):
        stage.set_up(CAMERA, look_down(0.0, 0.0), 0.0)


def test_the_ground_has_no_id() -> None:
    assert [parse_object_name(name) for name in ("00042", "123456", "terrain", "beam 00001")] == [
        42, 123456, 0, 0,
    ]  # fmt: skip
