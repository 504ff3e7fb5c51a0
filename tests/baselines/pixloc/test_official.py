"""Network and alignment together, and the loss, beside what the authors' code says."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from objconnect.learning.pixloc_net import PixlocNet
from objconnect.learning.training.pose_loss import VisiblePoints, pose_loss, reprojection_error
from objconnect.localization.align.aligner import align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level
from objconnect.localization.align.sampling import sample
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.pose import Pose
from tests.baselines.pixloc import official


@pytest.fixture(scope="module")
def network() -> PixlocNet:
    return official.ours()


def test_pose_between_two_pictures(network: PixlocNet) -> None:
    pair = official.pair()
    with torch.no_grad():
        reference, query = (
            [
                FeatureMap(features, confidence, stride)
                for stride, (features, confidence) in zip((16, 4, 1), network(image), strict=True)
            ]
            for image in pair.images
        )
        projected = official.CAMERA.project(pair.points)
        levels = []
        for ours, theirs in zip(query, reference, strict=True):
            xy = projected.xy.float()
            features, confidence = theirs.sample(xy)
            _, inside = sample(theirs.confidence, xy[None], theirs.stride, border=3)
            unit = torch.nn.functional.normalize(ours.features, dim=1)
            level = Level(unit, ours.stride, features[None], ours.confidence, confidence[None])
            levels.append((level, inside[0]))
        # Each level of theirs uses the points that it sees in the reference.
        start = Pose(torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3).double())
        found = []
        for (level, inside), damping in zip(levels, network.damping, strict=True):
            answer = align(
                Problem(
                    [level],
                    pair.points[None],
                    official.CAMERA.intrinsics(),
                    start,
                    [damping()],
                    Options(iterations=15, adaptive_damping=False, border_cells=3),
                    inside[None],
                )
            )
            start = answer.pose
            found.append(torch.cat([start.rotation.flatten(1), start.translation], 1)[0].numpy())
    recorded = np.load(official.RECORDED)["pose"]
    np.testing.assert_allclose(np.stack(found), recorded, atol=1e-4)
    # The features are untrained, but the pictures do say where the camera moved.
    one = start.rotation.new_ones(1, len(pair.points), dtype=torch.bool)
    truth = Pose(*(t[None] for t in vars(pair.query_from_reference).values()))
    place = truth, pair.points[None], official.CAMERA.intrinsics(), one
    before = Pose(torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3).double())
    assert reprojection_error(start, *place) < 0.2 * reprojection_error(before, *place)


def test_the_loss_equals_the_official_one() -> None:
    recorded = np.load(official.RECORDED)
    start, after = official.poses_after_levels()
    truth = official.pair().query_from_reference
    count = len(start.rotation)
    points = official.pair().points.expand(count, -1, 3).clone()
    points[-1, 9:] = -1
    truths = Pose(truth.rotation.expand(count, 3, 3), truth.translation.expand(count, 3))
    seen = []
    for pose in (start, truths):
        projected = official.CAMERA.project(pose.transform(points))
        seen.append(projected.valid & official.CAMERA.contains(projected.xy, 0.5))
    place = VisiblePoints(points, official.CAMERA.intrinsics(), seen[0] & seen[1])
    loss, errors = pose_loss(after, (16, 4, 1), truths, place)
    for ours, theirs in zip(errors, recorded["errors"], strict=True):
        np.testing.assert_allclose(ours.clamp(max=50)[:-1], theirs[:-1], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(loss, recorded["loss"].mean(), rtol=1e-3)
    # One of them loses its way at the first level and finds it at the second.
    assert recorded["errors"][0].max() == 50
    assert recorded["loss"][-1] == 0
