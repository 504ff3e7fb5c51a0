"""Comparison of the estimate of one query with its reference pose."""

from __future__ import annotations

import torch

from benchmark.datasets.dataset import BenchmarkQuery
from benchmark.results.query_result import LARGEST_NEES, TOTAL, QueryResult
from benchmark.scoring.uncertainty import compute_nees
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.localizer import Estimate, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.answers import pose_of


def score_query(
    query: BenchmarkQuery, estimate: Estimate, sparse_map: SparseMap, seconds: float | None
) -> QueryResult:
    """Compare an estimate with the reference pose of its query.

    Args:
        query: query with its reference pose.
        estimate: answer of a method.
        sparse_map: map, for the height of the query above its points.
        seconds: wall-clock time of the method's call; None where it was not measured.
    """
    pose = estimate.cam_from_world if estimate.status is not Status.FAILED else None
    numbers = t_err = r_err = nees = None
    if pose is not None:
        pose = pose.to(dtype=torch.float64, device=torch.device("cpu"))
        numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        # The pose is scored as the file stores it, so that the figures can be recomputed.
        metres, degrees = pose_of(numbers).error_to(query.reference)
        t_err, r_err = float(metres), float(degrees)
        nees = compute_nees(pose_of(numbers), query.reference, estimate.covariance)
        nees = None if nees is None else min(nees, LARGEST_NEES)
    sigma = estimate.sigma_position()
    return QueryResult(
        name=query.name,
        condition=query.condition,
        group=query.group,
        altitude_m=sparse_map.height_above(query.reference.centre().numpy()),
        status=estimate.status,
        reason=estimate.reason,
        t_err_m=t_err,
        r_err_deg=r_err,
        cam_from_world=numbers,
        # A covariance larger than any scene carries no information.
        sigma_t_m=sigma if sigma is not None and sigma <= FARTHEST_M else None,
        nees=nees,
        iterations=estimate.iterations,
        inliers=estimate.inliers,
        seconds=estimate.seconds | ({} if seconds is None else {TOTAL: seconds}),
        by=estimate.by,
        probability=estimate.probability,
    )
