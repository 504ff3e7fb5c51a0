"""The pixel grid of a raster, and patches of rasters in memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.geodesy import Geodetic

# Largest relative error of the scale of a survey grid.
_MAX_SURVEY_ERROR = 0.01


def scale_factors(projection: Projection, position: Geodetic) -> tuple[float, float]:
    """Return the scale factors of a projection along east and north at a position.

    A scale factor is the number of coordinate metres per metre on the ground. If both factors are
    within 1 % of 1, as in survey grids, exactly 1 is returned for both.
    """
    scale = projection.scale_at(position)
    return (1.0, 1.0) if max(abs(math.log(x)) for x in scale) < _MAX_SURVEY_ERROR else scale


class Box(NamedTuple):
    """A rectangle in the coordinates of a reference system, metres."""

    left: float
    bottom: float
    right: float
    top: float


@dataclass(frozen=True)
class Grid:
    """The pixel grid of a north-up raster.

    Attributes:
        projection: reference system of the coordinates.
        left: east coordinate of the outer edge of the first column, metres.
        top: north coordinate of the outer edge of the first row, metres.
        pixel: width and height of a pixel, metres.
        width: number of columns.
        height: number of rows.
    """

    projection: Projection
    left: float
    top: float
    pixel: tuple[float, float]
    width: int
    height: int

    @property
    def box(self) -> Box:
        """Return the outline of the raster."""
        right = self.left + self.width * self.pixel[0]
        return Box(self.left, self.top - self.height * self.pixel[1], right, self.top)

    @property
    def middle(self) -> Geodetic:
        """Return the geodetic position of the raster's middle, at height 0."""
        box = self.box
        east, north = (box.left + box.right) / 2, (box.bottom + box.top) / 2
        return self.projection.to_geodetic(np.array([east, north, 0.0]))

    @cached_property
    def ground_pixel(self) -> tuple[float, float]:
        """Return the width and height of a pixel on the ground, metres, in the raster's middle.

        They equal ``pixel`` if the difference is below 1 %, as in survey grids.
        """
        scale = scale_factors(self.projection, self.middle)
        return self.pixel[0] / scale[0], self.pixel[1] / scale[1]

    @property
    def longer_side_m(self) -> float:
        """Return the length of the raster's longer side on the ground, metres."""
        return max(self.width * self.ground_pixel[0], self.height * self.ground_pixel[1])

    def columns_rows(
        self, east: NDArray[np.float64], north: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return columns and rows of coordinates; the centre of the first pixel is (0.5, 0.5)."""
        return (east - self.left) / self.pixel[0], (self.top - north) / self.pixel[1]

    def part(self, row: int, column: int, height: int, width: int) -> Grid:
        """Return the grid of a rectangle of the pixels."""
        left = self.left + column * self.pixel[0]
        top = self.top - row * self.pixel[1]
        return replace(self, left=left, top=top, width=width, height=height)


@dataclass(frozen=True)
class Patch:
    """A rectangle of a raster in memory.

    Attributes:
        grid: pixel grid; its pixels may be larger than those of the file.
        values: (bands, H, W) float32, NaN for no data.
    """

    grid: Grid
    values: NDArray[np.float32]
