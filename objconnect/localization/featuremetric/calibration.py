"""Covariances of poses by alignment that hold: what an alignment measures, by errors of others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.align.covariance import Spread
from objconnect.localization.featuremetric.options import SearchOptions


class CovarianceNumbers(NamedTuple):
    """The options of ``SearchOptions`` of the same names, without ``covariance_``."""

    factor: float
    patches_power: float
    level: float
    level_patches: float
    floor: float
    unchanged_fit: float
    view_fit: float
    changed_fit: float

    @staticmethod
    def of(options: SearchOptions) -> CovarianceNumbers:
        """Return what options say."""
        names = (f"covariance_{name}" for name in CovarianceNumbers._fields)
        return CovarianceNumbers(*(getattr(options, name) for name in names))


def calibrated(
    around: Spread, fit: float | NDArray[np.float64], by: CovarianceNumbers
) -> NDArray[np.float64]:
    """Return the covariances (B, 6, 6) of aligned poses.

    The fit of the points by how much they tell of the pose is compared with that of a query in the
    light and season of the map, which is worse the more the query's view differs from those of the
    map's photographs. What the alignment measures grows by ``factor`` and by that ratio: the slopes
    of a changed query are not those of the map. It grows, too, by
    ``(100 / patches)**patches_power``: clustered estimates from few clusters are too small (Cameron
    and Miller, Journal of Human Resources 2015). The level of the patches' scatter is drawn to
    ``level`` as the posterior mean of a variance is, which counts as that of ``level_patches``
    equal patches (Smyth, Statistical Applications in Genetics and Molecular Biology 2004). What
    moves all points alike, such as shadows when the sun moves, cannot be seen in their residuals. A
    variance is added for it, which rises from none where the fit is that of the map's season to
    ``floor`` where it is worse by a share of ``changed_fit``.

    Args:
        around: how far the poses may be off as far as their queries tell; finite.
        fit: (B,) cost as a share of the cost by chance.
        by: how to calibrate.
    """
    patches, level, equal_patches = _arrays(around.patches, around.level, around.equal_patches)
    depth, view_cosine, cost = _arrays(around.depth, around.view_cosine, around.informative_cost)
    ratio = fit * cost / (by.unchanged_fit + by.view_fit * (1 - view_cosine))
    factor = by.factor * ratio * (patches / 100) ** -by.patches_power
    told = level > 0
    general = np.where(told, by.level / np.where(told, level, 1.0), 1.0)
    factor *= (equal_patches + by.level_patches * general) / (equal_patches + by.level_patches)
    change = np.clip((ratio - 1) / by.changed_fit, 0, 1)
    deviation = by.floor * np.stack([np.ones_like(depth), depth], 1).repeat(3, axis=1)
    alike = (change[:, None] * deviation**2)[:, :, None] * np.eye(6)
    return np.asarray(factor[:, None, None] * around.covariance.cpu().numpy() + alike)


def _arrays(*tensors: Tensor) -> list[NDArray[np.float64]]:
    return [tensor.double().cpu().numpy() for tensor in tensors]
