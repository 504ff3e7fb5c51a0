"""Errors of neighbouring pixels that are alike, and what they add to a covariance.

Least squares takes residuals for independent. Residuals of matches are not: a keypoint that is
found twice, a lens that is not quite as calibrated and points of a map that were triangulated from
the same photographs move matches of one part of a picture together. So many matches tell less than
as many independent ones would. The sandwich of Conley (J. Econometrics 92, 1999) counts the pairs
of neighbours; here their correlation falls with their distance as a spherical variogram does, so
that it is one number, which the residuals tell, and the covariance stays positive definite.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows of points whose distances are computed at a time.
_ROWS: Final = 256


@dataclass(frozen=True)
class Neighbours:
    """What pairs of neighbouring residuals tell.

    Attributes:
        correlation: of two residuals in one place, 0 to 1.
        information: (P, P) sum of what pairs add to the information of P parameters, in units of
            the variance of a residual; it is to be multiplied by the correlation.
    """

    correlation: float
    information: Array


def count_neighbours(xy: Array, residuals: Array, jacobian: Array, reach: float) -> Neighbours:
    """Return how alike neighbouring residuals are, and what this adds to a covariance.

    The correlation is fitted to the products of all pairs of residuals by least squares. A fit of
    parameters has made residuals less alike than errors, which is made up for.

    Args:
        xy: (N, 2) places of the residuals, pixels.
        residuals: (N, 2), with their sign.
        jacobian: (N, 2, P) derivatives of the residuals by the parameters; they determine them.
        reach: distance (pixels) from which on residuals have nothing in common; 0 for none.
    """
    parameters = jacobian.shape[2]
    nothing = Neighbours(0.0, np.zeros((parameters, parameters)))
    # The variance of one coordinate.
    variance = float((residuals**2).sum()) / max(2 * len(xy) - parameters, 1)
    if reach <= 0 or variance <= 0:
        return nothing
    order = np.argsort(xy[:, 0], kind="stable")
    xy, residuals, jacobian = xy[order], residuals[order], jacobian[order]
    # Products of its rows are what the fit takes of the covariance of two residuals.
    leverage = np.linalg.qr(jacobian.reshape(-1, parameters))[0].reshape(len(xy), -1)
    alike, taken, norm, information = 0.0, 0.0, 0.0, nothing.information
    for rows, columns, weight in _pairs(xy, reach):
        alike += float((weight * (residuals[rows] @ residuals[columns].T)).sum())
        taken += float((weight * (leverage[rows] @ leverage[columns].T)).sum())
        norm += float((weight**2).sum())
        for axis in range(2):
            information = information + jacobian[rows, axis].T @ weight @ jacobian[columns, axis]
    if norm == 0:
        return nothing
    correlation = (alike / variance + taken) / (2 * norm)
    return Neighbours(float(np.clip(correlation, 0, 1)), information)


def _pairs(xy: Array, reach: float) -> Iterator[tuple[slice, slice, Array]]:
    """Yield rows, columns and the weight of each of their pairs, for points sorted by x.

    The weight falls from 1 in one place to 0 at ``reach``; a point is no pair with itself.
    """
    for first in range(0, len(xy), _ROWS):
        rows = slice(first, min(first + _ROWS, len(xy)))
        low = np.searchsorted(xy[:, 0], xy[rows.start, 0] - reach)
        high = np.searchsorted(xy[:, 0], xy[rows.stop - 1, 0] + reach, "right")
        columns = slice(int(low), int(high))
        apart = np.linalg.norm(xy[rows, None] - xy[None, columns], axis=2) / reach
        weight = np.where(apart < 1, 1 - 1.5 * apart + 0.5 * apart**3, 0.0)
        own = np.arange(rows.start, rows.stop)
        weight[own - rows.start, own - columns.start] = 0.0
        yield rows, columns, weight
