"""Where a query's pose is not known, the localizer finds its starts itself."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmark.evaluation.starts import gravity_prior, position_prior
from objconnect.localization.featuremetric.acceptance import AcceptanceModel
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.methods import create
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import warp_image
from objconnect.scene.localizer import Estimate, Localizer, PoseSource, Query, Status, Stopwatch
from tests.baselines.test_hostile import DATASET, QUERY, TRUTH, WHOLE, noise

SETTINGS: dict[str, dict[str, Any]] = {
    "matches": {"place": {"candidates": 0}},
    "search": {"matches": None},
}
# What nobody knows of the query's pose, by what is told.
PRIORS = {
    "none": None,
    "gravity": gravity_prior(TRUTH, QUERY.name, 3.0),
    "gps": position_prior(TRUTH, QUERY.name, 15.0),
}


@pytest.fixture(scope="module", params=SETTINGS)
def localizer(request: pytest.FixtureRequest, cache: Path) -> Localizer:
    made = create("objconnect", SETTINGS[request.param])
    made.prepare(WHOLE, DATASET.images, cache)
    return made


def assert_right(answer: Estimate, truth: Pose = TRUTH) -> None:
    assert answer.status is Status.OK, answer.reason
    assert answer.cam_from_world is not None
    metres, degrees = (float(part) for part in answer.cam_from_world.error_to(truth))
    assert metres < 0.5 and degrees < 1


@pytest.mark.parametrize("told", PRIORS)
def test_each_source_of_starts_leads_to_the_pose(localizer: Localizer, told: str) -> None:
    assert_right(localizer.localize(replace(QUERY, prior=PRIORS[told])))


@torch.inference_mode()
def test_a_pose_of_a_low_peak_is_not_aligned_to_the_end(localizer: FeaturemetricLocalizer) -> None:
    refine = localizer.map_state.refine
    whole = refine.align_near(QUERY, TRUTH, Stopwatch())
    short = refine.align_near(QUERY, TRUTH, Stopwatch(), least_peak=1000.0)
    assert whole.evidence is not None and whole.log_odds > 0
    assert not short.has_failed and short.evidence is None and short.log_odds == -math.inf
    same = refine.align_near(QUERY, TRUTH, Stopwatch(), least_peak=0.9 * whole.evidence.peak)
    assert same.log_odds == whole.log_odds


MODEL = AcceptanceModel.load_beside(None)
NO_ALIGNMENT = {"bias": -20, "peak": 0, "halves": 0, "curvature": 0}
MATCHED: dict[str, dict[str, Any]] = {
    "many": {"matched_answer_inliers": 20},
    "not aligned": {"matched_answer_inliers": 10**6, "acceptance": {"aligned": NO_ALIGNMENT}},
    "aligned": {"matched_answer_inliers": 10**6},
}


@pytest.mark.parametrize("case", MATCHED)
def test_poses_of_matches_are_answered_unless_an_aligned_one_is_believed(
    case: str, cache: Path
) -> None:
    search = dict(MATCHED[case])
    if "acceptance" in search:
        search["acceptance"] |= {"matched": MODEL.matched.model_dump()}
    sift, localizer = create("sift", {}), create("objconnect", {"search": search})
    for each in (sift, localizer):
        each.prepare(WHOLE, DATASET.images, cache)
    query = replace(QUERY, prior=None)
    matched, answer = sift.localize(query), localizer.localize(query)
    assert matched.inliers >= 30 and matched.cam_from_world is not None
    assert answer.cam_from_world is not None
    metres, _ = answer.cam_from_world.error_to(matched.cam_from_world)
    assert (float(metres) < 1e-9) == (case != "aligned")
    assert answer.by is (PoseSource.ALIGNMENT if case == "aligned" else PoseSource.MATCHES)
    assert_right(answer)


def test_a_picture_upside_down_is_found(localizer: Localizer) -> None:
    view = warp_image(QUERY.image, QUERY.camera, math.pi)
    answer = localizer.localize(Query(QUERY.name, view.picture, view.camera))
    assert_right(answer, view.pose(TRUTH))


# In the default part every method is asked about noise (``test_hostile``).
@pytest.mark.thorough
def test_what_no_place_fits_is_no_answer(localizer: Localizer) -> None:
    nothing = replace(QUERY, image=noise(QUERY.image.shape), prior=None)
    answer = localizer.localize(nothing)
    assert answer.status is not Status.OK and answer.reason
