"""The ground that an orthophoto and a surface model cover, and the altitude of views above it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.virtual.flight import make_camera
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.ingestion.virtual.surface import Surface
from objconnect.scene.errors import InputError
from objconnect.scene.geo.local_coordinates import move_to_height, world_from_coordinates
from objconnect.scene.geo.rasters import Grid, Patch, Raster
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.quantities.collars import describe_collar
from objconnect.scene.runtime.progress import progress_bar

Array = NDArray[np.float64]

MAX_DEPTH_ALTITUDES: Final = 4.0
"""Surfaces farther than this many altitudes are not rendered, because texels are blurred there."""

# Rows of a raster that are read at a time.
_ROWS: Final = 256
# The height of the ground below a view is a mean over this many cells to each side. A cell is a
# quarter of the altitude wide.
_GROUND_CELLS: Final = 2


@dataclass(frozen=True)
class Survey:
    """An orthophoto, a surface model and the area that both cover.

    Attributes:
        surface: the rasters and their heights.
        ground: surface model with pixels of a quarter of the altitude; heights above the ellipsoid.
        low: (2,) west and south ends of the area that both rasters cover, world metres.
        high: (2,) east and north ends.
        altitude: height of the views above the ground, metres.
        collar: description of a rim of the orthophoto that may be no data; None without one.
    """

    surface: Surface
    ground: Patch
    low: Array
    high: Array
    altitude: float
    collar: str | None = None

    def above_ground(self, xy: Array) -> Array:
        """Return the point (3,) at the altitude of the views above a ground position (2,)."""
        origin = self.surface.origin
        point = np.array([*xy, 0.0])
        geodetic = geodetic_from_enu(point, origin)
        coordinates = self.ground.grid.projection.from_geodetic(geodetic)
        x, y = self.ground.grid.columns_rows(coordinates[:1], coordinates[1:2])
        rows, columns = (
            slice(max(0, int(c) - _GROUND_CELLS), max(0, int(c) + _GROUND_CELLS + 1))
            for c in (y[0], x[0])
        )
        window = self.ground.values[0, rows, columns]
        window = window[np.isfinite(window)]
        heights = window if window.size else self.ground.values[np.isfinite(self.ground.values)]
        point[2] = float(heights.mean()) + self.altitude - coordinates[2]
        return point


def survey_rasters(
    colours: Raster,
    heights: Raster,
    undulation: float,
    options: ViewOptions,
    origin: Geodetic | None,
) -> Survey:
    """Read both rasters completely, and compute the area that both cover.

    Args:
        colours: orthophoto.
        heights: surface model.
        undulation: height of the geoid above the ellipsoid, metres.
        options: altitude and size of the views.
        origin: origin of the world; None for the middle of the orthophoto, at the mean height of
            the surface model.

    Raises:
        InputError: a raster is damaged, there is no height, or the rasters do not overlap.
    """
    collar = describe_collar(_strips(colours))  # reads the whole file: damage is found early
    low, high = np.inf, -np.inf
    for known in _valid_rows(heights):
        low, high = min(low, float(known.min())), max(high, float(known.max()))
    if not np.isfinite(low):
        raise InputError(
            f"surface model {heights.path} has no height: all its pixels are no data, give another"
        )
    altitude = options.altitude or max(colours.grid.ground_pixel) * make_camera(options).focal[0]
    ground = heights.patch(heights.grid.box, altitude / 4)
    ground = replace(ground, values=ground.values + np.float32(undulation))
    if origin is None:
        box = colours.grid.box
        middle = np.array([(box.left + box.right) / 2, (box.bottom + box.top) / 2, 0.0])
        place = colours.grid.projection.to_geodetic(middle)
        origin = move_to_height(heights.grid.projection, place, float(np.nanmean(ground.values)))
    middle_height = (low + high) / 2 + undulation
    ends = [horizontal_bounds(raster.grid, origin, middle_height) for raster in (colours, heights)]
    south_west = np.max([low_end for low_end, _ in ends], axis=0)
    north_east = np.min([high_end for _, high_end in ends], axis=0)
    if (south_west >= north_east).any():
        raise InputError(f"{colours.path} and {heights.path} do not overlap")
    surface = Surface(colours, heights, undulation, origin, low + undulation, high + undulation)
    return Survey(surface, ground, south_west, north_east, altitude, collar)


def _valid_rows(raster: Raster) -> Iterator[NDArray[np.float32]]:
    """Read a whole raster; yield the valid values of each strip that has some, (N,)."""
    for values in _strips(raster):
        known = values[np.isfinite(values)]
        if known.size:
            yield known


def _strips(raster: Raster) -> Iterator[NDArray[np.float32]]:
    """Read a whole raster; yield the values of strips of rows, (bands, H, W)."""
    with progress_bar(f"read {raster.kind}", raster.grid.height) as advance:
        done = 0
        for strip in raster.strips(_ROWS):
            yield strip.values
            done += strip.grid.height
            advance(done)


def horizontal_bounds(grid: Grid, origin: Geodetic, height: float) -> tuple[Array, Array]:
    """Return the south-western and north-eastern corner (2,) of a grid, world metres."""
    left, bottom, right, top = grid.box
    corners = [(e, n, height) for e in (left, right) for n in (bottom, top)]
    world = world_from_coordinates(grid.projection, origin, np.array(corners))[:, :2]
    return world.min(0), world.max(0)
