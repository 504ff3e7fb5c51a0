"""The preset town: ids, boxes, objects on the ground, meshes and the baked ground."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from objconnect.scene.bundle.labels import CLASSES, FIRST_OBJECT_LABEL
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.rectangle import overlap, rectangle
from simulate.look import ground
from simulate.look.buildings import building_mesh
from simulate.look.conditions import condition
from simulate.look.plants import fence_mesh, hedge_mesh
from simulate.look.props import shape_mesh
from simulate.place.kerbs import PavementHeights
from simulate.place.presets import preset
from simulate.place.town import TOWN
from simulate.place.world import MAX_OBJECT_ID, Heightfield, World, class_lookup

# The largest is checked in the thorough part.
TOWNS = [
    (0, 120.0),
    (1, 120.0),
    (2, 150.0),
    pytest.param((7, 240.0), marks=pytest.mark.thorough),
]


@pytest.fixture(scope="module", params=TOWNS)
def town(request: pytest.FixtureRequest) -> World:
    return TOWN.build(*request.param)


def flat(value):
    """Anything nested, as something == can compare."""
    if dataclasses.is_dataclass(value):
        return [flat(getattr(value, f.name)) for f in dataclasses.fields(value)]
    if isinstance(value, list | tuple):
        return [flat(v) for v in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def test_the_seed_decides_everything():
    a, b, other = TOWN.build(3, 120), TOWN.build(3, 120), TOWN.build(4, 120)
    assert flat(a) == flat(b)
    assert flat(a.objects) != flat(other.objects)
    assert not np.array_equal(a.terrain.nodes, other.terrain.nodes)
    assert not np.array_equal(a.ground.labels, other.ground.labels)


def test_ids_are_unique_and_fit_blender(town):
    ids = [o.id for o in town.objects]
    assert len(set(ids)) == len(ids)
    assert min(ids) >= 1
    assert max(ids) <= MAX_OBJECT_ID


def test_boxes_lie_within_the_area(town):
    corners = np.concatenate([o.footprint() for o in town.objects])
    assert np.abs(corners).max() <= 0.5 * town.side_m
    assert all((o.size > 0).all() for o in town.objects)


def test_no_two_objects_intersect(town):
    boxes = [o.footprint() for o in town.objects]
    centres = np.array([b.mean(0) for b in boxes])
    radii = np.array([0.5 * np.hypot(*o.size[:2]) for o in town.objects])
    for i, box in enumerate(boxes):
        near = np.linalg.norm(centres[i + 1 :] - centres[i], axis=1) < radii[i + 1 :] + radii[i]
        for j in np.flatnonzero(near) + i + 1:
            assert not overlap(box, boxes[j]), (town.objects[i], town.objects[j])


def test_every_class_is_present(town):
    objects = {o.class_name for o in town.objects}
    assert objects == {
        "building", "tree", "hedge", "fence", "car", "van", "truck", "container", "bench", "lamp",
        "bin", "hydrant", "sign", "bollard",
    }  # fmt: skip
    assert min(CLASSES[name] for name in objects) >= FIRST_OBJECT_LABEL
    labels = set(np.unique(town.ground.labels))
    assert labels >= {CLASSES[c] for c in ("grass", "road", "pavement", "parking", "driveway")}


def test_objects_stand_on_the_ground(town):
    rises = PavementHeights(town.kerbs)
    for item in town.objects:
        x, y = np.vstack([item.footprint(), item.centre[:2]]).T
        ground_z = town.terrain.height(x, y)
        base = item.centre[2] - 0.5 * item.size[2]
        if item.class_name in ("building", "hedge", "fence"):
            assert base <= ground_z.min() + 1e-9
        else:
            assert base == pytest.approx(ground_z[-1] + rises.height_at(item.centre[:2]))


def test_only_vehicles_and_lamps_stand_on_carriageways(town):
    for item in town.objects:
        if item.class_name not in ("car", "van", "truck", "lamp"):
            label = town.ground.label(*item.centre[:2])
            assert label != CLASSES["road"], item


def test_own_meshes_fill_their_boxes(town):
    for item in town.objects:
        half = 0.5 * item.size
        if item.class_name == "building":
            vertices = building_mesh(item).vertices - [0, 0, half[2]]
            vertices = vertices[vertices[:, 2] > -half[2]]  # foundations go below the box
        elif item.class_name == "hedge":
            vertices = hedge_mesh(item, town.terrain).vertices
        elif item.class_name == "fence":
            vertices = fence_mesh(item, town.terrain).vertices
        else:
            vertices = shape_mesh(item.shape).vertices * item.size
        assert_allclose(vertices[:, :2].max(0), half[:2], rtol=0.15, atol=0.1)
        assert vertices[:, 2].max() == pytest.approx(half[2], abs=0.12)
        assert (np.abs(vertices[:, :2]) <= half[:2] + 1e-3).all()


def test_class_lookup(town):
    table = class_lookup(town.objects)
    assert table[0] == 0
    for item in town.objects:
        assert table[item.id] == CLASSES[item.class_name]


def test_large_towns_are_quick_enough_to_build_in_a_test():
    town = TOWN.build(5, 400)
    assert len(town.objects) > 800


@pytest.mark.parametrize("area", [10.0, 5000.0, float("nan")])
def test_an_impossible_area_is_refused(area):
    with pytest.raises(InputError, match="area must be"):
        TOWN.build(1, area)


def test_unknown_names_list_the_known_ones():
    with pytest.raises(InputError, match=r"unknown preset 'moon': choose one of .*town"):
        preset("moon")
    with pytest.raises(InputError, match=r"unknown condition 'fog': .*summer-noon.*winter-dusk"):
        condition("fog")


def test_ground_bake_is_deterministic_and_differs_between_seasons():
    town = TOWN.build(1, 120)
    summer, winter = (
        ground.bake(town.ground, condition(c), 1) for c in ("summer-noon", "winter-dusk")
    )
    again = ground.bake(town.ground, condition("summer-noon"), 1)
    assert np.array_equal(summer, again)
    assert summer.shape == (*town.ground.labels.shape, 3)
    grass = town.ground.labels == CLASSES["grass"]
    road = town.ground.labels == CLASSES["road"]
    assert winter[grass].mean() > summer[grass].mean() + 60  # snow
    assert winter[road].mean() < winter[grass].mean() - 40  # partly cleared


def test_ground_label_and_height_are_mirrored_outside():
    town = TOWN.build(1, 120)
    inside, outside = np.array([59.0, 12.3]), np.array([61.0, 12.3])
    assert town.ground.label(*inside) == town.ground.label(*outside)
    assert town.terrain.height(*inside) == pytest.approx(town.terrain.height(*outside))


def test_heightfield_is_bilinear():
    field = Heightfield(np.array([[0.0, 1.0], [2.0, 3.0]]), 2.0)
    assert field.height(0, 0) == pytest.approx(1.5)
    assert_allclose(field.height([-1, 1, -1, 1], [-1, -1, 1, 1]), [0, 1, 2, 3], atol=1e-12)


def test_rectangles_overlap_only_when_they_share_area():
    a = rectangle((0, 0), (4, 2), 0.3)
    assert overlap(a, rectangle((1, 1), (2, 2), 1.0))
    assert not overlap(a, rectangle((0, 2.5), (4, 2), 0.3))
    assert not overlap(rectangle((0, 0), (2, 2), 0), rectangle((2, 0), (2, 2), 0))
