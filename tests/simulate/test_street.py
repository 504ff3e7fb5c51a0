"""The street preset: its surroundings and its kerbs."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from simulate.look.conditions import condition
from simulate.look.terrain import ground_mesh, kerbs_mesh
from simulate.place.kerbs import KERB_M, Rises
from simulate.place.presets import preset
from simulate.place.world import CLASSES, MIRRORED_M, World

AREA = 300.0


@pytest.fixture(scope="module", params=[1, 2])
def street(request: pytest.FixtureRequest) -> World:
    return preset("street")(request.param, AREA)


def within(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    line = outline.astype(np.float32)
    return np.array([cv2.pointPolygonTest(line, (x, y), False) >= 0 for x, y in points.tolist()])


def test_surroundings_cover_the_place_once(street: World) -> None:
    assert [part.name for part in street.surroundings] == ["urban", "suburban", "park"]
    points = np.random.default_rng(0).uniform(-0.5 * AREA, 0.5 * AREA, (2000, 2))
    inside = np.array([within(part.outline, points) for part in street.surroundings])
    assert (inside.sum(0) == 1).all()
    assert (inside.mean(1) > 0.15).all()


def test_each_surroundings_hold_what_their_name_says(street: World) -> None:
    urban, suburban, park = (
        [o for o in street.objects if within(part.outline, o.centre[None, :2])[0]]
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
        all(within(part.outline, road.line).any() for part in street.surroundings)
        for road in street.roads
    ]
    assert sum(through) >= 2


def test_pavements_stand_above_the_carriageways(street: World) -> None:
    assert 0.10 <= KERB_M <= 0.15
    rises = Rises(street.kerbs)
    on_road = raised = total = 0
    rng = np.random.default_rng(0)
    for road in street.roads:
        for a, b in pairwise(road.line):
            middle, along = 0.5 * (a + b), (b - a) / np.linalg.norm(b - a)
            if np.abs(middle).max() > 0.5 * AREA - 5:
                continue
            across = np.array([-along[1], along[0]])
            lane = middle + rng.uniform(-0.4, 0.4) * road.width_m * across
            on_road += rises.at(lane) > 0
            for side in (-1, 1):
                foot = middle + side * (0.5 * road.width_m + 0.8) * across
                if street.ground.label(*foot) == CLASSES["pavement"]:
                    total += 1
                    raised += rises.at(foot) > 0.9 * KERB_M
    assert total > 200
    assert on_road == 0
    assert raised > 0.75 * total  # the rest are corners and dropped kerbs


def test_the_kerbs_mesh_stands_on_the_ground(street: World) -> None:
    mesh = kerbs_mesh(street)
    assert mesh is not None
    above = mesh.vertices[:, 2] - street.terrain.height(*mesh.vertices[:, :2].astype(float).T)
    assert above.max() == pytest.approx(KERB_M, abs=1e-4)
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
