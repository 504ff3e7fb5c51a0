"""Comparison of estimated positions with the GPS positions of the photographs."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from objconnect.localization.pipeline.answers import Geography, Located

log = logging.getLogger(__name__)

# With fewer photographs, all of them may have a bad fix.
_MIN_PHOTOGRAPHS: Final = 5
# Standard deviations of one axis. An error that all photographs share exceeds them with a
# probability of 1 / 90 horizontally and of 1 / 370 vertically.
_FAR: Final = 3.0
# A receiver without corrections is off by less at 95 % of sites (m; GPS SPS standard of 2020).
_RECEIVER_M: Final = 8.0
# No receiver has a smaller standard deviation (m).
_MIN_SIGMA_M: Final = 1e-3


class Disagreement(NamedTuple):
    """Distances between estimated and measured positions.

    Attributes:
        photographs: number of photographs that have both positions.
        across_m: median horizontal distance, metres.
        up_m: median height of the estimates above the measurements, metres; None if no height
            was measured.
        height_error_m: median absolute difference of the heights, metres; None as ``up_m``.
        far_across: whether the horizontal distances are far larger than the sigmas.
        far_up: whether the height differences are far larger than the sigmas.
        far_within: whether the map's accuracy on earth is unknown, and the horizontal distances are
            larger than those of a receiver, and far larger than the sigmas within the map.
    """

    photographs: int
    across_m: float
    up_m: float | None
    height_error_m: float | None
    far_across: bool
    far_up: bool
    far_within: bool


class _Compared(NamedTuple):
    across_m: float
    across_sigmas: float
    within_sigmas: float
    up_m: float
    up_sigmas: float


def measure_disagreement(located: Sequence[Located], geography: Geography) -> Disagreement | None:
    """Compare estimated with measured positions; None if fewer than five photographs have both.

    Distances are divided by the standard deviation of their difference. The estimate's standard
    deviation includes the map's georeference if the accuracy of that is known.
    """
    compared = np.array(list(_compare(located, geography))).reshape(-1, 5)
    if len(compared) < _MIN_PHOTOGRAPHS:
        return None
    across, across_sigmas, within_sigmas = np.median(compared[:, :3], axis=0).tolist()
    heights = compared[np.isfinite(compared[:, 3])]
    up, height_error, far_up = None, None, False
    if len(heights) >= _MIN_PHOTOGRAPHS:
        up, height_error = float(np.median(heights[:, 3])), float(np.median(abs(heights[:, 3])))
        far_up = bool(np.median(heights[:, 4]) > _FAR)
    unplaced = geography.georeference is None and across > _RECEIVER_M
    far_within = unplaced and within_sigmas > _FAR
    far_across = across_sigmas > _FAR
    return Disagreement(len(compared), across, up, height_error, far_across, far_up, far_within)


def warn_of_disagreement(located: Sequence[Located], geography: Geography) -> None:
    """Warn in one line if estimates are much farther from measured positions than the sigmas.

    If the accuracy of the map's georeference is unknown, sigmas are relative to the map. The line
    then states the distance of the estimates from the measured positions.
    """
    errors = measure_disagreement(located, geography)
    if errors is None:
        return
    if not (errors.far_across or errors.far_up):
        if errors.far_within:
            log.warning(
                "the answers lie %.1f m beside the GPS positions of the photographs (median of "
                "%d): sigma_m is relative to the map, whose georeference has unknown accuracy",
                errors.across_m,
                errors.photographs,
            )
        return
    parts = [f"{errors.across_m:.1f} m beside"] if errors.far_across else []
    if errors.far_up and errors.up_m is not None and errors.height_error_m is not None:
        # Heights that scatter have a median near 0, which would falsely suggest agreement.
        scattered = abs(errors.up_m) < errors.height_error_m / 2
        where = "above or below" if scattered else "above" if errors.up_m > 0 else "below"
        parts.append(f"{errors.height_error_m:.1f} m {where}")
    log.warning(
        "the answers lie %s the GPS positions of the photographs (median of %d), far more than "
        "the sigmas of both: the map's georeference or the GPS is wrong%s",
        " and ".join(parts),
        errors.photographs,
        ", or its altitudes are above another surface (sea or ellipsoid)" if errors.far_up else "",
    )


def _compare(located: Sequence[Located], geography: Geography) -> Iterator[_Compared]:
    """Yield distances in metres and in standard deviations; NaN for unknown heights."""
    for item in located:
        gps, centre = item.gps, item.centre
        if not item.is_localized or centre is None or gps is None or gps.position_sigma is None:
            continue
        if not gps.has_position or not np.isfinite(gps.position[:2]).all():
            continue
        accuracy, within = item.accuracy(geography), item.sigmas or (0.0, 0.0)
        eph = within[0] if accuracy.eph_m is None else accuracy.eph_m
        epv = within[1] if accuracy.epv_m is None else accuracy.epv_m
        east, north, up = (centre - gps.position).tolist()
        across = math.hypot(east, north)
        across_sigma = math.hypot(eph / math.sqrt(2), gps.horizontal_sigma or 0.0)
        up_sigma = math.hypot(epv, float(gps.position_sigma[2]))
        up = up if math.isfinite(up_sigma) else math.nan
        yield _Compared(
            across,
            across / max(across_sigma, _MIN_SIGMA_M),
            across / max((item.sigmas or (math.inf,))[0] / math.sqrt(2), _MIN_SIGMA_M),
            up,
            abs(up) / max(up_sigma, _MIN_SIGMA_M),
        )
