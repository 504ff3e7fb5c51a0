"""Comparison of the estimate of one query with its reference pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from benchmark.datasets.dataset import BenchmarkQuery
from benchmark.results.query_result import LARGEST_NEES, TOTAL, QueryResult
from benchmark.scoring.uncertainty import compute_nees
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Prior, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.answers import pose_of


class QueryFacts(NamedTuple):
    """The fields of ``QueryResult`` that do not depend on the method's answer."""

    name: str
    condition: str
    group: str
    course: str | None
    altitude_m: float
    prior_t_m: float | None = None


def score_query(
    query: BenchmarkQuery,
    course: str,
    estimate: Estimate,
    sparse_map: SparseMap,
    seconds: float | None,
    prior: Prior | None = None,
) -> QueryResult:
    """Compare an estimate with the reference pose of its query.

    Args:
        query: query with its reference pose.
        course: flight path that repeated flights share, see ``Dataset.courses``.
        estimate: answer of a method.
        sparse_map: map, for the height of the query above its points.
        seconds: wall-clock time of the method's call; None where it was not measured.
        prior: prior that the method was given; None if it was given none.
    """
    facts = QueryFacts(
        name=query.name,
        condition=query.condition,
        group=query.group,
        course=course,
        altitude_m=sparse_map.height_above(query.reference.centre().numpy()),
        prior_t_m=_position_error(prior, query.reference),
    )
    return score_estimate(facts, query.reference, estimate, seconds)


def score_estimate(
    facts: QueryFacts, reference: Pose, estimate: Estimate, seconds: float | None = None
) -> QueryResult:
    """Compare an estimate with a reference pose.

    Args:
        facts: the fields of the result that do not depend on the answer.
        reference: reference cam_from_world.
        estimate: answer of a method.
        seconds: wall-clock time of the method's call; None where it was not measured.
    """
    pose = estimate.cam_from_world if estimate.status is not Status.FAILED else None
    pose_numbers = t_err = r_err = nees = None
    if pose is not None:
        pose = pose.to(dtype=torch.float64, device=torch.device("cpu"))
        pose_numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        # The pose is scored as the file stores it, so that the figures can be recomputed.
        metres, degrees = pose_of(pose_numbers).error_to(reference)
        t_err, r_err = float(metres), float(degrees)
        nees = compute_nees(pose_of(pose_numbers), reference, estimate.covariance)
        nees = None if nees is None else min(nees, LARGEST_NEES)
    sigma = estimate.sigma_position()
    return QueryResult(
        name=facts.name,
        condition=facts.condition,
        group=facts.group,
        course=facts.course,
        altitude_m=facts.altitude_m,
        status=estimate.status,
        reason=estimate.reason,
        t_err_m=t_err,
        r_err_deg=r_err,
        cam_from_world=pose_numbers,
        # A covariance larger than any scene carries no information.
        sigma_t_m=sigma if sigma is not None and sigma <= FARTHEST_M else None,
        nees=nees,
        iterations=estimate.iterations,
        inliers=estimate.inliers,
        seconds=estimate.seconds | ({} if seconds is None else {TOTAL: seconds}),
        by=estimate.by,
        probability=estimate.probability,
        prior_t_m=facts.prior_t_m,
    )


def _position_error(prior: Prior | None, reference: Pose) -> float | None:
    """Return how far the position of a prior is from the reference position, metres.

    It is None without a prior, or where the height or the horizontal position is unknown.
    """
    if prior is None:
        return None
    if prior.position_sigma is not None and not np.isfinite(prior.position_sigma).all():
        return None
    return float(np.linalg.norm(prior.position - reference.centre().numpy()))
