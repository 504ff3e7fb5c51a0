from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from baselines.epipolar import EpipolarConfig, EpipolarLocalizer
from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import GATE_SCENES
from objconnect.localization.matching.features import Extractor
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Query, Status
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

GATE = GATE_SCENES["gate"]
CAMERA = Camera("OPENCV", 64, 48, (52.0, 51.5, 32.2, 23.8, -0.1, 0.02, 1e-3, -5e-4))
POINTS = np.random.default_rng(0).uniform([-40, -40, 0], [40, 40, 15], (900, 3))
DESCRIPTORS = np.random.default_rng(1).integers(0, 256, (900, 128), dtype=np.uint8)
QUERY = 200


def at(*place: float) -> Pose:
    """A camera that looks down, turned a little."""
    turn = Pose.exp(torch.tensor([0.1, 0.05, place[0] / 50, 0, 0, 0], dtype=torch.float64))
    rotation = turn.rotation @ torch.diag(torch.tensor([1.0, -1, -1], dtype=torch.float64))
    return Pose(rotation, -(rotation @ torch.tensor(place, dtype=torch.float64)))


TRUTH = at(3.0, -2.0, 55.0)
AROUND = [at(-10.0, 4, 52), at(12.0, 9, 57), at(1.0, -15, 50)]
IN_LINE = [at(3.0 + step, -2, 55) for step in (8.0, 16.0, -12.0)]


class Exact(Extractor):
    """Knows the features of pictures of one grey each: the points at their very pixels."""

    name = "exact"
    options = ""

    def __init__(self, poses: Sequence[Pose]) -> None:
        self.poses = {**dict(enumerate(poses)), QUERY: TRUTH}

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        projected = CAMERA.project(
            self.poses[int(rgb[0, 0, 0])].transform(torch.from_numpy(POINTS))
        )
        kept = (projected.valid & CAMERA.contains(projected.xy)).numpy()
        # Of double precision, so that nothing but the method can be inexact.
        xy = projected.xy.numpy()[kept]
        return Features(xy, np.ones(len(xy), np.float32), DESCRIPTORS[kept])


def localize(poses: Sequence[Pose], folder: Path) -> Estimate:
    """What the method says of exact matches to photographs that stand at ``poses``."""
    localizer = EpipolarLocalizer(EpipolarConfig(max_error_px=0.5))
    localizer._sift = Exact(poses)
    nothing = np.zeros((0, 2)), np.zeros(0, np.int64)
    images = {}
    for k, pose in enumerate(poses):
        Image.fromarray(np.full((48, 64, 3), k, np.uint8)).save(folder / f"{k}.png")
        images[f"{k}.png"] = MapImage(f"{k}.png", CAMERA, pose.matrix().numpy(), *nothing)
    no_point = np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0), np.zeros(0, np.int64)
    localizer.prepare(SparseMap(images, *no_point), folder)
    return localizer.localize(Query("q", np.full((48, 64, 3), QUERY, np.uint8), CAMERA))


def test_exact_matches_and_not_one_point_give_the_exact_pose(tmp_path: Path) -> None:
    estimate = localize(AROUND, tmp_path)
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(TRUTH)
    assert metres < 1e-6
    assert degrees < 1e-6
    assert set(estimate.seconds) == {"features", "retrieval", "relative poses", "pose"}


@pytest.mark.parametrize(
    ("poses", "reason"),
    [
        (AROUND[:1], "1 of 1 references match the query, 2 are needed"),
        ([at(500.0, 0, 50), at(0.0, 500, 50)], "0 of 2 references match the query, 2 are needed"),
        (IN_LINE, "the rays of 3 references differ in direction by at most 0.0°, 5° are needed"),
    ],
    ids=["one", "elsewhere", "in_line"],
)
def test_geometry_that_does_not_say_where_is_named(
    poses: Sequence[Pose], reason: str, tmp_path: Path
) -> None:
    estimate = localize(poses, tmp_path)
    assert estimate.status is Status.FAILED
    assert estimate.reason == reason


@pytest.mark.thorough
def test_rendered_queries_are_localized() -> None:
    (dataset,) = open_datasets(GATE)
    localizer = EpipolarLocalizer(EpipolarConfig(max_features=1500))
    localizer.prepare(dataset.load_map(), dataset.images)
    errors = []
    for query in dataset.queries[:6]:
        pose = localizer.localize(query.load(query.prior)).cam_from_world
        errors.append(float(pose.error_to(query.reference)[0]) if pose is not None else np.inf)
    assert np.median(errors) < 0.5


@pytest.mark.thorough
def test_queries_of_a_real_flight_are_localized(beach: Path) -> None:
    dataset = open_datasets(beach)[0]
    localizer = EpipolarLocalizer(EpipolarConfig())
    localizer.prepare(dataset.load_map(), dataset.images)
    for query in dataset.queries[:2]:
        pose = localizer.localize(query.load(query.prior)).cam_from_world
        assert pose is not None
        metres, degrees = pose.error_to(query.reference)
        assert metres < 5
        assert degrees < 2
