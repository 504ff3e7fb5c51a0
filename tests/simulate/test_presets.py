"""Presets of places: their objects and ground classes, positions of objects, and rendering."""

from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from objconnect.scene.bundle.labels import CLASSES, FIRST_OBJECT_LABEL
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.rectangle import overlap
from simulate.camera.pinhole import PinholeCamera
from simulate.flight.config import ObliqueFlight
from simulate.flight.context import FlightContext
from simulate.flight.flights import plan_oblique
from simulate.look.individual import individual_mesh
from simulate.look.props import shape_mesh
from simulate.place import builder
from simulate.place.change import VEHICLES, Change, change_world
from simulate.place.grid import CircleGrid
from simulate.place.objects import CONTAINER_M
from simulate.place.plan import MAX_SIDE_M
from simulate.place.presets import PRESETS, preset
from simulate.place.world import MAX_OBJECT_ID, World, rise
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import render
from simulate.thermal.substances import SUBSTANCES, substance_name
from tests.simulate.test_flights import pinhole
from tests.simulate.test_town import flat
from tests.simulate.towns import cached_place

AREA = 180.0
STREET_FURNITURE = {"lamp", "bin", "hydrant", "sign", "bollard"}
EXPECTED_CLASSES = {
    "town": STREET_FURNITURE | {"building", "tree", "hedge", "fence", "car", "van", "bench"},
    "suburb": STREET_FURNITURE | {"building", "tree", "hedge", "fence", "car", "bench"},
    "park": STREET_FURNITURE | {"tree", "bench", "table", "boat"},
    "farmland": {
        "building", "tree", "hedge", "fence", "bale", "tractor", "tank", "pole", "wire", "car",
    },
    "industrial": STREET_FURNITURE
    | {
        "building", "fence", "tank", "pallet", "container", "boat", "pole", "wire", "truck",
        "van", "car",
    },
    "street": STREET_FURNITURE
    | {"building", "tree", "hedge", "fence", "car", "van", "truck", "bench"},
    "estate": STREET_FURNITURE | {"building", "tree", "car", "truck"},
    "orchard": {"tree", "building", "fence", "pallet", "tractor"},
    "solar": {"panel", "cabinet", "fence", "building", "tree"},
    "containers": {"container", "crane", "truck", "car", "lamp", "bollard", "building"},
    "cemetery": {"grave", "tree", "hedge", "bench", "bin", "building"},
    "alpine": {"building", "tree", "fence", "car", "lamp", "bale"},
    "harbour": STREET_FURNITURE | {"boat", "crane", "building", "car", "van", "truck", "pallet"},
}  # fmt: skip
"""Classes every place of a kind has."""
EXPECTED_GROUND = {
    "town": {"grass", "road", "pavement", "parking", "driveway"},
    "suburb": {"grass", "road", "pavement", "parking", "driveway"},
    "park": {"grass", "road", "path", "water"},
    "farmland": {"grass", "road", "field", "path"},
    "industrial": {"road", "pavement", "parking", "water"},
    "street": {"grass", "road", "pavement", "driveway", "path"},
    "estate": {"grass", "road", "pavement", "driveway"},
    "orchard": {"grass", "field", "path"},
    "solar": {"grass", "path"},
    "containers": {"road", "parking"},
    "cemetery": {"grass", "path", "pavement"},
    "alpine": {"grass", "road", "path"},
    "harbour": {"road", "pavement", "parking", "water"},
}


cached_shape = cache(shape_mesh)

SECOND_SEED = [pytest.param((name, 2), marks=pytest.mark.thorough) for name in PRESETS]


@pytest.fixture(scope="module", params=[*((name, 1) for name in PRESETS), *SECOND_SEED])
def place(request: pytest.FixtureRequest) -> tuple[str, World]:
    name, seed = request.param
    return name, cached_place(name, seed, AREA)


def test_all_kinds_of_places_are_there():
    assert set(PRESETS) == set(EXPECTED_CLASSES) == set(EXPECTED_GROUND)


# The town's own test asks it of a town every time.
SEEDED = [
    name if name in ("park", "farmland") else pytest.param(name, marks=pytest.mark.thorough)
    for name in PRESETS
]


@pytest.mark.parametrize("name", SEEDED)
def test_the_seed_decides_everything(name):
    area = max(120.0, PRESETS[name].min_side_m)
    a, b, other = (preset(name)(seed, area) for seed in (3, 3, 4))
    assert flat(a) == flat(b)
    assert flat(a.objects) != flat(other.objects)


def test_every_class_is_present(place):
    name, world = place
    assert {o.class_name for o in world.objects} >= EXPECTED_CLASSES[name]
    assert set(np.unique(world.ground.labels)) >= {CLASSES[c] for c in EXPECTED_GROUND[name]}


def test_there_are_many_classes_of_small_things():
    small = set().union(*EXPECTED_CLASSES.values()) - {"building", "tree", "hedge", "fence", "wire"}
    assert len(small) >= 12
    assert all(CLASSES[c] >= FIRST_OBJECT_LABEL for c in small)


def test_ids_are_unique_and_boxes_lie_within_the_area(place):
    _, world = place
    ids = [o.id for o in world.objects]
    assert len(set(ids)) == len(ids)
    assert 1 <= min(ids) <= max(ids) <= MAX_OBJECT_ID
    corners = np.concatenate([o.footprint() for o in world.objects])
    assert np.abs(corners).max() <= 0.5 * world.side_m + 1.0  # wires reach between poles' middles
    solid = [o.footprint() for o in world.objects if o.class_name != "wire"]
    assert np.abs(np.concatenate(solid)).max() <= 0.5 * world.side_m


def test_no_two_solid_things_intersect(place):
    _, world = place
    solid = [o for o in world.objects if o.class_name != "wire"]
    near = CircleGrid()
    for item in solid:
        centre, radius = item.centre[:2], 0.5 * float(np.hypot(*item.size[:2]))
        for k in near.find_overlapping(centre, radius):
            assert not overlap(item.footprint(), solid[k].footprint()), (item, solid[k])
        near.add(centre, radius)


def test_meshes_fill_their_boxes(place):
    _, world = place
    for item in world.objects:
        half = 0.5 * item.size
        individual = individual_mesh(item, world)
        if individual is None:
            vertices = cached_shape(item.shape).vertices * item.size
        elif item.class_name == "building":
            vertices = individual.vertices - [0, 0, half[2]]
        else:
            vertices = individual.vertices
        assert_allclose(vertices[:, :2].max(0), half[:2], rtol=0.15, atol=0.1)
        if item.slope is None:
            assert vertices[:, 2].max() == pytest.approx(half[2], abs=0.12)
        else:
            assert (np.abs(vertices[:, 2]) <= half[2] + 1e-3).all()
        assert (np.abs(vertices[:, :2]) <= half[:2] + 1e-3).all()
        if item.class_name == "wire":
            assert vertices[:, 2].min() == pytest.approx(-half[2], abs=1e-3)


def lowest_above_ground(item, world):
    """Height (m) of the lowest points of an object near its four corners above the ground there."""
    vertices = individual_mesh(item, world).vertices
    ends = [vertices[(vertices[:, :2] * sign > 0.2 * item.size[:2]).all(1)] for sign in SIGNS]
    feet = np.stack([end[end[:, 2].argmin()] for end in ends])
    cos, sin = np.cos(item.yaw), np.sin(item.yaw)
    at = item.centre[:2] + feet[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    return feet[:, 2] + item.centre[2] - world.terrain.height(at[:, 0], at[:, 1])


def test_every_surface_has_a_substance(place):
    """Of all shapes and materials."""
    _, world = place
    looks = {
        (o.class_name, o.shape, o.style and (o.style.facade, o.style.roofing)): o
        for o in world.objects
    }
    for item in looks.values():
        mesh = individual_mesh(item, world) or cached_shape(item.shape)
        for material in {mesh.materials[k] for k in np.unique(mesh.material)}:
            assert substance_name(material, item.class_name) in SUBSTANCES


SIGNS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def test_vehicles_lean_with_steep_ground_alone():
    """Each wheel of a car in an alpine village is on the ground; the box grows as it leans."""
    steep = cached_place("alpine", 1, AREA)
    vehicles = [o for o in steep.objects if o.class_name in VEHICLES]
    assert max(abs(o.slope[0]) for o in vehicles) > 0.1
    for item in vehicles:
        assert np.abs(lowest_above_ground(item, steep)).max() < 0.12
        assert item.size[2] == pytest.approx(item.height_m + rise(item.slope, item.size))
    assert all(o.slope is None for o in cached_place("town", 1, AREA).objects)


def test_moved_vehicles_lean_with_the_ground_at_their_new_place():
    base = cached_place("alpine", 1, AREA)
    changed = change_world(base, Change(cars_moved=1.0, seed=1))
    moved = {new for _, new in changed.declared.moved}
    vehicles = [o for o in changed.world.objects if o.id in moved]
    assert len(vehicles) > 3
    heights = {o.shape: o.height_m for o in base.objects if o.class_name in VEHICLES}
    for item in vehicles:
        assert np.ptp(lowest_above_ground(item, base)) < 0.15
        assert item.height_m == pytest.approx(heights[item.shape])


ALIASED = {
    "estate": lambda world: [
        (o.size.tolist(), o.style) for o in world.objects if o.shape == "house"
    ],
    "solar": lambda world: [
        (o.size.tolist(), o.colour) for o in world.objects if o.class_name == "panel"
    ],
    "cemetery": lambda world: [o.size.tolist() for o in world.objects if o.class_name == "grave"],
}
"""What is the same all over a place, and other in a place of another seed."""


@pytest.mark.parametrize("name", ALIASED)
def test_what_repeats_is_equal_all_over_a_place(name: str) -> None:
    one, other = (ALIASED[name](cached_place(name, seed, 120.0)) for seed in (1, 3))
    assert min(len(one), len(other)) >= 10
    assert all(item == one[0] for item in one)
    assert all(item == other[0] for item in other)
    assert one[0] != other[0]


def test_trees_of_an_orchard_stand_at_equal_distances() -> None:
    """The nearest neighbour of most trees is as far as that of any other."""
    nearest = []
    for seed in (1, 3):
        trees = [o for o in preset("orchard")(seed, 120.0).objects if o.class_name == "tree"]
        at = np.array([o.centre[:2] for o in trees])
        apart = np.linalg.norm(at[:, None] - at, axis=-1) + 1e3 * np.eye(len(at))
        nearest.append(apart.min(1))
    for distances in nearest:
        assert (np.abs(distances - np.median(distances)) < 0.05).mean() > 0.6
    assert abs(np.median(nearest[0]) - np.median(nearest[1])) > 0.1


def test_containers_are_stacked() -> None:
    """A stack is one object; the box is a whole number of containers high."""
    stacks = [o for o in cached_place("containers", 1, AREA).objects if o.class_name == "container"]
    high = np.array([o.size[2] for o in stacks]) / CONTAINER_M["container"][2]
    assert_allclose(high, np.round(high))
    assert len(set(np.round(high))) >= 3
    for stack, count in zip(stacks, np.round(high), strict=True):
        if count > 1:
            # Each container has doors, by which it has more corners than one alone.
            single = shape_mesh(stack.shape.rpartition("_")[0])
            assert len(shape_mesh(stack.shape).sizes) == count * len(single.sizes)


def test_wires_hang_between_poles_well_above_the_ground(place):
    name, world = place
    if "wire" not in EXPECTED_CLASSES[name]:
        assert not any(o.class_name == "wire" for o in world.objects)
        return
    poles = np.array([o.centre[:2] for o in world.objects if o.class_name == "pole"])
    for wire in (o for o in world.objects if o.class_name == "wire"):
        out = 0.5 * wire.size[0] * np.array([np.cos(wire.yaw), np.sin(wire.yaw)])
        for end in (wire.centre[:2] - out, wire.centre[:2] + out):
            assert np.linalg.norm(poles - end, axis=1).min() < 1e-6
        low = wire.centre[2] - 0.5 * wire.size[2]
        assert low > float(world.terrain.height(*wire.centre[:2])) + 4.0


def test_water_is_flat_and_boats_alone_are_on_it(place):
    _, world = place
    n, texel = len(world.ground.labels), world.ground.texel_m
    rows, columns = np.nonzero(world.ground.labels == CLASSES["water"])
    if len(rows):
        x, y = ((c + 0.5 - 0.5 * n) * texel for c in (columns, rows))
        z = world.terrain.height(x, y)
        assert len(np.unique(np.round(z, 6))) <= 12  # one level for each lake
        slope = np.abs(world.terrain.height(x + 0.2, y) - z)
        assert slope.max() < 1e-9
    for item in world.objects:
        wet = world.ground.label(*item.centre[:2]) == CLASSES["water"]
        if item.class_name == "boat":
            assert world.ground.label(*item.footprint().T).tolist() == [CLASSES["water"]] * 4
        elif item.class_name != "wire":
            assert not wet, item


def test_a_place_with_too_many_things_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr(builder, "MAX_OBJECT_ID", 100)
    with pytest.raises(InputError, match=r"^[^\n]*180 m .*100 objects.*smaller area$"):
        preset("town")(1, AREA)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("area", [10.0, MAX_SIDE_M + 1, float("nan")])
def test_an_impossible_area_is_refused(name, area):
    least = PRESETS[name].min_side_m
    with pytest.raises(InputError, match=f"area must be {least:.0f} to 2000 m a side"):
        preset(name)(1, area)


@pytest.mark.thorough
@pytest.mark.parametrize("name", sorted(set(PRESETS) - {"town"}))  # which other tests render
def test_a_place_renders(name, tmp_path: Path):
    area = max(120.0, PRESETS[name].min_side_m)
    world = preset(name)(1, area)
    context = FlightContext(area, world.terrain.height, pinhole(96, 96, 80.0))
    flight = ObliqueFlight(radius_m=40.0, altitude_m=45.0)
    poses = plan_oblique(flight, context, 1, np.random.default_rng(0))
    camera = PinholeCamera(width=96, height=96, f=80.0, cx=48.0, cy=48.0)
    job = RenderJob(
        preset=name, seed=1, side_m=area, condition="summer-noon", camera=camera, samples=1,
        poses={0: poses[0].tolist()},
    )  # fmt: skip
    render(job, tmp_path)
    with np.load(frame_path(tmp_path, 0)) as arrays:
        instance, semantic = arrays["instance"], arrays["semantic"]
        assert arrays["rgb"].std() > 10
    by_id = {o.id: o.class_name for o in world.objects}
    seen = Counter(by_id[int(k)] for k in np.unique(instance) if k)
    # A view of an orchard shows rows of trees, a fence and the farm.
    assert len(seen) >= (3 if name == "orchard" else 4)
    for name_, label in CLASSES.items():
        here = semantic == label
        if label >= FIRST_OBJECT_LABEL and here.any():
            assert {by_id[int(k)] for k in np.unique(instance[here])} == {name_}
    if name == "park":
        assert (semantic == CLASSES["water"]).sum() > 50
