"""Answers that contradict the positions that the photographs' own receiver measured."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from objconnect.localization.pipeline.answers import Geography, Located

log = logging.getLogger(__name__)

# Fewer photographs may all have a bad fix.
_FEWEST: Final = 5
# Standard deviations of one axis. Errors that all photographs share are larger by a chance of
# 1 in 90 horizontally, and of 1 in 370 vertically.
_FAR: Final = 3.0
# A receiver without corrections is off by less in 95 % of places (m; GPS SPS standard of 2020).
_RECEIVER_M: Final = 8.0
# A smaller standard deviation (m) is none that a receiver has.
_LEAST: Final = 1e-3


class Disagreement(NamedTuple):
    """How far answers are from measured positions.

    Attributes:
        photographs: number of photographs that have both.
        across_m: median horizontal distance, metres.
        up_m: median height of the answers above the positions, metres; None where no height was
            measured.
        apart_m: median difference of the heights, whatever its sign, metres; None as ``up_m``.
        far_across: whether the horizontal distances are far larger than the sigmas.
        far_up: the same of the heights.
        far_within: whether the map's place on earth is unknown, and the horizontal distances are
            larger than those of a receiver, and far larger than the sigmas within the map.
    """

    photographs: int
    across_m: float
    up_m: float | None
    apart_m: float | None
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
    """Compare answers with measured positions; None where fewer than five photographs have both.

    A distance is measured in standard deviations of position and answer together: that on earth
    where the map's place on earth is known, else that within the map.
    """
    compared = np.array(list(_compare(located, geography))).reshape(-1, 5)
    if len(compared) < _FEWEST:
        return None
    across, across_sigmas, within_sigmas = np.median(compared[:, :3], axis=0).tolist()
    heights = compared[np.isfinite(compared[:, 3])]
    up, apart, far_up = None, None, False
    if len(heights) >= _FEWEST:
        up, apart = float(np.median(heights[:, 3])), float(np.median(abs(heights[:, 3])))
        far_up = bool(np.median(heights[:, 4]) > _FAR)
    unplaced = geography.georeference is None and across > _RECEIVER_M
    far_within = unplaced and within_sigmas > _FAR
    return Disagreement(len(compared), across, up, apart, across_sigmas > _FAR, far_up, far_within)


def warn_of_disagreement(located: Sequence[Located], geography: Geography) -> None:
    """Warn in one line where answers are much further from measured positions than the sigmas.

    Where the map's place on earth is unknown, answers have sigmas within the map alone. Then a line
    says how far they are from the measured positions.
    """
    found = measure_disagreement(located, geography)
    if found is None:
        return
    if not (found.far_across or found.far_up):
        if found.far_within:
            log.warning(
                "the answers lie %.1f m beside the GPS positions of the photographs (median of "
                "%d): sigma_m is within the map, whose place on earth is not known as exactly",
                found.across_m,
                found.photographs,
            )
        return
    parts = [f"{found.across_m:.1f} m beside"] if found.far_across else []
    if found.far_up and found.up_m is not None and found.apart_m is not None:
        # Heights that scatter have a median near 0, which would say that they agree.
        scattered = abs(found.up_m) < found.apart_m / 2
        where = "above or below" if scattered else "above" if found.up_m > 0 else "below"
        parts.append(f"{found.apart_m:.1f} m {where}")
    log.warning(
        "the answers lie %s the GPS positions of the photographs (median of %d), far more than "
        "the sigmas of both: the map's place on earth is off, or the GPS is%s",
        " and ".join(parts),
        found.photographs,
        ", or its altitudes are above another surface (sea or ellipsoid)" if found.far_up else "",
    )


def _compare(located: Sequence[Located], geography: Geography) -> Iterator[_Compared]:
    """Yield distances, and what they are of the standard deviations; NaN for unknown heights."""
    for item in located:
        gps, centre = item.gps, item.centre
        if not item.found or centre is None or gps is None or gps.position_sigma is None:
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
            across / max(across_sigma, _LEAST),
            across / max((item.sigmas or (math.inf,))[0] / math.sqrt(2), _LEAST),
            up,
            abs(up) / max(up_sigma, _LEAST),
        )
