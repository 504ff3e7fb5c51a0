"""Calibration of the covariances of aligned poses by the errors of other queries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from objconnect.localization.align.covariance import PoseUncertainty
from objconnect.localization.featuremetric.calibration_files import CalibrationFile


class CovarianceModel(CalibrationFile):
    """The parameters of ``calibrate_covariance`` for one network.

    A patch is a square of an image whose points are treated as dependent (``PoseUncertainty``). The
    fit is the cost at the pose as a share of the cost by chance.
    ``python -m experiments.covariance`` fits the parameters.
    """

    kind = "covariance"

    factor: float = Field(
        gt=0,
        description="Factor on the measured covariance of a query with 100 patches, in the light "
        "and season of the map.",
    )
    patches_power: float = Field(
        ge=0,
        description="Power of (patches / 100) by which the covariance is divided: few patches make "
        "the measured covariance too small.",
    )
    level: float = Field(
        gt=0,
        description="Prior scatter of the patches' gradients, as a share of the curvature of the "
        "cost.",
    )
    level_patches: float = Field(
        ge=0,
        description="Weight of the prior scatter, in effective patches.",
    )
    floor: float = Field(
        ge=0,
        description="Standard deviation per axis of errors that move all points alike, as shadows "
        "do when the sun moves: rad, and m per metre of distance to the points.",
    )
    unchanged_fit: float = Field(
        gt=0,
        description="Information-weighted fit of a query from the map's own viewpoints in its "
        "light and season; up to this fit, no floor is added.",
    )
    view_fit: float = Field(
        ge=0,
        description="Increase of unchanged_fit per unit of 1 - c, where c is the mean cosine of "
        "the angle between the directions in which the query and the map's photographs see the "
        "points.",
    )
    changed_fit: float = Field(
        gt=0,
        description="Relative excess of the fit over the fit of an unchanged query (unchanged_fit "
        "and view_fit) at which the whole floor is added; for a smaller excess, the added variance "
        "is proportional to it.",
    )


def calibrate_covariance(
    uncertainty: PoseUncertainty, fit: float | NDArray[np.float64], model: CovarianceModel
) -> NDArray[np.float64]:
    """Return the calibrated covariances (B, 6, 6) of aligned poses; see ``compute_scales``."""
    factor, variances = compute_scales(uncertainty, fit, model)
    added = variances[:, :, None] * np.eye(6)
    return np.asarray(factor[:, None, None] * uncertainty.covariance.cpu().numpy() + added)


def compute_scales(
    uncertainty: PoseUncertainty, fit: float | NDArray[np.float64], model: CovarianceModel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the factors (B,) on measured covariances, and the variances (B, 6) to add.

    ``ratio`` is the information-weighted fit of a query, ``fit * informative_cost_ratio``, divided
    by the fit of a query in the light and season of the map. The divisor grows with the angle
    between the directions in which the query and the map's photographs see the points. The measured
    covariance is multiplied by

    - ``factor`` and ``ratio``: it is too small for a changed query, whose feature maps have other
      gradients than the map's;
    - ``(100 / patches)**patches_power``: clustered estimates from few clusters are too small
      (Cameron and Miller, Journal of Human Resources 2015);
    - a factor that shrinks the scatter of the patches towards ``level``, as the posterior mean of a
      variance whose prior has the weight of ``level_patches`` patches (Smyth, Statistical
      Applications in Genetics and Molecular Biology 2004).

    Errors that move all points alike, such as shadows when the sun moves, do not show in residuals.
    A variance is added for them. It rises from 0 at ``ratio`` 1 to ``floor`` squared at
    ``1 + changed_fit``.

    Args:
        uncertainty: measured covariances; finite.
        fit: (B,) cost as a share of the cost by chance; a number for one pose.
        model: parameters of the calibration.

    Returns:
        The factors, and the variances of rotation (rad^2), equal about all axes, and translation
        (m^2), which are larger by the square of the depth of the points.
    """
    patches, scatter_level, effective_patches = _arrays(
        uncertainty.patches, uncertainty.scatter_level, uncertainty.effective_patches
    )
    depth, view_cosine, cost_ratio = _arrays(
        uncertainty.depth, uncertainty.view_cosine, uncertainty.informative_cost_ratio
    )
    weighted_fit = fit * cost_ratio
    ratio = weighted_fit / (model.unchanged_fit + model.view_fit * (1 - view_cosine))
    factor = model.factor * ratio * (patches / 100) ** -model.patches_power
    known = scatter_level > 0
    prior_share = np.where(known, model.level / np.where(known, scatter_level, 1.0), 1.0)
    factor *= (effective_patches + model.level_patches * prior_share) / (
        effective_patches + model.level_patches
    )
    change = np.clip((ratio - 1) / model.changed_fit, 0, 1)
    deviation = model.floor * np.stack([np.ones_like(depth), depth], 1).repeat(3, axis=1)
    return factor, change[:, None] * deviation**2


def _arrays(*tensors: Tensor) -> list[NDArray[np.float64]]:
    return [tensor.double().cpu().numpy() for tensor in tensors]
