"""Which candidates a search aligns, and which of the poses it believes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch

import objconnect.localization.featuremetric.global_search as global_search
from objconnect.localization.align.options import SearchRadius
from objconnect.localization.coarse.finder import CoarseSearch
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.acceptance import log_odds_of
from objconnect.localization.featuremetric.attempt import Attempt
from objconnect.localization.featuremetric.global_search import GlobalSearch
from objconnect.localization.featuremetric.matched_finder import MatchedFinder
from objconnect.localization.featuremetric.priors import DEFAULT_RADIUS
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.featuremetric.screening import ScreenedCandidate
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, PoseSource, Query, Status, Stopwatch
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
        Status.OK,
        at(0),
        np.eye(6) / 1e4,
        inliers=20,
        by=PoseSource.MATCHES,
        probability=probability,
    )


@pytest.fixture(autouse=True)
def peaks(monkeypatch: pytest.MonkeyPatch) -> dict[float, float]:
    """Peak-to-sidelobe ratios by the easting of a candidate; 9 if it is not listed."""
    listed: dict[float, float] = {}

    def screen(
        _: Refiner, __: Query, candidates: Sequence[Candidate], ___: Stopwatch
    ) -> Iterator[ScreenedCandidate]:
        for each in candidates:
            yield ScreenedCandidate(each, listed.get(east(each.pose), 9))

    monkeypatch.setattr(global_search, "screen", screen)
    return listed


def east(pose: Pose) -> float:
    return float(pose.centre()[0])


def search(
    *attempts: Attempt,
    eastings: Sequence[float] = (80,),
    more_eastings: Sequence[float] = (),
    starts: list[float] | None = None,
    matched: float | None = None,
    bounds: list[tuple[SearchRadius, float]] | None = None,
) -> GlobalSearch:
    """A search with two lists of candidates, whose refiner gives these attempts in turn.

    The pose of another method is at the easting ``matched``.
    """
    given = iter(attempts)

    def near(
        _: Query,
        start: Pose,
        __: Stopwatch,
        radius: SearchRadius = DEFAULT_RADIUS,
        least_peak: float = 0.0,
    ) -> Attempt:
        if starts is not None:
            starts.append(east(start))
        if bounds is not None:
            bounds.append((radius, least_peak))
        return next(given)

    refine = SimpleNamespace(config=SimpleNamespace(search=OPTIONS), align_near=near)
    lists = [
        [Candidate(at(each), 0.0, PoseSource.PLACE) for each in some]
        for some in (eastings, more_eastings)
    ]
    coarse = SimpleNamespace(find=lambda _: iter(lists))
    finder = None
    if matched is not None:
        another = Candidate(at(matched), 0.0, PoseSource.MATCHES)
        finder = cast(MatchedFinder, SimpleNamespace(find=lambda _: [another]))
    return GlobalSearch(
        cast(Refiner, refine), cast(SparseMap, None), cast(CoarseSearch, coarse), None, finder
    )


def answer(told: Estimate, *attempts: Attempt) -> Estimate:
    found = search(*attempts)(QUERY, told, Stopwatch())
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("matches", "east", "alignment", "by"),
    [
        (0.9, 0.1, 0.99, PoseSource.ALIGNMENT),
        (0.99, 0.1, 0.9, PoseSource.MATCHES),
        (0.6, 40, 0.999, PoseSource.ALIGNMENT),
        (0.999, 40, 0.6, PoseSource.MATCHES),
    ],
)
def test_matches_and_alignment_share_one_probability(
    matches: float, east: float, alignment: float, by: PoseSource
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
    assert found.status is Status.FALLBACK and "standard deviation" in found.reason


def test_after_the_first_candidate_clear_peaks_are_aligned_and_then_the_highest(
    peaks: dict[float, float],
) -> None:
    peaks.update({10: 1.0, 20: 3.6, 30: 8.0, 40: 4.0, 50: 5.0})
    starts: list[float] = []
    attempts = align(10, 0.1), align(30, 0.1), align(50, 0.5), align(40, 0.999)
    made = search(*attempts, eastings=(10, 20, 30, 40, 50), starts=starts)
    found = made(QUERY, None, Stopwatch())
    assert found is not None and found.status is Status.OK
    assert starts == [10, 30, 50, 40]


@pytest.mark.parametrize(("moved_m", "aligned"), [(2.9, [20]), (3.1, [20, 23.1])])
def test_an_image_is_aligned_again_only_from_a_pose_far_from_its_candidate(
    moved_m: float, aligned: list[float]
) -> None:
    starts: list[float] = []
    attempts = align(20 + moved_m, 0.999), align(20 + moved_m, 0.999)
    found = search(*attempts, eastings=(20,), starts=starts)(QUERY, None, Stopwatch())
    assert found is not None and found.status is Status.OK
    assert starts == pytest.approx(aligned)


def test_candidates_of_low_peaks_are_not_aligned(peaks: dict[float, float]) -> None:
    peaks.update({10: 1.0, 20: 8.0, 30: 2.0})
    starts: list[float] = []
    attempts = align(10, 0.1), align(20, 0.1)
    found = search(*attempts, eastings=(10, 20, 30), starts=starts)(QUERY, None, Stopwatch())
    assert found is not None and found.status is Status.FALLBACK
    assert starts == [10, 20]


def test_the_three_highest_of_all_unclear_peaks_are_aligned_last(peaks: dict[float, float]) -> None:
    peaks.update({20: 3.6, 30: 4.5, 50: 4.0, 60: 6.0, 70: 4.2})
    starts: list[float] = []
    attempts = [align(each, 0.1) for each in (10, 40, 60, 30, 70, 50)]
    made = search(*attempts, eastings=(10, 20, 30), more_eastings=(40, 50, 60, 70), starts=starts)
    found = made(QUERY, None, Stopwatch())
    assert found is not None and found.status is Status.FALLBACK
    assert starts == [10, 40, 60, 30, 70, 50]


def test_the_first_candidate_of_each_list_is_not_screened(peaks: dict[float, float]) -> None:
    peaks.update({10: 2.0, 20: 2.0, 40: 2.0, 50: 2.0})
    starts: list[float] = []
    attempts = align(10, 0.1), align(40, 0.1)
    made = search(*attempts, eastings=(10, 20), more_eastings=(40, 50), starts=starts)
    found = made(QUERY, None, Stopwatch())
    assert found is not None and found.status is Status.FALLBACK
    assert starts == [10, 40]


def test_a_picture_too_small_to_be_screened_is_aligned(peaks: dict[float, float]) -> None:
    peaks.update({20: 5.0, 30: math.nan})
    starts: list[float] = []
    attempts = align(10, 0.1), align(30, 0.1), align(20, 0.1)
    found = search(*attempts, eastings=(10, 20, 30), starts=starts)(QUERY, None, Stopwatch())
    assert found is not None and found.status is Status.FALLBACK
    assert starts == [10, 30, 20]


def test_another_method_is_asked_last() -> None:
    starts: list[float] = []
    bounds: list[tuple[SearchRadius, float]] = []
    attempts = align(10, 0.1), align(60, 0.99), align(60, 0.99)
    made = search(*attempts, eastings=(10,), starts=starts, matched=50, bounds=bounds)
    found = made(QUERY, None, Stopwatch())
    assert found is not None and (found.status, found.by) == (Status.OK, PoseSource.ALIGNMENT)
    assert starts == [10, 50, 60]
    least = global_search._SEARCHED_PEAK * OPTIONS.least_peak
    expected = [(DEFAULT_RADIUS, least), (global_search.MATCHES_RADIUS, least), (DEFAULT_RADIUS, 0)]
    assert bounds == expected


def test_another_method_is_not_asked_if_another_pose_is_probable() -> None:
    starts: list[float] = []
    found = search(align(10, 0.99), eastings=(10,), starts=starts, matched=50)
    answered = found(QUERY, None, Stopwatch())
    assert answered is not None and answered.status is Status.OK
    assert starts == [10]
