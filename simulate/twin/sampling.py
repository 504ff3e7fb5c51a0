"""Sample georeferenced rasters on a square grid of the world.

The grid is centred on the world's origin, with rows from south to north. The world is
east-north-up: it is rotated against the raster by the meridian convergence, and its horizontal
plane is tangent to the curved earth (``geo.local_coordinates``). Values are interpolated at steps
of 1/32 pixel.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geo.local_coordinates import LocalProjection, world_from_coordinates
from objconnect.scene.geo.rasters import Box, Patch, Raster
from objconnect.scene.geometry.geodesy import Geodetic

Array = NDArray[np.float64]
Float = NDArray[np.float32]

_ROWS = 256  # rows of the grid that are computed at once
_MARGIN_PX = 3.0  # margin of the raster that is read around the grid


class Cells(NamedTuple):
    """The positions along both axes of a square grid in the world, and the height of the grid.

    Attributes:
        axis: positions (n,), metres from the origin.
        height: approximate height of the surface above the origin, metres.
    """

    axis: Array
    height: float

    @property
    def spacing_m(self) -> float:
        """Return the distance between positions, metres."""
        return float(self.axis[1] - self.axis[0])


def sample_colours(raster: Raster, origin: Geodetic, cells: Cells) -> Float:
    """Return the colours of an orthophoto at a grid, (n, n, 3) in 0..255, NaN where unknown."""
    patch, local = _patch_around(raster, origin, cells)
    bands = np.ascontiguousarray(np.moveaxis(patch.values, 0, -1))
    parts = [
        cv2.remap(bands, x, y, cv2.INTER_LINEAR, borderValue=(np.nan,) * 4)
        for x, y, _ in _pixels(patch, local, cells)
    ]
    sampled = np.concatenate(parts).reshape(len(cells.axis), len(cells.axis), -1)
    return np.asarray(np.broadcast_to(sampled, (*sampled.shape[:2], 3)), np.float32)


def sample_heights(raster: Raster, origin: Geodetic, cells: Cells, undulation: float) -> Float:
    """Return the heights of a surface model at a grid, (n, n) world metres, NaN where unknown."""
    patch, local = _patch_around(raster, origin, cells)
    # The mean is subtracted, because float32 loses millimetres far from zero.
    known = np.isfinite(patch.values)
    zero = float(patch.values[known].mean()) if known.any() else 0.0
    values = np.ascontiguousarray(patch.values[0] - np.float32(zero))
    parts = []
    for x, y, plane in _pixels(patch, local, cells):
        above = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderValue=np.nan)
        parts.append(cells.height + above + (zero + undulation - plane))
    return np.asarray(np.concatenate(parts), np.float32)


def sample_labels(raster: Raster, origin: Geodetic, cells: Cells) -> NDArray[np.uint8]:
    """Return the nearest values of a mask at a grid, (n, n); 0 beyond the mask."""
    patch, local = _patch_around(raster, origin, cells, average=False)
    values = np.nan_to_num(patch.values[0])
    parts = [cv2.remap(values, x, y, cv2.INTER_NEAREST) for x, y, _ in _pixels(patch, local, cells)]
    return np.asarray(np.concatenate(parts), np.uint8)


def inner_half_side(rasters: tuple[Raster, Raster], origin: Geodetic) -> float:
    """Return the half side, metres, of the largest square around an origin inside two rasters.

    The result is not positive if the origin lies outside a raster.
    """
    return float(min(_reach(raster, origin).min() for raster in rasters))


def outer_half_side(raster: Raster, origin: Geodetic) -> float:
    """Return the half side, metres, of the square that touches the farthest edge of a raster.

    The centre of the square is the origin.
    """
    return float(_reach(raster, origin).max())


def _reach(raster: Raster, origin: Geodetic) -> Array:
    """Return the half sides (4,), metres, of the squares that touch each edge of a raster."""
    left, bottom, right, top = raster.grid.box
    corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
    height = origin.altitude
    corners_m = world_from_coordinates(
        raster.grid.projection, origin, np.array([(*corner, height) for corner in corners])
    )[:, :2]
    side = np.roll(corners_m, -1, axis=0) - corners_m
    outward = np.stack([side[:, 1], -side[:, 0]], -1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    # A square of half side h touches a line of normal n at the distance h (|nx| + |ny|).
    return np.asarray((outward * corners_m).sum(1) / np.abs(outward).sum(1))


def _patch_around(
    raster: Raster, origin: Geodetic, cells: Cells, average: bool = True
) -> tuple[Patch, LocalProjection]:
    """Return the patch of a raster around a grid, and the projection from the world to the raster.

    ``average`` averages the pixels of the raster over the spacing of the grid.
    """
    reach = float(cells.axis[-1])
    corner = np.array([reach, reach, 50.0])
    middle = np.array([0.0, 0.0, cells.height])
    projection = raster.grid.projection
    local = LocalProjection.fit(projection, origin, middle - corner, middle + corner)
    ends = [(x, y, cells.height) for x in (-reach, reach) for y in (-reach, reach)]
    at = local.coordinates(np.array(ends))
    margin = _MARGIN_PX * max(raster.grid.pixel)
    (left, bottom, _), (right, top, _) = at.min(0) - margin, at.max(0) + margin
    box = Box(float(left), float(bottom), float(right), float(top))
    return raster.patch(box, cells.spacing_m if average else 0.0), local


def _pixels(
    patch: Patch, local: LocalProjection, cells: Cells
) -> Iterator[tuple[Float, Float, Array]]:
    """Yield strips of the grid: OpenCV's columns and rows, and heights of the grid's plane.

    Heights are in the coordinate reference system of the raster, in which the plane is curved.
    """
    for first in range(0, len(cells.axis), _ROWS):
        east, north = np.meshgrid(cells.axis, cells.axis[first : first + _ROWS])
        at = local.coordinates(np.stack([east, north, np.full_like(east, cells.height)], -1))
        column, row = patch.grid.columns_rows(at[..., 0], at[..., 1])
        # The centre of OpenCV's first pixel is (0, 0).
        yield (column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32), at[..., 2]
