"""How exactly a model of photographs is placed on earth, from what placed it there."""

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

# Fewer fixes than place a model do not tell how far they scatter.
_FEWEST = 3


@dataclass(frozen=True)
class Receiver:
    """What a flight's positions say of themselves.

    Attributes:
        fixes: Measured positions (3,) by name, world metres.
        stated: Standard deviations (3,) of positions to the east, north and up, metres, by name,
            where the receiver states them, as with RTK.
    """

    fixes: Mapping[str, Array]
    stated: Mapping[str, tuple[float, float, float]]


def georeference_of(
    model: SparseMap,
    placed: Georegistration,
    receiver: Receiver,
    control: Sequence[ControlResidual],
    options: IngestOptions,
) -> Georeference | None:
    """Return how exactly a model is placed on earth; None where nothing tells.

    Surveyed points tell it best. Their residuals and the sigma of their coordinates add up, as
    variances. Points that were only compared count where there are any, because the adjustment has
    made the residuals of the others small.

    Without them the fixes tell. The variance of each axis is that of what all fixes of a flight
    share, and that of the fixes about their cameras. The number of fixes does not divide it:
    errors of one flight are alike, and a model follows what is common to all of them.

    Args:
        model: The model in the world.
        placed: How it was placed, with the scatter of its fixes.
        receiver: The fixes.
        control: The ground control points.
        options: The sigmas that nothing measures.
    """
    known = _by_control(control, options)
    used = [n for n in model.names if n in receiver.fixes and n not in placed.blunders]
    if known is not None or len(used) < _FEWEST:
        return known
    stated = [receiver.stated.get(name) for name in used]
    measured = [sigma for sigma in stated if sigma is not None]
    if len(measured) == len(used):  # corrected positions, with heights above the ellipsoid
        shared = (np.array(measured) ** 2).mean(0)
    else:
        across = options.receiver_sigma_m**2
        up = options.receiver_height_sigma_m**2 + options.height_datum_sigma_m**2
        shared = np.array([across, across, up])
    east, north, up = (shared + placed.sigma**2).tolist()
    return _georeference(east + north, math.sqrt(up), "gps")


def _by_control(control: Sequence[ControlResidual], options: IngestOptions) -> Georeference | None:
    """Return what ground control points tell; None without one that was seen and is not wrong."""
    off = np.array([p.off for p in control if p.role == "check" and p.off is not None])
    if not len(off):
        used = [p.off for p in control if p.role == "used" and p.off is not None]
        if len(used) < _FEWEST:  # their residuals are what the shift has left
            return None
        off = np.array(used)
    east, north, up = (off**2).mean(0) + options.control_sigma_m**2
    return _georeference(east + north, math.sqrt(up), "control")


def _georeference(horizontal_variance: float, vertical_m: float, source: str) -> Georeference:
    return Georeference.model_validate(
        {
            "horizontal_m": round(math.sqrt(horizontal_variance), 4),
            "vertical_m": round(vertical_m, 4) if math.isfinite(vertical_m) else None,
            "source": source,
        }
    )
