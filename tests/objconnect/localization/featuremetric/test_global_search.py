"""Which of the poses of matches and of alignments a search believes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from objconnect.localization.coarse.finder import CoarseSearch
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.acceptance import log_odds_of
from objconnect.localization.featuremetric.attempt import Attempt
from objconnect.localization.featuremetric.global_search import GlobalSearch
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import By, Estimate, Query, Status, Stopwatch
from objconnect.scene.maps.sparse_map import SparseMap
from tests.objconnect.localization.featuremetric.test_attempt import CAMERA, OPTIONS, attempt

QUERY = Query("q.jpg", np.zeros((64, 64, 3), np.uint8), CAMERA)


def at(east: float) -> Pose:
    eye = torch.eye(3, dtype=torch.float64)
    return Pose(eye, torch.tensor([-east, 0, 0], dtype=torch.float64))


def align(east: float, probability: float, variance: float = 1e-4) -> Attempt:
    tried = attempt(variance, 0.7)
    pose = Pose(at(east).rotation[None], at(east).translation[None])
    there = replace(
        tried.alignment, pose=pose, failure=torch.zeros(1), iterations=torch.ones(1).long()
    )
    return replace(tried, alignment=there, log_odds=log_odds_of(probability))


def match(probability: float) -> Estimate:
    return Estimate(
        Status.OK, at(0), np.eye(6) / 1e4, inliers=20, by=By.MATCHES, probability=probability
    )


def search(*attempts: Attempt) -> GlobalSearch:
    """A search of one place, whose refiner gives these attempts in turn."""
    given = iter(attempts)

    def near(*_: Any) -> Attempt:
        return next(given)

    refine = SimpleNamespace(config=SimpleNamespace(search=OPTIONS), near=near)
    places = SimpleNamespace(find=lambda _: [Candidate(at(80), 0.0, By.PLACE)])
    return GlobalSearch(
        cast(Refiner, refine), cast(SparseMap, None), cast(CoarseSearch, places), None
    )


def answer(told: Estimate, *attempts: Attempt) -> Estimate:
    found = search(*attempts)(QUERY, told, Stopwatch())
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("matches", "east", "alignment", "by"),
    [
        (0.9, 0.1, 0.99, By.ALIGNMENT),
        (0.99, 0.1, 0.9, By.MATCHES),
        (0.6, 40, 0.999, By.ALIGNMENT),
        (0.999, 40, 0.6, By.MATCHES),
    ],
)
def test_matches_and_alignment_share_one_probability(
    matches: float, east: float, alignment: float, by: By
) -> None:
    found = answer(match(matches), align(east, alignment))
    assert (found.status, found.by) == (Status.OK, by)
    assert found.probability is not None and found.probability > 0.95


def test_matches_that_say_another_place_are_not_forgotten() -> None:
    """Both are as likely; what is tried later at a third place changes nothing."""
    found = answer(match(0.99), align(40, 0.99), align(80, 0.01))
    assert found.status is Status.FALLBACK
    assert found.probability is not None and found.probability < 0.5


def test_an_inexact_alignment_does_not_lend_its_probability_to_matches_elsewhere() -> None:
    far = align(40, 0.9999, variance=9.0)
    found = answer(match(0.6), far, align(80, 0.01), far)
    assert found.status is Status.FALLBACK and "known to" in found.reason
