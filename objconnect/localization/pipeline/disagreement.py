"""Comparison of estimated positions with the GPS positions of the photographs."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from objconnect.localization.pipeline.answers import Geography, ImageEstimate

log = logging.getLogger(__name__)

# Least number of photographs that are compared, because a few may all have a bad GPS fix.
_MIN_PHOTOGRAPHS: Final = 5
# Median distance, in standard deviations of one axis, from which a warning is given. An error that
# all photographs share exceeds it with a probability of 1 / 90 horizontally and 1 / 370 vertically.
_FAR_SIGMAS: Final = 3.0
# Horizontal error (m) of a GPS receiver without corrections, 95th percentile (GPS SPS standard of
# 2020).
_RECEIVER_M: Final = 8.0
# Lower bound of standard deviations, metres, which avoids division by 0. No receiver is as exact.
_MIN_SIGMA_M: Final = 1e-3


class Disagreement(NamedTuple):
    """Distances between estimated and measured positions.

    Attributes:
        photographs: number of photographs that have both positions.
        horizontal_m: median horizontal distance, metres.
        height_m: median height of the estimates above the measurements, metres; None if fewer than
            five photographs have both heights.
        height_error_m: median absolute difference of the heights, metres; None if ``height_m`` is.
        is_far_horizontally: whether the horizontal distances are far larger than their sigmas.
        is_far_vertically: whether the height differences are far larger than their sigmas.
        is_far_in_map: whether the map's accuracy on earth is unknown, and the horizontal distances
            are larger than a receiver's errors and far larger than the sigmas relative to the map.
    """

    photographs: int
    horizontal_m: float
    height_m: float | None
    height_error_m: float | None
    is_far_horizontally: bool
    is_far_vertically: bool
    is_far_in_map: bool


class _Distances(NamedTuple):
    """Distances of one photograph's estimate from its measured position.

    Attributes:
        horizontal_m: horizontal distance, metres.
        horizontal_sigmas: the same in standard deviations of the difference, one axis.
        map_sigmas: the same in standard deviations of the estimate relative to the map, one axis.
        height_m: height of the estimate above the measurement, metres; NaN if unknown.
        height_sigmas: absolute height difference in standard deviations; NaN if unknown.
    """

    horizontal_m: float
    horizontal_sigmas: float
    map_sigmas: float
    height_m: float
    height_sigmas: float


def measure_disagreement(
    estimates: Sequence[ImageEstimate], geography: Geography
) -> Disagreement | None:
    """Compare estimated with measured positions; None if fewer than five photographs have both.

    Distances are divided by the standard deviation of the difference between estimate and
    measurement. The estimate's standard deviation includes the accuracy of the map on earth if that
    is known.
    ``is_far_in_map`` compares with the estimate's standard deviation relative to the map alone.
    """
    compared = np.array(list(_compare(estimates, geography))).reshape(-1, 5)
    if len(compared) < _MIN_PHOTOGRAPHS:
        return None
    across, horizontal_sigmas, map_sigmas = np.median(compared[:, :3], axis=0).tolist()
    heights = compared[np.isfinite(compared[:, 3])]
    up, height_error, is_far_vertically = None, None, False
    if len(heights) >= _MIN_PHOTOGRAPHS:
        up, height_error = float(np.median(heights[:, 3])), float(np.median(abs(heights[:, 3])))
        is_far_vertically = bool(np.median(heights[:, 4]) > _FAR_SIGMAS)
    is_unexplained = geography.georeference is None and across > _RECEIVER_M
    is_far_in_map = is_unexplained and map_sigmas > _FAR_SIGMAS
    is_far_horizontally = horizontal_sigmas > _FAR_SIGMAS
    return Disagreement(
        len(compared),
        across,
        up,
        height_error,
        is_far_horizontally,
        is_far_vertically,
        is_far_in_map,
    )


def warn_of_disagreement(estimates: Sequence[ImageEstimate], geography: Geography) -> None:
    """Warn in one line if estimates are much farther from measured positions than their sigmas.

    If median distances exceed 3 sigmas of estimate and measurement, the line says that the map's
    georeference or the GPS is wrong. Otherwise there is a line only if the accuracy of the map on
    earth is unknown and the horizontal distance exceeds 8 m and 3 sigmas relative to the map. It
    states the distance without a cause, because the sigmas do not include the error of the map.
    """
    errors = measure_disagreement(estimates, geography)
    if errors is None:
        return
    if not (errors.is_far_horizontally or errors.is_far_vertically):
        if errors.is_far_in_map:
            log.warning(
                "the answers lie %.1f m beside the GPS positions of the photographs (median of "
                "%d): sigma_m is relative to the map, whose georeference has unknown accuracy",
                errors.horizontal_m,
                errors.photographs,
            )
        return
    parts = [f"{errors.horizontal_m:.1f} m beside"] if errors.is_far_horizontally else []
    if (
        errors.is_far_vertically
        and errors.height_m is not None
        and errors.height_error_m is not None
    ):
        # Differences of both signs have a median near 0, so the median absolute difference is
        # shown.
        has_both_signs = abs(errors.height_m) < errors.height_error_m / 2
        where = "above or below" if has_both_signs else "above" if errors.height_m > 0 else "below"
        parts.append(f"{errors.height_error_m:.1f} m {where}")
    log.warning(
        "the answers lie %s the GPS positions of the photographs (median of %d), far more than "
        "the sigmas of both: the map's georeference or the GPS is wrong%s",
        " and ".join(parts),
        errors.photographs,
        ", or the GPS altitudes are above another surface (sea or ellipsoid)"
        if errors.is_far_vertically
        else "",
    )


def _compare(estimates: Sequence[ImageEstimate], geography: Geography) -> Iterator[_Distances]:
    """Yield distances in metres and in standard deviations; NaN for unknown heights."""
    for item in estimates:
        gps, centre = item.gps, item.centre
        if not item.is_localized or centre is None or gps is None or gps.position_sigma is None:
            continue
        if not gps.has_position or not np.isfinite(gps.position[:2]).all():
            continue
        # If the estimate has no sigmas, the distance is compared with the GPS sigmas alone. The
        # sigma relative to the map is then infinite, which gives a distance of 0 sigmas.
        accuracy, sigmas = item.accuracy(geography), item.sigmas or (0.0, 0.0)
        map_sigma = item.sigmas[0] / math.sqrt(2) if item.sigmas else math.inf
        eph = sigmas[0] if accuracy.eph_m is None else accuracy.eph_m
        epv = sigmas[1] if accuracy.epv_m is None else accuracy.epv_m
        east, north, up = (centre - gps.position).tolist()
        across = math.hypot(east, north)
        across_sigma = math.hypot(eph / math.sqrt(2), gps.horizontal_sigma or 0.0)
        up_sigma = math.hypot(epv, float(gps.position_sigma[2]))
        up = up if math.isfinite(up_sigma) else math.nan
        yield _Distances(
            across,
            across / max(across_sigma, _MIN_SIGMA_M),
            across / max(map_sigma, _MIN_SIGMA_M),
            up,
            abs(up) / max(up_sigma, _MIN_SIGMA_M),
        )
