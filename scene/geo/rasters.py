"""GeoTIFFs: orthophotos and surface models, read and written piece by piece.

This is the one module that imports rasterio, which the extra ``[geo]`` installs. A pixel is an
area: the position of a raster is the outer corner of its first pixel, also where the file names the
pixel's centre (``AREA_OR_POINT=Point``), which GDAL shifts.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError, WriteError
from scene.geo.crs import Projection
from scene.runtime.extras import import_extra
from scene.storage.files import require_readable

Kind = Literal["orthophoto", "surface model"]
NO_HEIGHT: Final = -9999.0
"""The height that stands for no data in the surface models that we write."""

# Heights of no ground on earth (m): files often use such values for no data without saying so.
_LOWEST, _HIGHEST = -1_000.0, 10_000.0
# GDAL decodes a block as a whole, and a file of a few bytes may claim any size.
_MOST_BLOCK_BYTES = 1 << 29
_MOST_PATCH_PIXELS = 1 << 28
# Pixels that are read at once to form means.
_READ_PIXELS = 1 << 22
# Rows and columns of the tiles of the files that we write.
_TILE = 256


class Box(NamedTuple):
    """A rectangle in the coordinates of a reference system, metres."""

    left: float
    bottom: float
    right: float
    top: float


@dataclass(frozen=True)
class Grid:
    """Where the pixels of a north-up raster lie.

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
        """Return the outline."""
        right = self.left + self.width * self.pixel[0]
        return Box(self.left, self.top - self.height * self.pixel[1], right, self.top)

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
    """A piece of a raster in memory.

    Attributes:
        grid: where its pixels lie; they may be larger than those of the file.
        values: (bands, H, W) float32, NaN where there is no data.
    """

    grid: Grid
    values: NDArray[np.float32]


@dataclass(frozen=True)
class Raster:
    """A GeoTIFF whose header was read and found usable.

    Attributes:
        path: file.
        kind: what its values are.
        grid: where its pixels lie.
        bands: numbers of the bands that are read, from 1.
    """

    path: Path
    kind: Kind
    grid: Grid
    bands: tuple[int, ...]

    @staticmethod
    def open(path: Path, kind: Kind) -> Raster:
        """Read the header of a GeoTIFF.

        Args:
            path: file. An orthophoto has 8 bits and 1 band (grey), 3 or 4 bands (colours, of which
                the first three are read); a surface model has 1 band of heights in metres.
            kind: what the file has to be.

        Raises:
            InputError: rasterio is not installed, or the file is missing, damaged, no GeoTIFF, has
                no reference system in metres, is rotated, or has other bands.
        """
        with _opened(path, kind) as source:
            grid = _grid(source, path, kind)
            _check_blocks(source, path, kind)
            return Raster(path, kind, grid, _bands(source, path, kind))

    def patch(self, box: Box, pixel: float = 0.0) -> Patch:
        """Read a rectangle of the raster.

        Args:
            box: rectangle in the raster's coordinates. The patch covers the part of it that lies in
                the raster, and a pixel more; a patch beyond the raster is one pixel without data.
            pixel: size of the pixels that are needed, metres. Where those of the file are at most
                half as large, each pixel of the patch is the mean of several.

        Raises:
            InputError: the file is damaged there, or the patch has more than 268 million pixels.
        """
        grid = self.grid
        factor = min(max(1, math.floor(pixel / max(grid.pixel))), grid.width, grid.height)
        ends = np.array([box.left, box.right]), np.array([box.top, box.bottom])
        across, down = grid.columns_rows(*ends)
        columns, rows = _span(across, grid.width, factor), _span(down, grid.height, factor)
        if columns.start >= columns.stop or rows.start >= rows.stop:
            nothing = np.full((len(self.bands), 1, 1), np.nan, np.float32)
            return Patch(grid.part(0, 0, 1, 1), nothing)
        height = math.ceil((rows.stop - rows.start) / factor)
        width = math.ceil((columns.stop - columns.start) / factor)
        if height * width > _MOST_PATCH_PIXELS:
            raise InputError(
                f"{width} x {height} pixels of {self.kind} {self.path} do not fit in memory: give "
                "a smaller one"
            )
        columns = range(columns.start, columns.start + width * factor)
        rows = range(rows.start, rows.start + height * factor)
        part = grid.part(rows.start, columns.start, height, width)
        part = replace(part, pixel=(factor * grid.pixel[0], factor * grid.pixel[1]))
        return Patch(part, self._read(rows, columns, factor))

    def _read(self, rows: range, columns: range, factor: int) -> NDArray[np.float32]:
        """Read means of ``factor`` x ``factor`` pixels (bands, H, W), NaN where there is no data.

        The ranges are multiples of the factor and may reach beyond the raster.
        """
        shape = (len(self.bands), len(rows) // factor, len(columns) // factor)
        values = np.full(shape, np.nan, np.float32)
        at_once = max(1, _READ_PIXELS // (len(columns) * factor))
        with _opened(self.path, self.kind) as source:
            for first in range(0, shape[1], at_once):
                part = values[:, first : first + at_once]
                top = rows.start + first * factor
                pixels = self._pixels(source, range(top, top + part.shape[1] * factor), columns)
                part[:] = pixels if factor == 1 else _means(pixels, factor)
        return values

    def _pixels(self, source: Any, rows: range, columns: range) -> NDArray[np.float32]:
        """Read pixels of the file, (bands, H, W); those beyond its edges are NaN."""
        windows = import_extra("rasterio.windows", "geo", "a GeoTIFF")
        values = np.full((len(self.bands), len(rows), len(columns)), np.nan, np.float32)
        height = min(rows.stop, self.grid.height) - rows.start
        width = min(columns.stop, self.grid.width) - columns.start
        window = windows.Window(columns.start, rows.start, width, height)
        read = source.read(list(self.bands), window=window, masked=True, out_dtype=np.float32)
        values[:, :height, :width] = read.filled(np.nan)
        if self.kind == "surface model":
            values[~((values > _LOWEST) & (values < _HIGHEST))] = np.nan
        return values

    def strips(self, rows: int = 1024) -> Iterator[Patch]:
        """Read the whole raster from top to bottom, ``rows`` rows at a time.

        Raises:
            InputError: the file is damaged.
        """
        for first in range(0, self.grid.height, rows):
            count = min(rows, self.grid.height - first)
            part = self.grid.part(first, 0, count, self.grid.width)
            pixels = self._read(range(first, first + count), range(self.grid.width), 1)
            yield Patch(part, pixels)


def _span(ends: NDArray[np.float64], size: int, factor: int) -> range:
    """Return the pixels between two positions with one more at each end, cut to the raster."""
    low, high = (float(np.clip(end, -2, size + 2)) for end in ends)
    start = max(0, math.floor(low) - 1) // factor * factor
    return range(start, min(size, math.ceil(high) + 1))


def _means(pixels: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Return means of ``factor`` x ``factor`` pixels of (bands, H, W); those without data are left
    out."""
    bands, height, width = pixels.shape
    blocks = pixels.reshape(bands, height // factor, factor, width // factor, factor)
    known = np.isfinite(blocks)
    count = known.sum((2, 4))
    total = np.where(known, blocks, 0).sum((2, 4), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


@contextmanager
def _opened(path: Path, kind: Kind) -> Iterator[Any]:
    """Open a GeoTIFF; errors of the block are reported like those of opening it."""
    rasterio = import_extra("rasterio", "geo", "a GeoTIFF")
    # GDAL's warnings about a damaged file would be printed beside our one line.
    logging.getLogger("rasterio").setLevel(logging.ERROR)
    require_readable(path, kind)
    try:
        # GDAL would read the names of other formats and of networks as well.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(str(path.resolve()), driver="GTiff") as source:
                yield source
    except InputError:
        raise
    except (rasterio.errors.RasterioError, ValueError, MemoryError, OverflowError) as error:
        reason = str(error.__cause__ or error).partition("\n")[0]
        raise InputError(
            f"{kind} {path} is damaged or no GeoTIFF: {reason or 'it cannot be decoded'}"
        ) from None


def _grid(source: Any, path: Path, kind: Kind) -> Grid:
    if source.crs is None:
        raise InputError(
            f"{kind} {path} has no coordinate reference system: gdal_edit -a_srs EPSG:n adds it"
        )
    projection = Projection(source.crs.to_wkt())
    if not projection.is_metric:
        raise InputError(
            f"{kind} {path} is in {projection.name}, whose units are not metres: gdalwarp -t_srs "
            "EPSG:n converts it, for example to UTM"
        )
    place = source.transform
    if place.is_identity:
        raise InputError(f"{kind} {path} has no place on earth: it has no geotransform")
    numbers = (place.a, place.b, place.c, place.d, place.e, place.f)
    if not all(math.isfinite(x) for x in numbers) or place.b or place.d:
        raise InputError(f"{kind} {path} is rotated against north: gdalwarp turns it upright")
    if place.a <= 0 or place.e >= 0:
        raise InputError(f"{kind} {path} does not have north above: gdalwarp turns it upright")
    return Grid(projection, place.c, place.f, (place.a, -place.e), source.width, source.height)


def _check_blocks(source: Any, path: Path, kind: Kind) -> None:
    size = max(np.dtype(name).itemsize for name in source.dtypes) * source.count
    if max(math.prod(block) for block in source.block_shapes) * size > _MOST_BLOCK_BYTES:
        raise InputError(
            f"{kind} {path} is stored in pieces that do not fit in memory: gdal_translate -co "
            "TILED=YES makes smaller ones"
        )


def _bands(source: Any, path: Path, kind: Kind) -> tuple[int, ...]:
    types = set(source.dtypes)
    if kind == "surface model":
        if source.count != 1:
            raise InputError(f"{kind} {path} has {source.count} bands, heights are one band")
        if any(np.dtype(name).kind not in "iuf" for name in types):
            raise InputError(f"{kind} {path} has values of type {source.dtypes[0]}, not heights")
        return (1,)
    if source.count not in (1, 3, 4):
        raise InputError(
            f"{kind} {path} has {source.count} bands: give 1 (grey), 3 or 4 (colours, of which the "
            "first three are read)"
        )
    if types != {"uint8"}:
        raise InputError(
            f"{kind} {path} has values of type {source.dtypes[0]}: gdal_translate -ot Byte -scale "
            "makes 8 bits"
        )
    return (1,) if source.count == 1 else (1, 2, 3)


@contextmanager
def raster_writer(path: Path, kind: Kind, grid: Grid) -> Iterator[Callable[[Patch], None]]:
    """Write a GeoTIFF: colours with an alpha band, or heights with ``NO_HEIGHT`` as no data.

    Call the yielded function with each piece of the grid, of the same pixels: (3, H, W) colours in
    0..255 or (1, H, W) heights, NaN where there is no data.

    Args:
        path: file to write, in a folder that exists.
        kind: what the values are.
        grid: where the pixels lie.

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
        place = (round(float(column)), round(float(row)))
        window = windows.Window(*place, patch.grid.width, patch.grid.height)
        target.write(_coded(patch.values, coloured), window=window)

    try:
        with rasterio.open(str(path), "w", **profile) as target:
            yield write
    except rasterio.errors.RasterioError as error:
        raise WriteError(f"cannot write {path}: {error.__cause__ or error}") from None


def _coded(values: NDArray[np.float32], coloured: bool) -> NDArray[Any]:
    """Return values as they are stored, (bands, H, W)."""
    known = np.isfinite(values).all(0)
    if not coloured:
        return np.where(known, values, np.float32(NO_HEIGHT))
    colours = np.rint(np.clip(np.where(known, values, 0), 0, 255)).astype(np.uint8)
    return np.concatenate([colours, np.where(known, 255, 0).astype(np.uint8)[None]])
