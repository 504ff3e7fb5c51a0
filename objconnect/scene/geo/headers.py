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
from objconnect.scene.quantities.heights import NO_UNIT, BandToMetres, metres_of_band

Kind = Literal["orthophoto", "surface model", "class mask"]

REFERENCE_TAG: Final = "HEIGHTS"
"""The tag of our own surface models that states the height reference."""

# GDAL decodes whole blocks, and a file of a few bytes may claim any size.
_MOST_BLOCK_BYTES = 1 << 29
# Suffixes of world files.
_WORLD_FILES = (".tfw", ".tifw", ".tiffw", ".wld")
# Tolerance of a world file, pixels: some programs write the corner of a pixel, others its centre.
_SAME_PIXELS = 1.0


@dataclass(frozen=True)
class Layout:
    """The conversion of a file's bands to values.

    Attributes:
        bands: bands to read.
        metres: conversion of a band's numbers to metres; colours are not converted.
        table: (N, 4) RGBA colours 0..255 of a palette; None without a palette.
        inverted: whether 0 is white.
        unit: whether the file states the unit of its heights.
        reference: whether the file states the height reference.
    """

    bands: ColourBands
    metres: BandToMetres = field(default_factory=BandToMetres)
    table: NDArray[np.float32] | None = None
    inverted: bool = False
    unit: bool = True
    reference: bool = True

    @property
    def channels(self) -> int:
        """Return the number of values of a pixel."""
        return len(self.bands.colours) if self.table is None else 3


def grid_of(source: Any, path: Path, kind: Kind) -> Grid:
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
    place = source.transform
    if place.is_identity:
        raise InputError(f"{kind} {path} has no place on earth: it has no geotransform")
    numbers = (place.a, place.b, place.c, place.d, place.e, place.f)
    if not all(math.isfinite(x) for x in numbers) or place.b or place.d:
        raise InputError(f"{kind} {path} is rotated against north: gdalwarp makes it north-up")
    if place.a <= 0 or place.e >= 0:
        raise InputError(f"{kind} {path} is mirrored or upside down: gdalwarp makes it north-up")
    grid = Grid(projection, place.c, place.f, (place.a, -place.e), source.width, source.height)
    try:
        _ = grid.middle
    except InputError as error:
        raise InputError(f"{kind} {path}: {error}: check its system, axes and units") from None
    _check_world_file(grid, path, kind)
    return grid


def _check_world_file(grid: Grid, path: Path, kind: Kind) -> None:
    """Refuse a GeoTIFF that contradicts the world file beside it."""
    for file in (path.with_suffix(end) for end in _WORLD_FILES):
        try:
            numbers = [float(word) for word in file.read_text().split()]
        except (OSError, ValueError):
            continue
        if len(numbers) != 6:
            continue
        across, _, _, down, left, top = numbers
        size = math.hypot(across / grid.pixel[0] - 1, -down / grid.pixel[1] - 1)
        centre = grid.left + grid.pixel[0] / 2, grid.top - grid.pixel[1] / 2
        shift = math.hypot((left - centre[0]) / grid.pixel[0], (top - centre[1]) / grid.pixel[1])
        if not (size * max(grid.width, grid.height) <= _SAME_PIXELS and shift <= _SAME_PIXELS):
            raise InputError(
                f"{kind} {path} and its world file {file.name} name two places: remove the one "
                "that is wrong"
            )


def check_blocks(source: Any, path: Path, kind: Kind) -> None:
    """Refuse a file whose blocks do not fit in memory."""
    size = max(np.dtype(name).itemsize for name in source.dtypes) * source.count
    if max(math.prod(block) for block in source.block_shapes) * size > _MOST_BLOCK_BYTES:
        raise InputError(
            f"{kind} {path} is stored in blocks that do not fit in memory: gdal_translate -co "
            "TILED=YES makes smaller ones"
        )


def layout_of(source: Any, path: Path, kind: Kind, projection: Projection) -> Layout:
    """Return the conversion of the bands to colours, heights in metres, or class numbers.

    Raises:
        InputError: the file has other bands, or does not state what they are.
    """
    if kind == "orthophoto":
        return _colours(source, path, kind)
    if kind == "surface model":
        return _heights(source, path, kind, projection)
    if source.count != 1 or set(source.dtypes) != {"uint8"}:
        raise InputError(f"{kind} {path} is not one band of 8 bits")
    return Layout(ColourBands((1,)))


def _heights(source: Any, path: Path, kind: Kind, projection: Projection) -> Layout:
    names = [interpretation.name for interpretation in source.colorinterp]
    bands = [n for n, name in enumerate(names, 1) if name != "alpha"]
    alphas = [n for n, name in enumerate(names, 1) if name == "alpha"]
    if len(bands) != 1 or len(alphas) > 1:
        raise InputError(f"{kind} {path} has {source.count} bands, heights are one band")
    k = bands[0] - 1
    if np.dtype(source.dtypes[k]).kind not in "iuf":
        raise InputError(f"{kind} {path} has values of type {source.dtypes[k]}, not heights")
    if names[k] == "palette":
        raise InputError(f"{kind} {path} has the colours of a palette, not heights")
    metres = metres_of_band(
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
    has_reference = projection.height_unit_m is not None or REFERENCE_TAG in source.tags()
    return Layout(chosen, conversion, unit=NO_UNIT not in metres.doubts, reference=has_reference)


def heights_note(layout: Layout, path: Path, stated: bool) -> str | None:
    """Return a note on assumed units or references of heights; None if the file states both.

    Args:
        layout: layout of a surface model.
        path: its file.
        stated: whether the user states the reference.
    """
    if layout.unit and (layout.reference or stated):
        return None
    if layout.reference or stated:
        return f"{path.name} states no unit of its heights: taken as metres"
    missing = "no reference" if layout.unit else "neither unit nor reference"
    unit = "" if layout.unit else "metres "
    return f"{path.name} states {missing} of its heights: taken as {unit}above the ellipsoid"


def check_undulation(projection: Projection, path: Path, undulation: float) -> None:
    """Refuse a geoid undulation for a surface model whose system defines heights."""
    if undulation and projection.height_unit_m is not None:
        raise InputError(
            f"{path} has heights above {projection.heights}, which are converted automatically: "
            "leave --undulation out"
        )


def _colours(source: Any, path: Path, kind: Kind) -> Layout:
    names = [interpretation.name for interpretation in source.colorinterp]
    structure = source.tags(ns="IMAGE_STRUCTURE")
    types = set(source.dtypes)
    if types != {"uint8"} and not ("palette" in names and types <= {"uint8", "uint16"}):
        raise InputError(
            f"{kind} {path} has values of type {source.dtypes[0]}: gdal_translate -ot Byte -scale "
            "makes 8 bits"
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
    return Layout(bands, table=_table(source, path, kind, bands.colours[0]))


def _table(source: Any, path: Path, kind: Kind, band: int) -> NDArray[np.float32]:
    try:
        colours = source.colormap(band)
    except ValueError:
        raise InputError(f"{kind} {path} has a palette without colours") from None
    table = np.zeros((max(colours) + 1, 4), np.float32)
    for number, colour in colours.items():
        table[number] = colour
    return table
