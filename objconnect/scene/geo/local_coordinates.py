"""Fast conversion from a scene's world to a reference system, exact within a few kilometres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu

Array = NDArray[np.float64]

# Sample positions of the polynomial fit along each axis of the box.
_NODES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])


@dataclass(frozen=True)
class LocalProjection:
    """Coordinates of a reference system as polynomials of degree 2 in world metres.

    Within a box of 2 km the polynomials differ from the exact coordinates by less than a tenth of a
    millimetre, because map projections are smooth over the radius of the earth. A straight line in
    the world becomes a parabola, which ``along`` returns.

    Attributes:
        middle: centre of the box, (3,) world metres.
        scale: metres of the world per unit of the polynomials' arguments.
        constant: (3,) coordinates of the centre: east, north, height.
        linear: (3, 3), by coordinate and axis.
        quadratic: (3, 3, 3) symmetric in the last two.
    """

    middle: Array
    scale: float
    constant: Array
    linear: Array
    quadratic: Array

    @staticmethod
    def fit(projection: Projection, origin: Geodetic, low: Array, high: Array) -> LocalProjection:
        """Fit the polynomials in a box of the world.

        Args:
            projection: reference system.
            origin: origin of the world.
            low: least east, north and up of the box, (3,) world metres.
            high: largest east, north and up of the box, (3,) world metres.
        """
        middle = (low + high) / 2
        half = np.maximum((high - low) / 2, 1.0)
        scale = float(half.max())
        nodes = np.stack(np.meshgrid(*[_NODES] * 3, indexing="ij"), -1).reshape(-1, 3) * half
        exact = np.stack(
            [projection.from_geodetic(geodetic_from_enu(middle + x, origin)) for x in nodes]
        )
        centre = projection.from_geodetic(geodetic_from_enu(middle, origin))
        u = nodes / scale
        first, second = np.triu_indices(3)
        terms = np.hstack([np.ones((len(u), 1)), u, u[:, first] * u[:, second]])
        fitted = np.linalg.lstsq(terms, exact - centre, rcond=None)[0]
        quadratic = np.zeros((3, 3, 3))
        quadratic[:, first, second] += fitted[4:].T / 2
        quadratic[:, second, first] += fitted[4:].T / 2
        return LocalProjection(middle, scale, centre + fitted[0], fitted[1:4].T, quadratic)

    def coordinates(self, points: Array) -> Array:
        """Return east, north and height of world points, (..., 3)."""
        u = (points - self.middle) / self.scale
        curved = np.einsum("...i,kij,...j->...k", u, self.quadratic, u, optimize=True)
        return np.asarray(self.constant + u @ self.linear.T + curved)

    def along(self, start: Array, directions: Array) -> tuple[Array, Array, Array]:
        """Return the coordinates of ``start + t * direction`` as ``a + b t + c t^2``.

        Args:
            start: (3,) world metres.
            directions: (N, 3).

        Returns:
            a (3,), b (N, 3) and c (N, 3).
        """
        u, v = (start - self.middle) / self.scale, directions / self.scale
        slope = self.linear + 2 * np.einsum("kij,j->ki", self.quadratic, u)
        curved = np.einsum("ni,kij,nj->nk", v, self.quadratic, v, optimize=True)
        return self.coordinates(start), v @ slope.T, curved


def world_from(projection: Projection, origin: Geodetic, coordinates: Array) -> Array:
    """Convert coordinates east, north and height (N, 3) exactly to world positions (N, 3).

    Raises:
        InputError: the coordinates are outside the reference system's range.
    """
    return np.stack([enu_from_geodetic(projection.to_geodetic(x), origin) for x in coordinates])


def at_height(projection: Projection, place: Geodetic, height: float) -> Geodetic:
    """Return a place at a height of a reference system, metres, above or below another place.

    Raises:
        InputError: the place is outside the reference system's range.
    """
    east, north, _ = projection.from_geodetic(place)
    return projection.to_geodetic(np.array([east, north, height]))
