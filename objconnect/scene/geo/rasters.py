"""Reading and writing of GeoTIFFs: orthophotos, surface models and class masks, patch by patch.

Only this module imports rasterio, which the extra ``[geo]`` installs. Pixels are areas: a raster is
placed by the outer corner of its first pixel. GDAL converts files that state the pixel's centre
(``AREA_OR_POINT=Point``).
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.geo.grids import Box as Box
from objconnect.scene.geo.grids import Grid as Grid
from objconnect.scene.geo.grids import Patch as Patch
from objconnect.scene.geo.headers import (
    REFERENCE_TAG,
    Layout,
    check_blocks,
    check_undulation,
    heights_note,
    read_grid,
    read_layout,
)
from objconnect.scene.geo.headers import Kind as Kind
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.quantities.holes import HIGHEST_M, LOWEST_M, find_ground
from objconnect.scene.runtime.extras import import_extra
from objconnect.scene.storage.files import require_readable

NO_HEIGHT: Final = -9999.0
"""The no-data height of the surface models that we write."""

# Largest patch, pixels.
_MOST_PATCH_PIXELS = 1 << 28
# Number of pixels that are read at once to form means.
_READ_PIXELS = 1 << 22
# The search for undeclared no data reads strips of at most this many rows, and about this many
# pixels in all.
_SEARCHED_ROWS, _MOST_SEARCHED_PIXELS = 256, 1 << 26
# Side of the tiles of the files that we write, pixels.
_TILE = 256


@dataclass(frozen=True)
class Raster:
    """A GeoTIFF with a valid header.

    Attributes:
        path: file.
        kind: kind of its values.
        grid: pixel grid.
        layout: conversion of its bands to values.
        lowest: lower heights are no data, metres.
        highest: higher heights are no data, metres.
        holes: heights that stand for no data, metres.
        doubts: lines about no data that the file does not declare.
    """

    path: Path
    kind: Kind
    grid: Grid
    layout: Layout
    lowest: float = LOWEST_M
    highest: float = HIGHEST_M
    holes: tuple[float, ...] = ()
    doubts: tuple[str, ...] = ()

    @staticmethod
    def open(path: Path, kind: Kind) -> Raster:
        """Read the header of a GeoTIFF.

        Args:
            path: file. An orthophoto has 8-bit bands marked red, green and blue, or one band of
                grey or of a palette. A surface model has one band of heights, which is searched for
                no-data heights that the file does not declare. A class mask has one 8-bit band.
            kind: required kind.

        Raises:
            InputError: rasterio is not installed, or the file is missing, damaged, not a GeoTIFF,
                has no reference system in metres, is rotated, or has other or unmarked bands.
        """
        with _open(path, kind) as source:
            grid = read_grid(source, path, kind)
            check_blocks(source, path, kind)
            layout = read_layout(source, path, kind, grid.projection)
            declares_no_data = any(value is not None for value in source.nodatavals)
        raster = Raster(path, kind, grid, layout)
        return _find_no_data(raster, declares_no_data) if kind == "surface model" else raster

    def notes(self, place: Geodetic, undulation: float | None = None) -> tuple[str, ...]:
        """Return notes on the file for the user, one line each.

        Args:
            place: place where the file is used.
            undulation: geoid undulation that the user states, metres; None if not stated.

        Raises:
            InputError: ``undulation`` contradicts the file.
        """
        projection = self.grid.projection
        lines = [projection.doubt_at(place), *self.doubts]
        if not projection.reaches(self.grid.middle):
            latitude, longitude, _ = self.grid.middle
            lines.append(
                f"{self.path.name} lies at latitude {latitude:.3f}, longitude {longitude:.3f}, far "
                f"outside the area that {projection.name} is for: check its system, axes and units"
            )
        if self.kind == "surface model":
            check_undulation(projection, self.path, undulation or 0.0)
            lines.append(heights_note(self.layout, self.path, undulation is not None) or "")
        return tuple(line for line in lines if line)

    @property
    def bands(self) -> tuple[int, ...]:
        """Return the numbers of the bands to read, from 1."""
        return self.layout.bands.colours

    def patch(self, box: Box, pixel: float = 0.0) -> Patch:
        """Read a rectangle of the raster.

        Args:
            box: rectangle in the raster's coordinates. The patch covers its part inside the raster
                and one more pixel on each side. If the box lies outside the raster, the patch is
                one pixel without data.
            pixel: required size of a pixel on the ground, metres. If the file's pixels are at most
                half as large, each pixel of the patch is the mean of several.

        Raises:
            InputError: the file is damaged there, or the patch has more than 268 million pixels.
        """
        grid = self.grid
        factor = min(max(1, math.floor(pixel / max(grid.ground_pixel))), grid.width, grid.height)
        ends = np.array([box.left, box.right]), np.array([box.top, box.bottom])
        across, down = grid.columns_rows(*ends)
        columns, rows = _span(across, grid.width, factor), _span(down, grid.height, factor)
        if columns.start >= columns.stop or rows.start >= rows.stop:
            empty = np.full((self.layout.channels, 1, 1), np.nan, np.float32)
            return Patch(grid.part(0, 0, 1, 1), empty)
        height = math.ceil((rows.stop - rows.start) / factor)
        width = math.ceil((columns.stop - columns.start) / factor)
        if height * width > _MOST_PATCH_PIXELS:
            raise InputError(
                f"{width} x {height} pixels of {self.kind} {self.path} do not fit in memory: give "
                "a smaller file"
            )
        columns = range(columns.start, columns.start + width * factor)
        rows = range(rows.start, rows.start + height * factor)
        part = grid.part(rows.start, columns.start, height, width)
        part = replace(part, pixel=(factor * grid.pixel[0], factor * grid.pixel[1]))
        return Patch(part, self._read(rows, columns, factor))

    def _read(self, rows: range, columns: range, factor: int) -> NDArray[np.float32]:
        """Read means of ``factor`` x ``factor`` pixels, (bands, H, W); NaN for no data.

        The lengths of the ranges are multiples of the factor; ranges may reach beyond the raster.
        """
        shape = (self.layout.channels, len(rows) // factor, len(columns) // factor)
        values = np.full(shape, np.nan, np.float32)
        rows_at_once = max(1, _READ_PIXELS // (len(columns) * factor))
        with _open(self.path, self.kind) as source:
            for first in range(0, shape[1], rows_at_once):
                part = values[:, first : first + rows_at_once]
                top = rows.start + first * factor
                pixels = self._pixels(source, range(top, top + part.shape[1] * factor), columns)
                part[:] = pixels if factor == 1 else _means(pixels, factor)
        return values

    def _pixels(self, source: Any, rows: range, columns: range) -> NDArray[np.float32]:
        """Read pixels of the file, (bands, H, W); those beyond its edges are NaN."""
        windows = import_extra("rasterio.windows", "geo", "a GeoTIFF")
        values = np.full((self.layout.channels, len(rows), len(columns)), np.nan, np.float32)
        height = min(rows.stop, self.grid.height) - rows.start
        width = min(columns.stop, self.grid.width) - columns.start
        window = windows.Window(columns.start, rows.start, width, height)
        read = self._heights if self.kind == "surface model" else self._colours
        values[:, :height, :width] = np.where(
            self._read_mask(source, window), read(source, window), np.nan
        )
        return values

    def _read_mask(self, source: Any, window: Any) -> NDArray[np.bool_]:
        """Return the mask of pixels with data that the file declares, (H, W).

        A colour is no data only if all its bands have the no-data value.
        """
        known: NDArray[np.bool_] = source.read_masks(list(self.bands), window=window).any(0)
        alpha = self.layout.bands.alpha
        if alpha is not None:
            known &= source.read(alpha, window=window) > 0
        return known

    def _heights(self, source: Any, window: Any) -> NDArray[np.float32]:
        """Return heights in metres, (1, H, W); NaN if impossible or undeclared no data."""
        metres = self.layout.to_metres
        dtype = np.float32 if metres.is_metres else np.float64
        values = source.read(list(self.bands), window=window, out_dtype=dtype)
        if not metres.is_metres:
            values = (values * metres.factor + metres.offset).astype(np.float32)
        values[~((values >= self.lowest) & (values < self.highest))] = np.nan
        for height in self.holes:
            values[values == np.float32(height)] = np.nan
        return np.asarray(values)

    def _colours(self, source: Any, window: Any) -> NDArray[np.float32]:
        """Return colours in 0..255, or class numbers, (channels, H, W)."""
        palette = self.layout.palette
        values = source.read(list(self.bands), window=window)
        if palette is None:
            return np.asarray(255 - values if self.layout.inverted else values, np.float32)
        numbers = values[0]
        colours = palette[np.minimum(numbers, len(palette) - 1)]
        colours[(numbers >= len(palette)) | (colours[..., 3] == 0)] = np.nan
        return np.moveaxis(colours[..., :3], -1, 0)

    def strips(self, rows: int = 1024, every: int = 1) -> Iterator[Patch]:
        """Read strips of the raster from top to bottom.

        Args:
            rows: height of a strip, pixels.
            every: one strip in this many is read.

        Raises:
            InputError: the file is damaged.
        """
        for first in range(0, self.grid.height, every * rows):
            count = min(rows, self.grid.height - first)
            part = self.grid.part(first, 0, count, self.grid.width)
            pixels = self._read(range(first, first + count), range(self.grid.width), 1)
            yield Patch(part, pixels)


def _find_no_data(raster: Raster, declares_no_data: bool) -> Raster:
    """Return a surface model with the no-data heights that its file does not declare.

    Raises:
        InputError: the file is damaged, or no data cannot be distinguished from flat ground.
    """

    def strips() -> Iterator[NDArray[np.float32]]:
        return (strip.values[0] for strip in raster.strips(_SEARCHED_ROWS, every))

    every = math.ceil(raster.grid.width * raster.grid.height / _MOST_SEARCHED_PIXELS)
    pixel_m = max(raster.grid.ground_pixel)
    ground = find_ground(strips, declares_no_data, pixel_m, f"{raster.kind} {raster.path}")
    return replace(
        raster,
        lowest=ground.lowest,
        highest=ground.highest,
        holes=ground.holes,
        doubts=tuple(f"{raster.path.name}: {doubt}" for doubt in ground.doubts),
    )


def _span(ends: NDArray[np.float64], size: int, factor: int) -> range:
    """Return the pixels between two positions and one more at each end, clipped to the raster."""
    low, high = (float(np.clip(end, -2, size + 2)) for end in ends)
    start = max(0, math.floor(low) - 1) // factor * factor
    return range(start, min(size, math.ceil(high) + 1))


def _means(pixels: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return means of ``factor`` x ``factor`` pixels of (bands, H, W), ignoring NaN."""
    bands, height, width = pixels.shape
    blocks = pixels.reshape(bands, height // factor, factor, width // factor, factor)
    known = np.isfinite(blocks)
    count = known.sum((2, 4))
    total = np.where(known, blocks, 0).sum((2, 4), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


@contextmanager
def _open(path: Path, kind: Kind) -> Iterator[Any]:
    """Open a GeoTIFF; errors inside the block are reported like those of opening it."""
    rasterio = import_extra("rasterio", "geo", "a GeoTIFF")
    # Suppress GDAL's warnings about a damaged file: our error message reports it.
    logging.getLogger("rasterio").setLevel(logging.ERROR)
    require_readable(path, kind)
    try:
        # The driver is fixed, because GDAL also opens other formats and network addresses.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(str(path.resolve()), driver="GTiff") as source:
                yield source
    except InputError:
        raise
    except (rasterio.errors.RasterioError, ValueError, MemoryError, OverflowError) as error:
        reason = str(error.__cause__ or error).partition("\n")[0]
        raise InputError(
            f"{kind} {path} is damaged or not a GeoTIFF: {reason or 'it cannot be decoded'}"
        ) from None


@contextmanager
def raster_writer(path: Path, kind: Kind, grid: Grid) -> Iterator[Callable[[Patch], None]]:
    """Write a GeoTIFF: colours with an alpha band, or heights with ``NO_HEIGHT`` as no data.

    Call the yielded function with each patch of the grid: (3, H, W) colours in 0..255 or (1, H, W)
    heights, NaN for no data.

    Args:
        path: file to write, in an existing folder.
        kind: kind of the values.
        grid: pixel grid.

    Raises:
        InputError: rasterio is not installed.
        WriteError: the file cannot be written.
    """
    rasterio = import_extra("rasterio", "geo", "a GeoTIFF")
    transform = import_extra("rasterio.transform", "geo", "a GeoTIFF")
    windows = import_extra("rasterio.windows", "geo", "a GeoTIFF")
    coloured = kind == "orthophoto"
    profile = {
        "driver": "GTiff",
        "width": grid.width,
        "height": grid.height,
        "crs": grid.projection.wkt,
        "transform": transform.from_origin(grid.left, grid.top, *grid.pixel),
        "tiled": True,
        "blockxsize": _TILE,
        "blockysize": _TILE,
        "compress": "deflate",
        "bigtiff": "if_safer",
    }
    profile |= (
        {"count": 4, "dtype": "uint8", "predictor": 2, "photometric": "rgb", "alpha": "yes"}
        if coloured
        else {"count": 1, "dtype": "float32", "predictor": 3, "nodata": NO_HEIGHT}
    )

    def write(patch: Patch) -> None:
        column, row = grid.columns_rows(np.array(patch.grid.left), np.array(patch.grid.top))
        corner = (round(float(column)), round(float(row)))
        window = windows.Window(*corner, patch.grid.width, patch.grid.height)
        target.write(_encode(patch.values, coloured), window=window)

    try:
        with rasterio.open(str(path), "w", **profile) as target:
            if not coloured:
                target.units = ["metre"]
                if grid.projection.height_unit_m is None:
                    target.update_tags(**{REFERENCE_TAG: "above the ellipsoid"})
            yield write
    except rasterio.errors.RasterioError as error:
        raise WriteError(f"cannot write {path}: {error.__cause__ or error}") from None


def _encode(values: NDArray[np.float32], coloured: bool) -> NDArray[Any]:
    """Return values in the stored encoding, (bands, H, W)."""
    known = np.isfinite(values).all(0)
    if not coloured:
        return np.where(known, values, np.float32(NO_HEIGHT))
    colours = np.rint(np.clip(np.where(known, values, 0), 0, 255)).astype(np.uint8)
    return np.concatenate([colours, np.where(known, 255, 0).astype(np.uint8)[None]])
