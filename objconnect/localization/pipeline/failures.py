"""Asking a method: its exceptions are failures, and a failure may be tried again."""

from __future__ import annotations

import logging
from dataclasses import replace

from objconnect.scene.errors import InputError, PreparationError
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.localizer import Estimate, Localizer, Prior, Query, Status
from objconnect.scene.runtime.progress import one_step

log = logging.getLogger(__name__)


def localize_safely(localizer: Localizer, query: Query) -> Estimate:
    """Localize a query, where an exception of the method counts as a failure.

    A pose that is missing, not finite or too far away is a failure, too. The estimate then has the
    status ``FAILED`` and states the reason.

    Raises:
        InputError: the method cannot read its input.
        PreparationError: the method cannot prepare the map, which it had left until now.
    """
    try:
        with one_step():
            estimate = localizer.localize(query)
    except (InputError, PreparationError):
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        log.warning("%s failed on %s: %s", localizer.name, query.name, " ".join(reason.split()))
        return Estimate(Status.FAILED, reason=reason)
    if estimate.status is Status.FAILED:
        return estimate
    if estimate.cam_from_world is None:
        return Estimate(Status.FAILED, reason=f"answered '{estimate.status}' without a pose")
    matrix = estimate.cam_from_world.matrix()
    if not bool(matrix.isfinite().all()):
        return Estimate(Status.FAILED, reason="the pose is not finite")
    if bool((matrix.abs() > FARTHEST_M).any()):
        return Estimate(Status.FAILED, reason=f"the pose is more than {FARTHEST_M:g} m away")
    return estimate


def localize_retrying(localizer: Localizer, query: Query) -> Estimate:
    """Localize a query; where it is not found, once more without its attitude, which may be wrong.

    A picture may have been rotated after it was taken. Arguments and errors are those of
    ``localize_safely``.
    """
    estimate, prior = localize_safely(localizer, query), query.prior
    if estimate.status is Status.OK or prior is None or prior.cam_from_world_rotation is None:
        return estimate
    position = Prior(prior.position, prior.position_sigma) if prior.has_position else None
    second = localize_safely(localizer, replace(query, prior=position))
    return second if second.status is Status.OK else estimate
