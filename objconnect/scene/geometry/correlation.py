"""Spatial correlation of residuals, and its effect on a covariance.

Least squares assumes independent residuals. Residuals of matches are correlated: a keypoint that is
detected twice, errors of the calibration and points triangulated from the same photographs move the
matches of an image region together. The sandwich estimator of Conley (J. Econometrics 92, 1999)
sums the products of neighbouring residuals. Here the correlation of two residuals decreases with
their distance as in a spherical variogram; so it has one parameter, which is fitted to the
residuals, and the covariance stays positive definite.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Number of points whose distances to others are computed at a time.
_ROWS: Final = 256


@dataclass(frozen=True)
class NeighbourCorrelation:
    """The correlation of neighbouring residuals.

    Attributes:
        correlation: correlation of two residuals at the same pixel, 0 to 1.
        information: (P, P) contribution of all pairs to the information of P parameters for
            correlation 1, to be divided by the variance of a residual.
    """

    correlation: float
    information: Array


def estimate_correlation(
    xy: Array, residuals: Array, jacobian: Array, reach: float
) -> NeighbourCorrelation:
    """Estimate the correlation of neighbouring residuals.

    The correlation is fitted to the products of all pairs of residuals by least squares. It is
    corrected for the fit of the parameters, which makes residuals less correlated than errors.

    Args:
        xy: (N, 2) positions of the residuals, pixels.
        residuals: (N, 2) signed residuals, pixels.
        jacobian: (N, 2, P) derivatives of the residuals by the parameters, of full rank.
        reach: distance (pixels) beyond which residuals are uncorrelated; 0 for no correlation.
    """
    parameters = jacobian.shape[2]
    uncorrelated = NeighbourCorrelation(0.0, np.zeros((parameters, parameters)))
    # The variance of one coordinate.
    variance = float((residuals**2).sum()) / max(2 * len(xy) - parameters, 1)
    if reach <= 0 or variance <= 0:
        return uncorrelated
    order = np.argsort(xy[:, 0], kind="stable")
    xy, residuals, jacobian = xy[order], residuals[order], jacobian[order]
    # The fit lowers the covariance of two residuals, in units of their variance, by the product of
    # their rows of this matrix.
    leverage = np.linalg.qr(jacobian.reshape(-1, parameters))[0].reshape(len(xy), -1)
    product, lost_to_fit, norm, information = 0.0, 0.0, 0.0, uncorrelated.information
    for rows, columns, weight in _pairs(xy, reach):
        product += float((weight * (residuals[rows] @ residuals[columns].T)).sum())
        lost_to_fit += float((weight * (leverage[rows] @ leverage[columns].T)).sum())
        norm += float((weight**2).sum())
        for axis in range(2):
            information = information + jacobian[rows, axis].T @ weight @ jacobian[columns, axis]
    if norm == 0:
        return uncorrelated
    correlation = (product / variance + lost_to_fit) / (2 * norm)
    return NeighbourCorrelation(float(np.clip(correlation, 0, 1)), information)


def _pairs(xy: Array, reach: float) -> Iterator[tuple[slice, slice, Array]]:
    """Yield rows, columns and the weights of their pairs, for points sorted by x.

    The weight falls from 1 at distance 0 to 0 at ``reach``; a point is not a pair with itself.
    """
    for first in range(0, len(xy), _ROWS):
        rows = slice(first, min(first + _ROWS, len(xy)))
        low = np.searchsorted(xy[:, 0], xy[rows.start, 0] - reach)
        high = np.searchsorted(xy[:, 0], xy[rows.stop - 1, 0] + reach, "right")
        columns = slice(int(low), int(high))
        distance = np.linalg.norm(xy[rows, None] - xy[None, columns], axis=2) / reach
        weight = np.where(distance < 1, 1 - 1.5 * distance + 0.5 * distance**3, 0.0)
        itself = np.arange(rows.start, rows.stop)
        weight[itself - rows.start, itself - columns.start] = 0.0
        yield rows, columns, weight
