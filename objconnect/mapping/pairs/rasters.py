"""Rasters for a pair of orthophotos: a picture placed by a homography, level ground, a shift."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.local_coordinates import LocalProjection
from objconnect.scene.geo.rasters import Grid, Patch, Raster, raster_writer
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.images import read_rgb

Array = NDArray[np.float64]

# Level ground has pixels this many times as wide as the orthophoto's, and extends beyond each edge
# by this share of the orthophoto's side.
_LEVEL_PIXEL_RATIO: Final = 8
_LEVEL_MARGIN: Final = 0.1
# Maximum side (px) of a picture that ``cv2.warpPerspective`` accepts.
_MAX_SIDE_PX: Final = 32_766


def read_homography(path: Path) -> Array:
    """Read the nine numbers of a homography (3, 3), row by row.

    Raises:
        InputError: the file cannot be read, does not hold nine finite numbers, or holds a matrix
            that mirrors or cannot be inverted.
    """
    words = read_text(path, "homography").replace(",", " ").split()
    try:
        matrix = np.array([float(word) for word in words]).reshape(3, 3)
    except ValueError:
        raise InputError(
            f"homography {path} must hold 9 numbers, row by row, as numpy.savetxt writes them"
        ) from None
    if not np.isfinite(matrix).all() or matrix[2, 2] == 0:
        raise InputError(
            f"homography {path} holds a number that is not finite, or ends in 0: compute it again"
        )
    if np.linalg.det(matrix / matrix[2, 2]) <= 0:
        raise InputError(
            f"homography {path} mirrors the picture or cannot be inverted: compute it again"
        )
    return np.asarray(matrix / matrix[2, 2])


def place_picture(picture: Path, homography: Array, mapped: Raster, out: Path) -> None:
    """Write a picture as an orthophoto in the reference system of another one.

    Args:
        picture: image file; its own georeference is not read.
        homography: (3, 3) from pixels of the picture to pixels of ``mapped``, with (0, 0) in the
            centre of the first pixel as in OpenCV.
        mapped: the orthophoto of which the map is made.
        out: GeoTIFF to write.

    Raises:
        InputError: the picture cannot be read, does not overlap with the orthophoto, or the
            homography takes a part of it to infinity.
    """
    rgb = read_rgb(picture)
    height, width = rgb.shape[:2]
    corners = np.array([(x, y, 1) for x in (0, width - 1) for y in (0, height - 1)], np.float64)
    at = corners @ homography.T
    if (at[:, 2] <= 0).any():
        raise InputError(
            f"the homography takes a part of {picture} to infinity: it must map the "
            f"picture's pixels to those of {mapped.path}"
        )
    ends = at[:, :2] / at[:, 2:]
    low = np.maximum(np.floor(ends.min(0)), 0)
    high = np.minimum(np.ceil(ends.max(0)) + 1, [mapped.grid.width, mapped.grid.height])
    if (low >= high).any():
        raise InputError(
            f"the homography places {picture} beside {mapped.path}: they do not overlap"
        )
    scale = _scale_at(homography, np.array([width / 2, height / 2, 1.0]))
    columns, rows = np.ceil((high - low) / scale).astype(int).tolist()
    if max(columns, rows) > _MAX_SIDE_PX:
        raise InputError(
            f"{picture} would become {columns} x {rows} pixels, more than {_MAX_SIDE_PX} along a "
            "side: cut it into parts or make it smaller"
        )
    # The matrix converts pixels of the written file to pixels of ``mapped``; in both, the centre of
    # the first pixel is (0, 0).
    first = low + 0.5 * scale - 0.5
    mapped_from_out = np.array([[scale, 0, first[0]], [0, scale, first[1]], [0, 0, 1]])
    warp, size = np.linalg.inv(mapped_from_out) @ homography, (columns, rows)
    colours = cv2.warpPerspective(rgb, warp, size, flags=cv2.INTER_CUBIC).astype(np.float32)
    whole = np.ones((height, width), np.uint8)
    inside = cv2.warpPerspective(whole, warp, size, flags=cv2.INTER_NEAREST)
    colours[inside == 0] = np.nan
    grid = mapped.grid.part(int(low[1]), int(low[0]), rows, columns)
    grid = replace(grid, pixel=(scale * grid.pixel[0], scale * grid.pixel[1]))
    with raster_writer(out, "orthophoto", grid) as write:
        write(Patch(grid, colours.transpose(2, 0, 1)))


def _scale_at(homography: Array, point: Array) -> float:
    """Return the scale of a homography at a homogeneous point (3,), pixels per pixel."""
    x, y, w = homography @ point
    jacobian = (homography[:2, :2] * w - np.outer([x, y], homography[2, :2])) / w**2
    return math.sqrt(abs(float(np.linalg.det(jacobian))))


def write_level_ground(orthophoto: Raster, out: Path) -> None:
    """Write a surface model of height 0 below an orthophoto and a margin around it.

    Raises:
        InputError: the file cannot be written.
    """
    grid = orthophoto.grid
    pixel = (_LEVEL_PIXEL_RATIO * grid.pixel[0], _LEVEL_PIXEL_RATIO * grid.pixel[1])
    wide, high = (
        math.ceil((1 + 2 * _LEVEL_MARGIN) * n / _LEVEL_PIXEL_RATIO)
        for n in (grid.width, grid.height)
    )
    left = grid.left - _LEVEL_MARGIN * grid.width * grid.pixel[0]
    top = grid.top + _LEVEL_MARGIN * grid.height * grid.pixel[1]
    level = Grid(grid.projection, left, top, pixel, wide, high)
    with raster_writer(out, "surface model", level) as write:
        write(Patch(level, np.zeros((1, high, wide), np.float32)))


def move(orthophoto: Raster, shift_m: Array, origin: Geodetic) -> Raster:
    """Return an orthophoto moved on the ground.

    Args:
        orthophoto: orthophoto in any reference system.
        shift_m: (2,) metres to the east and north.
        origin: origin of the world, near the orthophoto.
    """
    reach = np.full(3, 100.0)  # metres around the origin
    local = LocalProjection.fit(orthophoto.grid.projection, origin, -reach, reach)
    east, north = (local.linear[:2, :2] @ (shift_m / local.scale)).tolist()
    grid = orthophoto.grid
    return replace(orthophoto, grid=replace(grid, left=grid.left + east, top=grid.top + north))
