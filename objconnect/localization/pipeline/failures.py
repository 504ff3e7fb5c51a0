"""Localization of one query: faults become failures, and failures are retried once."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from numbers import Integral
from typing import Final

import numpy as np
import torch

from objconnect.scene.errors import InputError, PreparationError
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, Prior, Query, Status
from objconnect.scene.runtime.progress import one_step

log = logging.getLogger(__name__)

# Largest entry of R R^T - I of a rotation matrix R. Matrices in single precision are within 1e-6.
_ROTATION_ERROR: Final = 1e-3


def localize_safely(localizer: Localizer, query: Query) -> Estimate:
    """Localize a query; an exception of the method becomes the status ``FAILED`` and its reason.

    So does a result that is no valid estimate, such as a rotation of another determinant than 1. A
    method that ends the process (``SystemExit``) fails too.

    Raises:
        InputError: the method cannot read its input.
        PreparationError: the method prepares the map with the first query, and this failed.
    """
    try:
        with one_step():
            estimate = localizer.localize(query)
    except (InputError, PreparationError):
        raise
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
    else:
        reason = find_fault(estimate)
        if not reason:
            return estimate
    log.warning("%s failed on %s: %s", localizer.name, query.name, " ".join(reason.split()))
    return Estimate(Status.FAILED, reason=reason)


def find_fault(estimate: object) -> str:
    """Return why the result of a method is no valid estimate; empty if it is one.

    Methods may come from other packages, which no type checker has seen.
    """
    if not isinstance(estimate, Estimate):
        return f"the method returned {type(estimate).__name__} instead of Estimate"
    status: object = estimate.status
    if not isinstance(status, Status):
        return f"the status {status!r} is no Status"
    counts: tuple[object, ...] = (estimate.inliers, estimate.iterations)
    if not all(isinstance(each, Integral) and int(each) >= 0 for each in counts):
        return "inliers and iterations are not numbers of at least 0"
    if not all(0 <= each < math.inf for each in estimate.seconds.values()):
        return "the seconds are not finite numbers of at least 0"
    if estimate.probability is not None and not 0 <= estimate.probability <= 1:
        return f"the probability {estimate.probability:g} is not between 0 and 1"
    if estimate.covariance is not None and np.shape(estimate.covariance) != (6, 6):
        return f"the covariance has the shape {np.shape(estimate.covariance)} instead of (6, 6)"
    return "" if estimate.status is Status.FAILED else _find_fault_of_pose(estimate)


def _find_fault_of_pose(estimate: Estimate) -> str:
    pose: object = estimate.cam_from_world
    if pose is None:
        return f"answered '{estimate.status}' without a pose"
    if not isinstance(pose, Pose):
        return f"the pose is {type(pose).__name__} instead of Pose"
    rotation = pose.rotation
    if rotation.shape != (3, 3) or pose.translation.shape != (3,):
        return "the pose is not a single pose"
    matrix = pose.matrix()
    if not bool(matrix.isfinite().all()):
        return "the pose is not finite"
    identity = torch.eye(3, dtype=rotation.dtype)
    error = float((rotation @ rotation.T - identity).abs().max())
    if error > _ROTATION_ERROR or float(torch.linalg.det(rotation)) < 0:
        return "the rotation of the pose is no rotation matrix"
    if bool((matrix.abs() > FARTHEST_M).any()):
        return f"the pose is more than {FARTHEST_M:g} m from the map's origin"
    return ""


def localize_with_retry(localizer: Localizer, query: Query) -> Estimate:
    """Localize a query; if that fails, retry without the prior's attitude.

    The attitude may be wrong, for example if the image was rotated after capture. Arguments and
    errors are those of ``localize_safely``.
    """
    estimate, prior = localize_safely(localizer, query), query.prior
    if estimate.status is Status.OK or prior is None or prior.cam_from_world_rotation is None:
        return estimate
    position = Prior(prior.position, prior.position_sigma) if prior.has_position else None
    second = localize_safely(localizer, replace(query, prior=position))
    return second if second.status is Status.OK else estimate
