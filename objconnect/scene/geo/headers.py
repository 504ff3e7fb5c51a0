"""Interpretation of GeoTIFF headers: pixel grid, bands, units and colours.

The functions take a file that rasterio has opened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.grids import Grid
from objconnect.scene.geo.keys import unit_of_heights
from objconnect.scene.quantities.bands import ColourBands, colour_bands
from objconnect.scene.quantities.heights import NO_UNIT, BandToMetres, band_to_metres

Kind = Literal["orthophoto", "surface model", "class mask"]

REFERENCE_TAG: Final = "HEIGHTS"
"""The tag of our own surface models that states the height reference."""

# Largest size of a block. GDAL decodes whole blocks, and a header may state blocks of any size.
_MOST_BLOCK_BYTES = 1 << 29
# Suffixes of world files.
_WORLD_FILE_SUFFIXES = (".tfw", ".tifw", ".tiffw", ".wld")
# Tolerance of a world file, pixels: some programs write the corner of a pixel, others its centre.
_WORLD_FILE_TOLERANCE_PX = 1.0


@dataclass(frozen=True)
class Layout:
    """The conversion of a file's bands to values.

    Attributes:
        bands: bands to read.
        to_metres: conversion of a band's numbers to metres; colours are not converted.
        palette: (N, 4) RGBA colours 0..255 of a palette; None without a palette.
        inverted: whether 0 is white.
        states_unit: whether the file states the unit of its heights.
        states_reference: whether the file states the height reference.
    """

    bands: ColourBands
    to_metres: BandToMetres = field(default_factory=BandToMetres)
    palette: NDArray[np.float32] | None = None
    inverted: bool = False
    states_unit: bool = True
    states_reference: bool = True

    @property
    def channels(self) -> int:
        """Return the number of values of a pixel."""
        return len(self.bands.colours) if self.palette is None else 3


def read_grid(source: Any, path: Path, kind: Kind) -> Grid:
    """Return the pixel grid of a file.

    Raises:
        InputError: the file has no reference system in metres or no geotransform, or is not
            north-up.
    """
    if source.crs is None:
        if source.gcps[0]:
            raise InputError(
                f"{kind} {path} is placed by ground control points: gdalwarp -t_srs EPSG:n "
                "makes it north-up"
            )
        raise InputError(
            f"{kind} {path} has no coordinate reference system: gdal_edit -a_srs EPSG:n adds it"
        )
    try:
        heights = {"metric_heights": True} if kind == "surface model" else {"horizontal": True}
        projection = Projection(source.crs.to_wkt(), **heights)
    except InputError as error:
        raise InputError(f"{kind} {path}: {error}") from None
    if not projection.is_metric:
        raise InputError(
            f"{kind} {path} is in {projection.name}, whose units are not metres: gdalwarp -t_srs "
            "EPSG:n converts it, for example to UTM"
        )
    transform = source.transform
    if transform.is_identity:
        raise InputError(f"{kind} {path} has no geotransform: gdal_edit -a_ullr adds it")
    a, b, left, d, e, top = tuple(transform)[:6]
    if not all(math.isfinite(x) for x in (a, b, left, d, e, top)):
        raise InputError(
            f"{kind} {path} has a geotransform that is not finite: gdal_edit -a_ullr replaces it"
        )
    if b or d:
        raise InputError(f"{kind} {path} is rotated against north: gdalwarp makes it north-up")
    if a <= 0 or e >= 0:
        raise InputError(f"{kind} {path} is mirrored or upside down: gdalwarp makes it north-up")
    grid = Grid(projection, left, top, (a, -e), source.width, source.height)
    try:
        _ = grid.middle
    except InputError as error:
        raise InputError(f"{kind} {path}: {error}: check its system, axes and units") from None
    _check_world_file(grid, path, kind)
    return grid


def _check_world_file(grid: Grid, path: Path, kind: Kind) -> None:
    """Refuse a GeoTIFF that contradicts the world file beside it."""
    for file in (path.with_suffix(end) for end in _WORLD_FILE_SUFFIXES):
        try:
            numbers = [float(word) for word in file.read_text().split()]
        except (OSError, ValueError):
            continue
        if len(numbers) != 6:
            continue
        x_scale, _, _, y_scale, east, north = numbers
        scale_error = math.hypot(x_scale / grid.pixel[0] - 1, -y_scale / grid.pixel[1] - 1)
        stretch = scale_error * max(grid.width, grid.height)
        centre = grid.left + grid.pixel[0] / 2, grid.top - grid.pixel[1] / 2
        shift = math.hypot((east - centre[0]) / grid.pixel[0], (north - centre[1]) / grid.pixel[1])
        if not (stretch <= _WORLD_FILE_TOLERANCE_PX and shift <= _WORLD_FILE_TOLERANCE_PX):
            raise InputError(
                f"{kind} {path} and its world file {file.name} state different positions: remove "
                "the world file if it is wrong, else correct the GeoTIFF with gdal_edit -a_ullr"
            )


def check_blocks(source: Any, path: Path, kind: Kind) -> None:
    """Refuse a file whose blocks do not fit in memory."""
    size = max(np.dtype(name).itemsize for name in source.dtypes) * source.count
    if max(math.prod(block) for block in source.block_shapes) * size > _MOST_BLOCK_BYTES:
        raise InputError(
            f"{kind} {path} is stored in blocks that do not fit in memory: gdal_translate -co "
            "TILED=YES makes smaller ones"
        )


def read_layout(source: Any, path: Path, kind: Kind, projection: Projection) -> Layout:
    """Return the conversion of the bands to colours, heights in metres, or class numbers.

    Raises:
        InputError: the bands do not fit the kind, or the file does not state what they are.
    """
    if kind == "orthophoto":
        return _colour_layout(source, path, kind)
    if kind == "surface model":
        return _height_layout(source, path, kind, projection)
    if source.count != 1 or set(source.dtypes) != {"uint8"}:
        raise InputError(
            f"{kind} {path} has {source.count} bands of {', '.join(sorted(set(source.dtypes)))}: "
            "gdal_translate -b 1 -ot Byte makes one band of 8 bits"
        )
    return Layout(ColourBands((1,)))


def _height_layout(source: Any, path: Path, kind: Kind, projection: Projection) -> Layout:
    names = [interpretation.name for interpretation in source.colorinterp]
    bands = [n for n, name in enumerate(names, 1) if name != "alpha"]
    alphas = [n for n, name in enumerate(names, 1) if name == "alpha"]
    if len(bands) != 1 or len(alphas) > 1:
        raise InputError(
            f"{kind} {path} has {source.count} bands, heights are one band: give a surface model "
            "or keep its band with gdal_translate -b"
        )
    k = bands[0] - 1
    if np.dtype(source.dtypes[k]).kind not in "iuf":
        raise InputError(f"{kind} {path} has values of type {source.dtypes[k]}, not heights")
    if names[k] == "palette":
        raise InputError(f"{kind} {path} has the colours of a palette, not heights")
    metres = band_to_metres(
        source.units[k],
        source.scales[k],
        source.offsets[k],
        projection.height_unit_m,
        unit_of_heights(path),
    )
    conversion = metres.require(
        f"{kind} {path}", "state it once: gdal_edit -a_srs EPSG:n -units metre (or foot)"
    )
    chosen = ColourBands((bands[0],), alphas[0] if alphas else None)
    return Layout(
        chosen,
        conversion,
        states_unit=NO_UNIT not in metres.doubts,
        states_reference=projection.height_unit_m is not None or REFERENCE_TAG in source.tags(),
    )


def heights_note(layout: Layout, path: Path, user_states: bool) -> str | None:
    """Return a note on assumed units or references of heights; None if the file states both.

    Args:
        layout: layout of a surface model.
        path: its file.
        user_states: whether the user states the reference.
    """
    has_reference = layout.states_reference or user_states
    if layout.states_unit and has_reference:
        return None
    if has_reference:
        return f"{path.name} states no unit of its heights: taken as metres"
    missing = "no reference" if layout.states_unit else "neither unit nor reference"
    unit = "" if layout.states_unit else "metres "
    return f"{path.name} states {missing} of its heights: taken as {unit}above the ellipsoid"


def check_undulation(projection: Projection, path: Path, undulation: float) -> None:
    """Refuse a geoid undulation for a surface model whose system defines heights."""
    if undulation and projection.height_unit_m is not None:
        raise InputError(
            f"{path} has heights above {projection.height_reference}, which are converted "
            "automatically: leave --undulation out"
        )


def _colour_layout(source: Any, path: Path, kind: Kind) -> Layout:
    names = [interpretation.name for interpretation in source.colorinterp]
    structure = source.tags(ns="IMAGE_STRUCTURE")
    types = set(source.dtypes)
    if types != {"uint8"} and not ("palette" in names and types <= {"uint8", "uint16"}):
        raise InputError(
            f"{kind} {path} has values of type {source.dtypes[0]}: {_to_bytes(source.dtypes[0])}"
        )
    space = structure.get("SOURCE_COLOR_SPACE", "YCbCr")
    if space != "YCbCr":
        raise InputError(f"{kind} {path} has colours in {space}: convert it to RGB")
    bands = colour_bands(names, source.descriptions).require(
        f"{kind} {path}",
        "say what each band is with gdal_edit -colorinterp_1 red (green, blue, nir, undefined), "
        "-colorinterp_2 and so on",
    )
    chosen = [n - 1 for n in bands.colours]
    if len({(source.scales[k], source.offsets[k]) for k in chosen}) > 1:
        raise InputError(
            f"{kind} {path} has bands with different scales or offsets: gdal_translate -unscale "
            "-ot Byte applies them"
        )
    if not bands.palette:
        return Layout(bands, inverted=structure.get("MINISWHITE") == "YES")
    return Layout(bands, palette=_read_palette(source, path, kind, bands.colours[0]))


def _to_bytes(dtype: str) -> str:
    """Return how to convert values of a type to 8 bits."""
    if not dtype.startswith("float"):
        return "gdal_translate -ot Byte -scale makes 8 bits"
    return (
        "gdal_translate -a_nodata 0 -ot Byte -scale LOWEST HIGHEST 1 255 makes 8 bits and declares "
        "0 as no data (undeclared NaN would become black ground)"
    )


def _read_palette(source: Any, path: Path, kind: Kind, band: int) -> NDArray[np.float32]:
    try:
        colours = source.colormap(band)
    except ValueError:
        raise InputError(f"{kind} {path} has a palette without colours") from None
    table = np.zeros((max(colours) + 1, 4), np.float32)
    for number, colour in colours.items():
        table[number] = colour
    return table
