"""Localization of one query: exceptions become failures, and failures are retried once."""

from __future__ import annotations

import logging
from dataclasses import replace

from objconnect.scene.errors import InputError, PreparationError
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.localizer import Estimate, Localizer, Prior, Query, Status
from objconnect.scene.runtime.progress import one_step

log = logging.getLogger(__name__)


def localize_safely(localizer: Localizer, query: Query) -> Estimate:
    """Localize a query; an exception of the method becomes the status ``FAILED`` and its reason.

    A pose that is missing, not finite or too far away is also a failure.

    Raises:
        InputError: the method cannot read its input.
        PreparationError: the method prepares the map with the first query, and this failed.
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
        return Estimate(
            Status.FAILED, reason=f"the pose is more than {FARTHEST_M:g} m from the map's origin"
        )
    return estimate


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
