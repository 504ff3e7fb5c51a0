"""Images of a sequence: one alignment from the prediction, and the full query where it is off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.options import TrackingOptions
from objconnect.localization.featuremetric.tracking import Tracking
from objconnect.methods import create
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import warp_image
from objconnect.scene.localizer import Estimate, PoseSource, Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.pixloc.made_map import CAMERA, looking_down, photograph, write_map

TRUTH = looking_down(9.3, -0.4, (1.5, -1.0, 4.0))
METHODS = ("objconnect", "pixloc")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> tuple[SparseMap, Path, Path]:
    images = tmp_path_factory.mktemp("map") / "images"
    return write_map(images), images, cache


@pytest.fixture(scope="module", params=METHODS)
def localizer(
    request: pytest.FixtureRequest, made: tuple[SparseMap, Path, Path]
) -> FeaturemetricLocalizer:
    method = create(request.param, {})
    assert isinstance(method, FeaturemetricLocalizer)
    method.prepare(*made)
    return method


def query_of(start: Pose, sigma_m: float = 0.2, sigma_deg: float = 0.5, **more: Any) -> Query:
    prior = Prior(start.centre().numpy(), np.full(3, sigma_m), start.rotation.numpy(), sigma_deg)
    return Query("q.png", photograph(TRUTH), CAMERA, prior, **more)


def errors(estimate: Estimate) -> tuple[float, float]:
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(TRUTH)
    return float(metres), float(degrees)


def same(one: Estimate, other: Estimate) -> bool:
    """Whether two answers are one but for the time they took."""
    assert one.cam_from_world is not None and other.cam_from_world is not None
    poses = [each.cam_from_world.matrix() for each in (one, other) if each.cam_from_world]
    alike = [
        (each.status, each.inliers, each.iterations, each.reason, str(each.covariance))
        for each in (one, other)
    ]
    return bool((poses[0] == poses[1]).all()) and alike[0] == alike[1]


def test_a_track_agrees_with_the_full_query(localizer: FeaturemetricLocalizer) -> None:
    start = looking_down(9.15, -0.3, (1.4, -0.9, 3.7))
    followed = localizer.localize(query_of(start, tracked=True))
    full = localizer.localize(query_of(start))
    assert followed.cam_from_world is not None and full.cam_from_world is not None
    apart = followed.cam_from_world.error_to(full.cam_from_world)
    for metres, degrees in (errors(full), map(float, apart)):
        assert metres < 0.1 and degrees < 0.25
    assert (followed.by, full.by) == (PoseSource.TRACKING, PoseSource.ALIGNMENT)
    assert followed.iterations < full.iterations
    assert followed.covariance is not None and np.isfinite(followed.covariance).all()


def test_a_prediction_too_unsure_to_follow_is_answered_as_without_a_track(
    localizer: FeaturemetricLocalizer,
) -> None:
    """Its standard deviation is more than the features reach."""
    asked = query_of(looking_down(10.3, 0.3, (1.5, -1.0, 4.0)), 6.0)
    answer = localizer.localize(replace(asked, tracked=True))
    assert not answer.is_tracked and same(answer, localizer.localize(asked))


def test_a_prediction_that_is_off_misleads_nothing(localizer: FeaturemetricLocalizer) -> None:
    """Off by 1.2 m, twenty standard deviations: the picture decides."""
    asked = query_of(looking_down(10.3, 0.3, (1.5, -1.0, 4.0)), 0.05)
    metres, degrees = errors(localizer.localize(replace(asked, tracked=True)))
    assert metres < 0.2 and degrees < 0.5


def test_a_picture_of_something_else_is_not_followed(localizer: FeaturemetricLocalizer) -> None:
    image = np.random.default_rng(0).integers(0, 255, (192, 256, 3)).astype(np.uint8)
    asked = replace(query_of(TRUTH), image=image)
    found = localizer.localize(replace(asked, tracked=True))
    assert found.status is not Status.OK


@pytest.mark.parametrize(
    "unknown",
    [
        None,
        Prior(TRUTH.centre().numpy(), np.full(3, 0.2)),
        Prior(TRUTH.centre().numpy(), np.full(3, 0.2), TRUTH.rotation.numpy(), 1.0, np.inf),
    ],
)
def test_a_prior_that_lacks_a_part_is_no_track(
    localizer: FeaturemetricLocalizer, unknown: Prior | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("it was followed")

    monkeypatch.setattr(Tracking, "__call__", never)
    # As cheap as it can be: whatever comes of it.
    localizer.localize(replace(query_of(TRUTH), prior=unknown, tracked=True, references=("1.png",)))
    with pytest.raises(AssertionError, match="followed"):
        localizer.localize(query_of(TRUTH, tracked=True))


def test_without_the_option_nothing_is_followed(made: tuple[SparseMap, Path, Path]) -> None:
    method = create("pixloc", {"tracking": None})
    assert method.config.model_dump()["tracking"] is None
    method.prepare(*made)
    start = looking_down(9.15, -0.3, (1.4, -0.9, 3.7))
    asked = query_of(start)
    assert same(method.localize(replace(asked, tracked=True)), method.localize(asked))


def test_options_are_recorded() -> None:
    config = create("objconnect", {"tracking": {"points": 700}}).config.model_dump()
    assert config["tracking"] == {**TrackingOptions().model_dump(), "points": 700}


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_the_middle_of_a_view_is_where_it_was(model: str) -> None:
    """Its pixels are those of the whole view, its camera projects to them, and leads back."""
    lens = () if model == "PINHOLE" else (-0.1, 0.02, 1e-3, -2e-3)
    camera = Camera(model, 256, 192, (220.0, 224.0, 126.0, 98.0, *lens))
    whole = warp_image(photograph(TRUTH), camera, 0.5)
    part = whole.crop_middle(180)
    assert (part.camera.width, part.camera.height) == part.picture.shape[1::-1] == (180, 180)
    wide, high = whole.camera.width, whole.camera.height
    corner: NDArray[np.int64] = np.array([(wide - 180) // 2, (high - 180) // 2])
    left, top = corner
    np.testing.assert_array_equal(part.picture, whole.picture[top : top + 180, left : left + 180])
    points = torch.tensor([[0.1, -0.05, 1.0], [-0.2, 0.15, 2.0]], dtype=torch.float64)
    xy = whole.camera.project(points).xy.numpy()
    np.testing.assert_allclose(part.camera.project(points).xy.numpy(), xy - corner, atol=1e-9)
    np.testing.assert_allclose(part.in_photograph(xy - corner), whole.in_photograph(xy))
    assert whole.crop_middle(max(wide, high)) is whole
