"""Estimate the georeferencing accuracy of a model, from GPS or ground control points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.control import ControlResidual
from objconnect.ingestion.georegister import Georegistration
from objconnect.ingestion.options import IngestOptions
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.maps.sparse_map import SparseMap

Array = NDArray[np.float64]

# Minimum number of fixes or points. Fewer determine the georegistration exactly, without residuals.
_MIN_FIXES = 3


@dataclass(frozen=True)
class GpsFixes:
    """GPS positions of a flight.

    Attributes:
        fixes: Measured positions (3,) by name, world metres.
        stated_sigma: Standard deviations (3,) east, north and up that the receiver states, as with
            RTK, metres, by name.
    """

    fixes: Mapping[str, Array]
    stated_sigma: Mapping[str, tuple[float, float, float]]


def estimate_georeference(
    model: SparseMap,
    georegistration: Georegistration,
    gps: GpsFixes,
    control: Sequence[ControlResidual],
    options: IngestOptions,
) -> Georeference | None:
    """Estimate the accuracy of a model's georegistration; None where it is unknown.

    Ground control points take precedence: the variance of each axis is the sum of the variances of
    their residuals and of their coordinates. Check points replace control points where there are
    any, because the adjustment has made the residuals of control points small.

    Without points, it is the sum of the variances of the error that all fixes of a flight share and
    of the fixes' residuals. It is not divided by the number of fixes, because errors within one
    flight are correlated and the model follows their common part.

    Args:
        model: The model in the world.
        georegistration: Its georegistration, with the scatter of its fixes.
        gps: The GPS positions.
        control: The ground control points.
        options: The sigmas that cannot be measured.
    """
    by_control = _estimate_from_control(control, options)
    used = [n for n in model.names if n in gps.fixes and n not in georegistration.blunders]
    if by_control is not None or len(used) < _MIN_FIXES:
        return by_control
    stated = [gps.stated_sigma.get(name) for name in used]
    measured = [sigma for sigma in stated if sigma is not None]
    if len(measured) == len(used):  # corrected positions, with heights above the ellipsoid
        shared = (np.array(measured) ** 2).mean(0)
    else:
        horizontal = options.receiver_sigma_m**2
        up = options.receiver_height_sigma_m**2 + options.height_datum_sigma_m**2
        shared = np.array([horizontal, horizontal, up])
    east, north, up = (shared + georegistration.sigma**2).tolist()
    return _make_georeference(east + north, math.sqrt(up), "gps")


def _estimate_from_control(
    control: Sequence[ControlResidual], options: IngestOptions
) -> Georeference | None:
    """Return the accuracy by ground control points; None without enough usable ones."""
    residuals = np.array([p.off for p in control if p.role == "check" and p.off is not None])
    if not len(residuals):
        used = [p.off for p in control if p.role == "used" and p.off is not None]
        if len(used) < _MIN_FIXES:  # the shift to them leaves no independent residuals
            return None
        residuals = np.array(used)
    east, north, up = (residuals**2).mean(0) + options.control_sigma_m**2
    return _make_georeference(east + north, math.sqrt(up), "control")


def _make_georeference(horizontal_variance: float, vertical_m: float, source: str) -> Georeference:
    return Georeference.model_validate(
        {
            "horizontal_m": round(math.sqrt(horizontal_variance), 4),
            "vertical_m": round(vertical_m, 4) if math.isfinite(vertical_m) else None,
            "source": source,
        }
    )
