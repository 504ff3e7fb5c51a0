"""Objects of a photograph connected with those of a map, with no prior."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from objconnect.localization.coarse.grid import GroundGrid
from objconnect.network.config import ConstellationConfig
from objconnect.network.constellation import ConstellationGraph
from objconnect.network.constellation_training import (
    ConstellationTraining,
    TrainingQuery,
    TrainingScene,
    describe_query,
    train_graph,
)
from objconnect.network.landmarks import Landmarks, ObjectLayout, merge
from objconnect.network.object_matching import ObjectMatcher, describe_landmarks
from objconnect.network.object_pairs import Bounds
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose, so3_exp
from tests.objconnect.network.test_landmarks import CAMERA, DOWN, GROUND, photograph, things, views

CPU = torch.device("cpu")

HEADINGS = [k * math.tau / 24 for k in range(24)]
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
ANY = Bounds(HEADINGS, [75.0])


def graph(layers: int = 0) -> ConstellationGraph:
    torch.manual_seed(0)
    made = ConstellationGraph(ConstellationConfig(vector=8, layers=layers)).eval()
    with torch.no_grad():
        made.sharpness.fill_(math.log(100.0))
    return made


def object_matcher(landmarks: Landmarks) -> ObjectMatcher:
    return ObjectMatcher(graph(), landmarks, GROUND)


@pytest.mark.parametrize("heading", [0.0, 1.1, -2.6])
@pytest.mark.parametrize("height", [70.0, 100.0])
def test_the_pose_at_which_objects_agree_comes_first(heading: float, height: float) -> None:
    xyz, vectors = things(count=60)
    landmarks = merge(views(xyz, vectors))[0]
    base = DOWN @ so3_exp(heading * UP)
    angles = cv_angles(base)
    view = photograph((12.0, -8.0, height + 5.0), angles, xyz, vectors)
    found = object_matcher(landmarks)(
        view.detections, CAMERA, [DOWN], Bounds(HEADINGS, [60.0, 75.0, 92.0, 115.0])
    )
    best = found[0]
    np.testing.assert_allclose(best.pose.centre()[:2].numpy(), [12.0, -8.0], atol=1.0)
    turn = best.pose.rotation @ view.pose.rotation.T
    assert math.degrees(math.acos(min(1.0, (float(turn.trace()) - 1) / 2))) < 2
    assert float(best.pose.centre()[2]) == pytest.approx(height + 5.0, rel=0.05)
    assert all(best.score >= each.score for each in found)


def cv_angles(rotation: torch.Tensor) -> tuple[float, float, float]:
    """The rotation vector by which ``photograph`` turns a camera that looks down."""
    turn = rotation @ DOWN.T
    angle = math.atan2(float(turn[1, 0]), float(turn[0, 0]))
    return (0.0, 0.0, angle)


def test_the_attitude_at_which_objects_agree_comes_first() -> None:
    xyz, vectors = things(count=60)
    landmarks = merge(views(xyz, vectors))[0]
    view = photograph((0.0, -20.0, 75.0), (0.5, 0.0, 0.0), xyz, vectors)
    found = object_matcher(landmarks)(
        view.detections, CAMERA, [DOWN, view.pose.rotation], Bounds(HEADINGS, [60.0, 72.0])
    )
    np.testing.assert_allclose(found[0].pose.centre()[:2].numpy(), [0.0, -20.0], atol=1.5)
    np.testing.assert_allclose(found[0].pose.rotation, view.pose.rotation, atol=0.05)


@pytest.mark.parametrize(
    "bounds",
    [
        Bounds([1.5], [75.0]),
        Bounds(HEADINGS, [40.0, 50.0]),
        Bounds(HEADINGS, [75.0], (60.0, 0.0, 20.0)),
    ],
)
def test_poses_out_of_bounds_are_no_candidates(bounds: Bounds) -> None:
    xyz, vectors = things(count=60)
    landmarks = merge(views(xyz, vectors))[0]
    view = photograph((12.0, -8.0, 80.0), (0.0, 0.0, 0.0), xyz, vectors)

    def is_found(within: Bounds) -> bool:
        made = object_matcher(landmarks)(view.detections, CAMERA, [DOWN], within)
        return any(bool((each.pose.centre() - view.pose.centre()).norm() < 3) for each in made)

    assert is_found(ANY)
    assert not is_found(bounds)


def test_a_large_map_is_searched_in_tiles() -> None:
    """Each of many copies of a place has the same objects; one of them is as the query sees it."""
    xyz, vectors = things(count=60)
    landmarks = merge(views(xyz, vectors))[0]
    mirrored = landmarks.xyz * [-1.0, 1.0, 1.0]
    aside = [mirrored + np.array([400.0 * k, 0.0, 0.0]) for k in range(1, 40)]
    whole = np.concatenate([landmarks.xyz, *aside])
    rows = np.tile(np.arange(len(landmarks)), 40)
    many = Landmarks(whole, *(getattr(landmarks, name)[rows] for name in Landmarks.ARRAYS[1:]))
    assert len(many) > 1600
    view = photograph((12.0, -8.0, 80.0), (0.0, 0.0, 0.0), xyz, vectors)
    found = ObjectMatcher(graph(), many, GROUND)(view.detections, CAMERA, [DOWN], ANY)
    np.testing.assert_allclose(found[0].pose.centre()[:2].numpy(), [12.0, -8.0], atol=1.0)


def test_too_few_objects_connect_with_nothing() -> None:
    xyz, vectors = things(count=60)
    landmarks = merge(views(xyz, vectors))[0]
    few = photograph((0.0, 0.0, 80.0), (0.0, 0.0, 0.0), xyz[:2] * [0.1, 0.1, 1.0], vectors[:2])
    assert object_matcher(landmarks)(few.detections, CAMERA, [DOWN], ANY) == []
    shown = photograph((0.0, 0.0, 80.0), (0.0, 0.0, 0.0), xyz, vectors).detections
    at_one_place = replace(shown, xy=shown.xy[:1].expand(len(shown), 2))
    assert object_matcher(landmarks)(at_one_place, CAMERA, [DOWN], ANY) == []
    one = landmarks.select(np.array([0]))
    assert object_matcher(one)(shown, CAMERA, [DOWN], ANY) == []
    none = merge([])[0]
    empty = Landmarks(**{**vars(none), "vectors": np.zeros((0, 8), np.float32)})
    whole = photograph((0.0, 0.0, 80.0), (0.0, 0.0, 0.0), xyz, vectors)
    assert object_matcher(empty)(whole.detections, CAMERA, [DOWN], ANY) == []


def test_a_constellation_means_the_same_wherever_it_stands() -> None:
    with_neighbours = graph(layers=2)
    xyz, vectors = things()
    place = torch.from_numpy(xyz[:, :2]).float()
    near, there = with_neighbours.neighbours(place)
    ones = torch.ones(1, len(xyz))

    def describe(where: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            made: torch.Tensor = with_neighbours(vectors, where[None], ones, ones, near, there)
        return made[0]

    assert torch.allclose(describe(place), describe(place + 100), atol=1e-4)
    assert not torch.allclose(describe(place), describe(place * 1.5), atol=1e-2)


def alone_alike(count: int, seed: int) -> TrainingScene:
    """Landmarks that all look the same, and queries of parts of them: only neighbours tell."""
    rng = np.random.default_rng(seed)
    xyz = np.column_stack([rng.uniform(-60, 60, (count, 2)), np.full(count, 6.0)])
    same = np.tile(np.eye(1, 8, dtype=np.float32), (count, 1))
    ones = np.ones(count, np.float32)
    landmarks = Landmarks(xyz, same, 2 * ones, ones, ones, np.full(count, 3, np.int32))
    queries = []
    for number in range(12):
        centre = rng.uniform(-30, 30, 2)
        rows = np.flatnonzero(np.linalg.norm(xyz[:, :2] - centre, axis=1) < 35)
        offset = (xyz[rows, :2] - centre) / 80.0
        short = np.full(len(rows), 1 / 80.0)
        layout = ObjectLayout(
            offset, short, 2 * short, torch.from_numpy(same[rows]), np.arange(len(rows))
        )
        queries.append(TrainingQuery(f"{number}.jpg", "winter", layout, 80.0, rows, xyz[rows]))
    return TrainingScene(f"scene {seed}", landmarks, queries)


def find_first(graph: ConstellationGraph, lesson: TrainingScene) -> float:
    """The share of objects whose own landmark is most like them."""
    hits = []
    with torch.no_grad():
        theirs = describe_landmarks(graph, lesson.landmarks)
        for query in lesson.queries:
            own = describe_query(graph, query, np.arange(len(query.layout)))
            hits += ((own @ theirs.T).argmax(1).numpy() == query.landmark).tolist()
    return float(np.mean(hits))


def test_the_graph_learns_to_tell_what_looks_the_same() -> None:
    lessons = [alone_alike(60, seed) for seed in range(2)]
    options = ConstellationTraining(steps=300, turn_deg=2, stretch=0.02, moved_m=0.1, missing=0.1)
    unseen = alone_alike(60, 7)
    # Without layers there is nothing to learn from: what looks the same stays the same.
    few = options.model_copy(update={"steps": 30})
    graphs = [
        train_graph(lessons, ConstellationConfig(vector=8, layers=n), steps, CPU)
        for n, steps in ((0, few), (2, options))
    ]
    shares = [find_first(each, unseen) for each in graphs]
    assert shares[0] < 0.15
    assert shares[1] > 0.3


def test_scenes_without_common_objects_teach_nothing() -> None:
    lesson = alone_alike(20, 0)
    strange = [q._replace(landmark=np.full(len(q.layout), -1)) for q in lesson.queries]
    with pytest.raises(InputError, match="no query"):
        train_graph(
            [lesson._replace(queries=strange)],
            ConstellationConfig(),
            ConstellationTraining(),
            CPU,
        )


def test_the_height_of_the_ground_is_that_of_the_place() -> None:
    xyz, vectors = things(count=60)
    landmarks = merge(views(xyz, vectors))[0]
    heights = GROUND.heights + 3.0
    higher = GroundGrid(GROUND.origin, GROUND.cell, heights)
    view = photograph((0.0, 0.0, 85.0), (0.0, 0.0, 0.0), xyz, vectors)
    made = ObjectMatcher(graph(), landmarks, higher)
    found = made(view.detections, CAMERA, [DOWN], Bounds([0.0], [80.0]))
    assert isinstance(found[0].pose, Pose)
    assert float(found[0].pose.centre()[2]) == pytest.approx(88.0, abs=3.0)
