from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from objconnect.learning.pixloc_net import read_network
from objconnect.localization.align.aligner import align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.problem import Levelling, ProblemBuilder, relative_cost
from objconnect.localization.featuremetric.references import ReferenceSource, load_references
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import tilt
from objconnect.scene.localizer import Query
from tests.baselines.pixloc.made_map import (
    CAMERA,
    looking_down,
    photograph,
    write_map,
    write_network,
)
from tests.objconnect.localization.align.problems import DAMPING, small
from tests.objconnect.localization.align.world import PINHOLE


@pytest.fixture(scope="module")
def problems(tmp_path_factory: pytest.TempPathFactory) -> ProblemBuilder:
    """Builds problems of a made map of five photographs."""
    folder = tmp_path_factory.mktemp("problems")
    network = read_network(write_network(folder / "pixloc.safetensors"))[0]
    extract = MapExtractor(network, 1024, "float32")
    images = folder / "images"
    sparse_map = write_map(images)
    kept = MapCache.of(sparse_map, images, folder)
    observations = load_references(ReferenceSource(kept, extract, "key", "pixloc", 2000), 2**20)
    damping = [factors().detach() for factors in network.damping]
    return ProblemBuilder(extract, observations, sparse_map.centres, damping, Options())


@pytest.mark.parametrize(("degrees", "tilts", "left"), [(55, 0, 30), (25, 0, 25), (55, 40, 55)])
def test_an_image_flatter_than_the_photographs_is_levelled(
    degrees: float, tilts: float, left: float, problems: ProblemBuilder
) -> None:
    """By as much as it takes to look 30 degrees flatter than they do."""
    levelling = Levelling(np.full(5, math.radians(tilts)), math.radians(30))
    problems = replace(problems, levelling=levelling)
    start = looking_down(12.0, 14.0, (degrees, 0, 0))
    with torch.inference_mode():
        view, _ = problems.view(Query("q", photograph(start), CAMERA), np.arange(5), start)
    assert math.degrees(tilt(view.pose(start).rotation.numpy())) == pytest.approx(left, abs=0.1)


@pytest.mark.parametrize(
    ("higher", "most", "scale"),
    [(2.0, 2.0, 2.0), (1.5, 2.0, 1.5), (2.0, 1.6, 1.6), (2.0, 8.0, 2.0)],
)
def test_an_image_from_above_the_map_is_magnified_to_its_resolution(
    higher: float, most: float, scale: float, problems: ProblemBuilder
) -> None:
    low, chosen = looking_down(12.0, 0.0), np.arange(5)
    start = Pose(low.rotation, low.translation * low.translation.new_tensor([1, 1, higher]))
    query = Query("q", photograph(start), CAMERA)
    view = problems.warp(query, chosen, start)
    assert view.scale == 1.0
    larger = problems.magnify(query, chosen, start, view, most)
    assert larger is not None
    assert larger.scale == pytest.approx(scale, rel=0.02)
    # Nothing is gained where the view has the map's resolution, or none may be reached.
    assert problems.magnify(query, chosen, start, larger, larger.scale) is None
    assert problems.magnify(query, chosen, start, view, 1.0) is None
    near = problems.warp(query, chosen, low)
    assert problems.magnify(query, chosen, low, near, most) is None


def test_points_cover_the_image_although_references_overlap_in_its_middle(
    problems: ProblemBuilder,
) -> None:
    start = looking_down(12.0, 0.0)  # above the middle one of five
    chosen = np.arange(5)
    with torch.inference_mode():
        looked = problems.view(Query("q", photograph(start), CAMERA), chosen, start)
        problem = problems.build(*looked, chosen, start, 200)
    view = looked[0]
    xy = view.camera.project(view.pose(start).transform(problem.points[0])).xy
    column = (xy[:, 0] / view.camera.width * 4).long()
    counts = column.bincount(minlength=4)
    assert counts.sum() == 200
    assert counts.max() < 1.3 * counts.min()


def test_a_point_is_seen_from_where_the_photograph_of_its_features_was(
    problems: ProblemBuilder,
) -> None:
    start = looking_down(12.0, 0.0)
    chosen = np.array([3, 1, 2])
    with torch.inference_mode():
        looked = problems.view(Query("q", photograph(start), CAMERA), chosen, start)
        problem = problems.build(*looked, chosen, start, 200)
    assert problem.seen_from is not None
    seen_from = problem.seen_from[0].numpy()
    features = problem.levels[0].reference[0].numpy()
    found = 0
    for row in chosen:
        observed = problems.observations[int(row)]
        here = np.flatnonzero((seen_from == problems.centres[row]).all(1))
        for point in here:
            same = (observed.xyz == problem.points[0, point].numpy()).all(1)
            assert (observed.features[0][same] == features[point]).all(1).any()
        found += len(here)
    assert found == problem.points.shape[1]


def test_features_that_are_all_the_same_fit_no_better_than_by_chance() -> None:
    made = small()
    pose = Pose(made.truth.rotation[None], made.truth.translation[None])
    problem = Problem(made.levels, made.points, PINHOLE.intrinsics(), pose, DAMPING, Options())
    assert relative_cost(problem, pose) < 0.5
    middle = len(made.levels) // 2
    level = made.levels[middle]
    flat = replace(
        level,
        features=torch.zeros_like(level.features),
        reference=torch.zeros_like(level.reference),
    )
    levels = [*made.levels[:middle], flat, *made.levels[middle + 1 :]]
    assert relative_cost(replace(problem, levels=levels), pose) == 1.0


def test_fit_is_the_cost_of_an_alignment_that_takes_no_step() -> None:
    made = small()
    pose = Pose(made.truth.rotation[None], made.truth.translation[None])
    level = made.levels[1]
    # Points well inside the picture: of the others it depends on the border which are in view.
    xy = PINHOLE.project(pose.transform(made.points.double())[0]).xy
    inside = torch.nonzero(PINHOLE.contains(xy, 2 * level.stride))[:, 0]
    assert 100 < len(inside) < made.points.shape[1]
    trusted = replace(
        level,
        reference=level.reference[:, inside],
        confidence=0.1 + torch.rand(1, 1, *level.features.shape[-2:]),
        reference_confidence=0.1 + torch.rand(1, len(inside)),
    )
    points, still = made.points[:, inside], Options(iterations=0)
    problem = Problem([trusted], points, PINHOLE.intrinsics(), pose, DAMPING[:1], still)
    aligned = align(problem)
    assert aligned.points_in_view.item() == len(inside)
    other = torch.roll(torch.arange(len(inside)), len(inside) // 2)
    swapped = replace(
        trusted,
        reference=trusted.reference[:, other],
        reference_confidence=trusted.reference_confidence[:, other],
    )
    chance = align(replace(problem, levels=[swapped])).cost
    assert relative_cost(problem, pose) == pytest.approx(float(aligned.cost / chance), rel=1e-4)


def test_too_few_points_in_view_fit_nothing() -> None:
    made = small()
    pose = Pose(made.truth.rotation[None], made.truth.translation[None])
    problem = Problem(made.levels, made.points, PINHOLE.intrinsics(), pose, DAMPING, Options())
    assert relative_cost(problem.first_points(9), pose) == math.inf
    assert relative_cost(problem.first_points(40), pose) < 0.6
