"""Sequences: what the motion predicts, contradictions, and being lost and found again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.localization.pipeline.tracking import SequenceConfig, Tracker
from objconnect.scene.config import Config
from objconnect.scene.geometry.gimbal import gimbal_pose
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, PoseSource, Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from tests.benchmark.made_data import CAMERA

STEP = 0.5
SURE = 1e-4 * np.eye(6)
NOTHING = Estimate(Status.FAILED, reason="nothing")


def pose_at(frame: float, aside: float = 0.0) -> Pose:
    """A drone at 6 m/s to the east that looks down and turns by 10 degrees a second."""
    rotation = gimbal_pose(10 * STEP * frame, -80.0, 0.0).rotation
    centre = torch.tensor([6 * STEP * frame, aside, 70.0], dtype=torch.float64)
    return Pose(rotation, -rotation @ centre)


def make_estimate(pose: Pose) -> Estimate:
    return Estimate(Status.OK, pose, SURE, inliers=50)


@dataclass
class Scripted:
    """A localizer whose answers a function of the query gives; it keeps the queries."""

    answer: Callable[[Query], Estimate]
    name: str = "scripted"
    weights_sha256: str | None = None
    config: Config = field(default_factory=Config)
    seen: list[Query] = field(default_factory=list)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        raise NotImplementedError

    def localize(self, query: Query) -> Estimate:
        self.seen.append(query)
        return self.answer(query)


def frame_of(query: Query) -> int:
    return int(query.name)


def near(query: Query) -> bool:
    """Whether the motion's prior was given: it is within 3 m of where the camera is."""
    if query.prior is None:
        return False
    truth = pose_at(frame_of(query)).centre().numpy()
    return bool(np.linalg.norm(query.prior.position - truth) < 3)


def run(
    answer: Callable[[Query], Estimate],
    frames: int = 12,
    config: SequenceConfig | None = None,
    telemetry: Callable[[int], Prior | None] = lambda frame: None,
) -> tuple[list[Estimate], Scripted, Tracker]:
    localizer = Scripted(answer)
    tracker = Tracker(localizer, config or SequenceConfig())
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    estimates = []
    for frame in range(frames):
        query = Query(str(frame), image, CAMERA, telemetry(frame))
        estimates.append(tracker.localize(query, STEP * frame))
        tracker.update(estimates[-1], STEP * frame)
    return estimates, localizer, tracker


def test_one_search_then_the_motion_is_the_prior() -> None:
    estimates, localizer, tracker = run(lambda query: make_estimate(pose_at(frame_of(query))))

    assert [e.status for e in estimates] == [Status.OK] * 12
    assert tracker.search_count == 1 and len(localizer.seen) == 12
    assert localizer.seen[0].prior is None
    for query in localizer.seen[6:]:
        truth = pose_at(frame_of(query))
        prior = query.prior
        assert prior is not None and prior.cam_from_world_rotation is not None
        assert prior.position_sigma is not None and prior.attitude_sigma_deg is not None
        assert np.linalg.norm(prior.position - truth.centre().numpy()) < 0.3
        assert (prior.position_sigma < 1.5).all() and prior.attitude_sigma_deg < 8
        rotation = Pose(torch.from_numpy(prior.cam_from_world_rotation), truth.translation)
        assert float(rotation.error_to(truth)[1]) < 1


def test_a_false_answer_beside_the_prediction_is_checked_and_mended() -> None:
    """With the motion's prior, frame 8 is answered 6 m aside; the search finds where it is."""

    def answer(query: Query) -> Estimate:
        aside = 6.0 if frame_of(query) == 8 and near(query) else 0.0
        return make_estimate(pose_at(frame_of(query), aside))

    estimates, _, tracker = run(answer)
    assert tracker.search_count == 2
    for frame, estimate in enumerate(estimates):
        assert estimate.cam_from_world is not None
        assert float(estimate.cam_from_world.error_to(pose_at(frame))[0]) < 1e-9


def test_a_track_that_contradicts_the_motion_is_localized_as_any_image_near_its_prior() -> None:
    """Followed, frame 8 is answered 6 m aside; near its prior, where it is: nothing is searched."""

    def answer(query: Query) -> Estimate:
        aside = 6.0 if frame_of(query) == 8 and query.tracked else 0.0
        by = PoseSource.TRACKING if query.tracked else PoseSource.ALIGNMENT
        return replace(make_estimate(pose_at(frame_of(query), aside)), by=by)

    estimates, localizer, tracker = run(answer)
    assert tracker.search_count == 1
    assert [query.tracked for query in localizer.seen if frame_of(query) == 8] == [True, False]
    assert [query.tracked for query in localizer.seen if frame_of(query) == 7] == [True]
    pose = estimates[8].cam_from_world
    assert pose is not None and float(pose.error_to(pose_at(8))[0]) < 1e-9
    assert not localizer.seen[0].tracked  # the first was searched


def test_a_search_that_contradicts_a_sure_motion_is_not_believed() -> None:
    """Frame 8 looks like a place 80 m away: with and without a prior."""

    def answer(query: Query) -> Estimate:
        if frame_of(query) == 8:
            return NOTHING if near(query) else make_estimate(pose_at(8, aside=80.0))
        return make_estimate(pose_at(frame_of(query)))

    estimates, _, _ = run(answer)
    assert [e.status is Status.OK for e in estimates] == [k != 8 for k in range(12)]
    assert "contradicts the motion" in estimates[8].reason


def test_a_real_jump_is_believed_when_both_find_it() -> None:
    """A gust of wind: the prior and the search lead to one pose beyond the gate."""

    def answer(query: Query) -> Estimate:
        return make_estimate(pose_at(frame_of(query), aside=7.0 if frame_of(query) >= 8 else 0.0))

    estimates, _, tracker = run(answer)
    assert all(e.status is Status.OK for e in estimates)
    assert tracker.search_count == 2


def test_a_false_first_answer_does_not_keep_the_right_ones_out() -> None:
    """The first image is taken for another place; the motion that began there is not yet sure."""

    def answer(query: Query) -> Estimate:
        if frame_of(query) == 0:
            return make_estimate(pose_at(0, aside=120.0))
        far = query.prior is not None and not near(query)
        return NOTHING if far else make_estimate(pose_at(frame_of(query)))

    estimates, _, _ = run(answer, frames=6)
    for frame in range(1, 6):
        pose = estimates[frame].cam_from_world
        assert pose is not None and float(pose.error_to(pose_at(frame))[0]) < 1e-9


def test_lost_after_some_failures_and_found_by_a_search() -> None:
    """Frames 5 to 10 show water. Frame 11 is searched, from nothing, and tracking goes on."""

    def answer(query: Query) -> Estimate:
        return NOTHING if 5 <= frame_of(query) <= 10 else make_estimate(pose_at(frame_of(query)))

    estimates, localizer, _ = run(answer, frames=16, config=SequenceConfig(lost_after=3))
    assert [k for k, e in enumerate(estimates) if e.status is not Status.OK] == [5, 6, 7, 8, 9, 10]
    asked = {
        frame: [query.prior is not None for query in localizer.seen if frame_of(query) == frame]
        for frame in (5, 8, 11, 12)
    }
    # At first the motion is asked, then the search; once lost, only the search.
    assert asked == {5: [True, False], 8: [False], 11: [False], 12: [True]}


def test_what_the_aircraft_knows_is_where_a_search_begins() -> None:
    def telemetry(frame: int) -> Prior:
        centre = pose_at(frame).centre().numpy()
        rotation = gimbal_pose(100.0, -80.0, 0.0).rotation.numpy()  # a wrong compass
        return Prior(centre + 5, np.full(3, 10.0), rotation, 5.0)

    def answer(query: Query) -> Estimate:
        prior = query.prior
        assert prior is not None
        told = prior.cam_from_world_rotation is not None and prior.attitude_sigma_deg == 5.0
        return NOTHING if told else make_estimate(pose_at(frame_of(query)))

    estimates, localizer, tracker = run(answer, frames=4, telemetry=telemetry)
    assert all(e.status is Status.OK for e in estimates) and tracker.search_count == 1
    # The search is tried with the attitude, then without.
    assert [q.prior.cam_from_world_rotation is None for q in localizer.seen[:2] if q.prior] == [
        False,
        True,
    ]


def test_an_answer_far_from_gps_is_checked() -> None:
    """A false lock 100 m away that moves evenly is left when GPS comes back."""

    def telemetry(frame: int) -> Prior | None:
        if frame < 6:
            return None
        return Prior(pose_at(frame).centre().numpy(), np.full(3, 3.0))

    def answer(query: Query) -> Estimate:
        prior = query.prior
        locked = prior is None or prior.position[1] > 50
        return make_estimate(pose_at(frame_of(query), aside=100.0 if locked else 0.0))

    config = SequenceConfig(lost_after=2)
    estimates, _, _ = run(answer, frames=10, telemetry=telemetry, config=config)
    errors = [
        None if e.cam_from_world is None else float(e.cam_from_world.error_to(pose_at(k))[0])
        for k, e in enumerate(estimates)
    ]
    assert errors[5] == pytest.approx(100.0)
    # Two images are not answered, for the motion was sure; then the search is believed.
    assert errors[6] is errors[7] is None
    assert errors[8] == pytest.approx(0.0, abs=1e-9) and errors[9] == pytest.approx(0.0, abs=1e-9)


def test_a_pause_ends_what_the_motion_knows() -> None:
    """After a gap of a minute the motion predicts nothing, and the image is searched."""
    localizer = Scripted(lambda query: make_estimate(pose_at(frame_of(query))))
    tracker = Tracker(localizer, SequenceConfig())
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    for frame, seconds in ((0, 0.0), (1, 0.5), (2, 1.0), (120, 61.0)):
        estimate = tracker.localize(Query(str(frame), image, CAMERA), seconds)
        tracker.update(estimate, seconds)
    assert [query.prior is None for query in localizer.seen] == [True, False, False, True]


def test_answers_of_an_interrupted_run_are_taken_up() -> None:
    def answer(query: Query) -> Estimate:
        return make_estimate(pose_at(frame_of(query)))

    whole, straight, _ = run(answer)
    localizer = Scripted(answer)
    tracker = Tracker(localizer, SequenceConfig())
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    for frame in range(7):
        tracker.update(whole[frame], STEP * frame)
    for frame in range(7, 12):
        estimate = tracker.localize(Query(str(frame), image, CAMERA), STEP * frame)
        tracker.update(estimate, STEP * frame)
    for query, before in zip(localizer.seen, straight.seen[7:], strict=True):
        assert query.prior is not None and before.prior is not None
        np.testing.assert_array_equal(query.prior.position, before.prior.position)
        np.testing.assert_array_equal(query.prior.position_sigma, before.prior.position_sigma)
