"""Fast conversion from a scene's world to a reference system, exact within a few kilometres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetics_from_enu
from objconnect.scene.geometry.pose import Pose

Array = NDArray[np.float64]

MOST_STRETCH: Final = 2e-3
"""Largest deviation from 1 of a system's scale that ``world_pose`` accepts."""

# Half the length of the lines that measure the axes of a system, metres.
_ARM_M: Final = 10.0
# Sample positions of the polynomial fit along each axis of the box.
_NODES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])


@dataclass(frozen=True)
class LocalProjection:
    """Coordinates of a reference system as polynomials of degree 2 in world metres.

    Within a box of 2 km the polynomials differ from the exact coordinates by less than a tenth of a
    millimetre, because map projections change smoothly. A straight line in the world becomes a
    parabola, which ``expand_rays`` returns.

    Attributes:
        middle: centre of the box, (3,) world metres.
        scale: metres of the world per unit of the polynomials' arguments.
        constant: (3,) coordinates of the centre: east, north, height.
        linear: (3, 3), by coordinate and axis.
        quadratic: (3, 3, 3), by coordinate and two axes; symmetric in the axes.
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
        places = geodetics_from_enu(np.vstack([middle, middle + nodes]), origin)
        centre, *exact = projection.from_geodetics(places)
        u = nodes / scale
        first, second = np.triu_indices(3)
        terms = np.hstack([np.ones((len(u), 1)), u, u[:, first] * u[:, second]])
        fitted = np.linalg.lstsq(terms, np.stack(exact) - centre, rcond=None)[0]
        quadratic = np.zeros((3, 3, 3))
        quadratic[:, first, second] += fitted[4:].T / 2
        quadratic[:, second, first] += fitted[4:].T / 2
        return LocalProjection(middle, scale, centre + fitted[0], fitted[1:4].T, quadratic)

    def coordinates(self, points: Array) -> Array:
        """Return east, north and height of world points, (..., 3)."""
        u = (points - self.middle) / self.scale
        curved = np.einsum("...i,kij,...j->...k", u, self.quadratic, u, optimize=True)
        return np.asarray(self.constant + u @ self.linear.T + curved)

    def expand_rays(self, start: Array, directions: Array) -> tuple[Array, Array, Array]:
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


def world_from_coordinates(projection: Projection, origin: Geodetic, coordinates: Array) -> Array:
    """Convert coordinates east, north and height (N, 3) exactly to world positions (N, 3).

    Raises:
        InputError: the coordinates are outside the reference system's range.
    """
    return np.stack([enu_from_geodetic(projection.to_geodetic(x), origin) for x in coordinates])


def world_pose(projection: Projection, origin: Geodetic, cam_from_grid: Pose) -> Pose:
    """Convert a pose in the coordinates of a reference system to the world of a scene.

    The axes of the system at the camera are turned against east, north and up, by the convergence
    of the grid and by the curvature of the earth. They become the nearest rotation: a pose cannot
    keep the scale of the system, which is within a few parts in ten thousand in survey grids.

    Args:
        projection: reference system with metric coordinates east, north and height.
        origin: origin of the world.
        cam_from_grid: pose with a translation in metres of the system.

    Returns:
        cam_from_world.

    Raises:
        InputError: the camera is outside the system's range, or the system stretches lengths there
            by more than ``MOST_STRETCH``.
    """
    centre = cam_from_grid.centre().numpy()
    steps = _ARM_M * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    world = world_from_coordinates(projection, origin, centre + steps)
    left, lengths, right = np.linalg.svd((world[1:4] - world[4:]).T / (2 * _ARM_M))
    stretch = 1 / np.maximum(lengths, 1e-9)
    worst = float(stretch[np.abs(stretch - 1).argmax()])
    if abs(worst - 1) > MOST_STRETCH:
        raise InputError(
            f"at this position a metre on the ground is {worst:.4f} m in {projection.name}: check "
            "the position, and give poses in a survey grid, such as UTM"
        )
    rotation = cam_from_grid.rotation @ torch.from_numpy(left @ right).T
    return Pose(rotation, -(rotation @ torch.from_numpy(world[0])))


def move_to_height(projection: Projection, place: Geodetic, height: float) -> Geodetic:
    """Return the point straight above or below ``place`` at a height of a reference system.

    Args:
        projection: reference system with metric heights.
        place: any point on the vertical.
        height: height in the reference system, metres.

    Raises:
        InputError: the place is outside the reference system's range.
    """
    east, north, _ = projection.from_geodetic(place)
    return projection.to_geodetic(np.array([east, north, height]))
