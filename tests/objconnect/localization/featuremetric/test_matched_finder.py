"""The pose of another method is one more start, and nothing changes without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.matched_finder import MatchedFinder
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.localization.provenance import Method
from objconnect.methods import create
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, PoseSource, Prior, Query, Status
from tests.baselines.lightglue.weights import options_of
from tests.baselines.test_hostile import DATASET, QUERY, TRUTH, WHOLE

# Neither matches of its own nor a search: the starts are the prior, or similar photographs.
ALONE: Mapping[str, Any] = {"matches": None, "objects": None, "place": {"candidates": 0}}
WITH_SIFT = {**ALONE, "search": {"matcher": "sift"}}
# A position 60 m off that claims no sigma, so that no candidate contradicts it.
WRONG = Prior(
    TRUTH.centre().numpy() + np.array([60.0, 0, 0]),
    cam_from_world_rotation=TRUTH.rotation.numpy(),
)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map is always the same."""
    return tmp_path_factory.mktemp("cache")


def prepare(options: Mapping[str, Any], cache: Path) -> Localizer:
    localizer = create("objconnect", options)
    localizer.prepare(WHOLE, DATASET.images, cache)
    return localizer


def metres_off(estimate: Estimate) -> float:
    assert estimate.cam_from_world is not None
    return float(estimate.cam_from_world.error_to(TRUTH)[0])


@pytest.mark.parametrize(
    ("matcher", "options"),
    [
        ("sift", {}),
        pytest.param("aliked+lightglue", None, marks=pytest.mark.thorough),
    ],
)
def test_another_method_leads_to_the_pose_from_a_wrong_prior(
    matcher: str, options: dict[str, Any] | None, cache: Path
) -> None:
    wrong = replace(QUERY, prior=WRONG)
    alone = prepare(ALONE, cache).localize(wrong)
    assert alone.status is not Status.OK
    search = {"matcher": {"method": matcher, **(options or options_of(matcher))}}
    answer = prepare({**ALONE, "search": search}, cache).localize(wrong)
    assert answer.status is Status.OK, answer.reason
    assert answer.by is PoseSource.ALIGNMENT and "matcher" in answer.seconds
    assert metres_off(answer) < 0.5


def test_an_answer_without_it_is_the_same(cache: Path) -> None:
    """It is asked only where the other starts give no answer."""
    answers = [prepare(options, cache).localize(QUERY) for options in (ALONE, WITH_SIFT)]
    poses = [answer.cam_from_world for answer in answers]
    assert poses[0] is not None and poses[1] is not None
    assert np.array_equal(poses[0].matrix().numpy(), poses[1].matrix().numpy())
    assert "matcher" not in answers[1].seconds


def test_results_record_it(cache: Path) -> None:
    alone, with_sift = (create("objconnect", options) for options in (ALONE, WITH_SIFT))
    assert Method.of(with_sift).config["search"]["matcher"] == {"method": "sift"}
    assert alone.weights_sha256 != with_sift.weights_sha256
    assert SearchOptions().matcher is None
    assert isinstance(alone, FeaturemetricLocalizer) and alone.matched_finder is None


@pytest.mark.parametrize(
    ("search", "said"),
    [
        ({"matcher": "shift"}, r"search\.matcher: unknown method 'shift'"),
        ({"matcher": {"method": "sift", "rati": 1}}, r"search\.matcher: unknown key 'rati'"),
        ({"matcher": {"ratio": 0.8}}, r"'search\.matcher' .*: give the name of a method"),
        ({"matcher": 7}, r"'search\.matcher'"),
    ],
)
def test_what_it_cannot_be_is_said(search: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        create("objconnect", {"search": search})


def test_what_it_lacks_is_said(cache: Path) -> None:
    def prepare(*_: object) -> None:
        raise InputError("kornia is not installed")

    finder = MatchedFinder(cast(Localizer, SimpleNamespace(name="mine", prepare=prepare)))
    with pytest.raises(InputError, match="^search.matcher mine: kornia is not installed"):
        finder.prepare(cast(Any, SimpleNamespace(sparse_map=WHOLE, images=cache, folder=cache)))


def find(status: Status, pose: Pose | None, prior: Prior | None) -> list[Pose]:
    asked: list[Query] = []

    def localize(query: Query) -> Estimate:
        asked.append(query)
        return Estimate(status, pose, inliers=7)

    finder = MatchedFinder(cast(Localizer, SimpleNamespace(name="mine", localize=localize)))
    found = finder.find(replace(QUERY, prior=prior, tracked=True))
    assert not asked[0].tracked
    assert all((each.score, each.by) == (7, PoseSource.MATCHES) for each in found)
    return [each.pose for each in found]


def test_an_answer_that_the_prior_allows_is_a_candidate() -> None:
    near = replace(WRONG, position=TRUTH.centre().numpy(), position_sigma=np.ones(3))
    far = replace(WRONG, position_sigma=np.ones(3))
    assert find(Status.OK, TRUTH, None) == find(Status.OK, TRUTH, near) == [TRUTH]
    assert find(Status.OK, TRUTH, far) == []
    assert find(Status.FALLBACK, TRUTH, None) == find(Status.FAILED, None, None) == []
