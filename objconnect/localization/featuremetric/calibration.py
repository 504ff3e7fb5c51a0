"""Covariances of poses by alignment that hold: what an alignment measures, by errors of others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from objconnect.localization.align.covariance import Spread
from objconnect.localization.featuremetric.calibration_files import BesideWeights


class CovarianceNumbers(BesideWeights):
    """The numbers of the covariance of one network's poses, as ``calibrate_covariance`` uses them.

    ``python -m experiments.covariance`` finds them.
    """

    kind = "covariance"

    factor: float = Field(
        gt=0,
        description="Factor on the covariance that the alignment measures where the fit is that of "
        "the map's season, from 100 patches of the query.",
    )
    patches_power: float = Field(
        ge=0,
        description="Power of the number of patches, as a share of 100, by which the covariance is "
        "divided: it is measured too small from few of them.",
    )
    level: float = Field(
        gt=0,
        description="Level of the scatter of the patches' pulls, as a share of the curvature of "
        "the cost, that queries have in general.",
    )
    level_patches: float = Field(
        ge=0,
        description="Number of equal patches of a query as which this level counts beside what "
        "the query's own patches show: their level is not known well from few of them.",
    )
    floor: float = Field(
        ge=0,
        description="Standard deviation, per axis, of what moves all points alike, as shadows do "
        "when the sun moves: radians, and metres per metre to the points.",
    )
    unchanged_fit: float = Field(
        gt=0,
        description="Fit of the points by how much they tell of the pose, below which light and "
        "season are the map's and nothing is added to the covariance, for a query that sees the "
        "points from where the map's photographs do.",
    )
    view_fit: float = Field(
        ge=0,
        description="How much that fit grows with 1 less the mean cosine of the angle between the "
        "directions in which the query and the map's photographs see the points.",
    )
    changed_fit: float = Field(
        gt=0,
        description="Share by which the fit is worse than in the map's season where the whole of "
        "floor is added; below, the variance that is added grows in proportion.",
    )


def calibrate_covariance(
    around: Spread, fit: float | NDArray[np.float64], by: CovarianceNumbers
) -> NDArray[np.float64]:
    """Return the covariances (B, 6, 6) of aligned poses: what alignments measure, made right.

    Args:
        around: how far the poses may be off as far as their queries tell; finite.
        fit: (B,) cost as a share of the cost by chance.
        by: how to calibrate.
    """
    factor, added = scales(around, fit, by)
    alike = added[:, :, None] * np.eye(6)
    return np.asarray(factor[:, None, None] * around.covariance.cpu().numpy() + alike)


def scales(
    around: Spread, fit: float | NDArray[np.float64], by: CovarianceNumbers
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the factors (B,) on measured covariances, and the variances (B, 6) that are added.

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

    Returns:
        The added variances are those of the rotation (rad^2), equal about all axes, and of the
        translation (m^2), which are larger by the square of the depth of the points.
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
    return factor, change[:, None] * deviation**2


def _arrays(*tensors: Tensor) -> list[NDArray[np.float64]]:
    return [tensor.double().cpu().numpy() for tensor in tensors]
