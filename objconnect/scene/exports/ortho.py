"""Export to GIS: an orthophoto and a surface model as GeoTIFFs on the same grid.

``orthophoto.tif`` has 8-bit colours and an alpha band; ``dsm.tif`` holds the height of the highest
surface of each pixel, metres above the ellipsoid, or above the height reference of the chosen
system if it has one. Both are fused from the depth of the photographs: exact in simulated scenes,
else estimated by ``dense``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.depth_views import DepthView, depth_views
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.grids import scale_factors
from objconnect.scene.geo.local_coordinates import LocalProjection
from objconnect.scene.geo.rasters import Box, Grid, Patch, raster_writer
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.runtime.progress import progress_bar

Array = NDArray[np.float64]

ORTHOPHOTO: Final = "orthophoto.tif"
SURFACE: Final = "dsm.tif"

# Side of the tiles that are fused in memory, pixels.
_TILE = 2048
# The points of a pixel lie on its highest surface if they are at most this far (m) below its
# highest point, or at most one side of the pixel if that is larger. Lower points are walls.
_SAME_SURFACE_M = 0.3
# Number of passes that fill pixels without data from their neighbours.
_FILL_PASSES = 3
# Largest number of pixels of a file.
_MOST_PIXELS = 1 << 32
# Step of the rows and columns that determine the footprint of a photograph.
_FOOTPRINT_STEP = 8


def write(
    scene: Scene,
    sessions: Mapping[str, Frames],
    folder: Path,
    final: Path,
    resolution: float | None = None,
    crs: str | None = None,
) -> None:
    """Write ``orthophoto.tif`` and ``dsm.tif``; see ``formats.Writer``.

    It uses the map photographs of the sessions, or all photographs if none is in the map.

    Args:
        scene: scene with depth.
        sessions: frames by session.
        folder: folder to write to.
        final: final path of the folder.
        resolution: side of a pixel on the ground, metres; by default that of the photographs.
        crs: reference system; by default that of the UTM zone.

    Raises:
        InputError: no photograph has depth, the reference system has other units than metres, or
            the files would be larger than 4 billion pixels.
    """
    origin = scene.manifest.origin
    projection = Projection(crs or utm_of(origin))
    if not projection.is_metric:
        raise InputError(
            f"{projection.name} has other units than metres: choose another system, such as "
            f"{utm_of(origin)}"
        )
    views = depth_views(scene, sessions)
    surfaces = [view.points(_FOOTPRINT_STEP)[0] for view in views]
    views = [view for view, points in zip(views, surfaces, strict=True) if len(points)]
    surfaces = [points for points in surfaces if len(points)]
    if not views:
        raise InputError(f"the photographs of {scene.path} show no surface")
    low = np.min([points.min(0) for points in surfaces], axis=0)
    high = np.max([points.max(0) for points in surfaces], axis=0)
    local = LocalProjection.fit(projection, origin, low, high)
    boxes = [_box(local.coordinates(points)) for points in surfaces]
    resolution = resolution or _median_pixel(views, surfaces)
    pixel = max(scale_factors(projection, origin)) * resolution
    grid = _grid(projection, boxes, pixel)
    _write(folder, grid, local, views, boxes)


def utm_of(position: Geodetic) -> str:
    """Return the EPSG code of the UTM zone of a position.

    Examples:
        >>> utm_of(Geodetic(47.0, 8.0, 450.0)), utm_of(Geodetic(-33.0, 151.0, 0.0))
        ('EPSG:32632', 'EPSG:32756')
    """
    zone = min(60, math.floor((position.longitude + 180) / 6) + 1)
    return f"EPSG:{(32600 if position.latitude >= 0 else 32700) + zone}"


def _median_pixel(views: Sequence[DepthView], surfaces: Sequence[Array]) -> float:
    """Return the median side of the photographs' pixels on the ground, metres, to two digits."""
    sides = []
    for view, points in zip(views, surfaces, strict=True):
        depth = points @ view.cam_from_world[2, :3] + view.cam_from_world[2, 3]
        sides.append(float(np.median(depth)) / view.camera.focal[0])
    return float(f"{np.median(sides):.2g}")


def _box(coordinates: Array) -> Box:
    (left, bottom, _), (right, top, _) = coordinates.min(0), coordinates.max(0)
    return Box(float(left), float(bottom), float(right), float(top))


def _grid(projection: Projection, boxes: Sequence[Box], pixel: float) -> Grid:
    """Return the grid around all boxes; its edges are multiples of the pixel's side ``pixel``."""
    left = math.floor(min(box.left for box in boxes) / pixel)
    top = math.ceil(max(box.top for box in boxes) / pixel)
    width = math.ceil(max(box.right for box in boxes) / pixel) - left
    height = top - math.floor(min(box.bottom for box in boxes) / pixel)
    width, height = max(width, 1), max(height, 1)
    if width * height > _MOST_PIXELS:
        raise InputError(
            f"{width} x {height} pixels are more than a GeoTIFF should hold: choose a larger "
            "--resolution"
        )
    return Grid(projection, left * pixel, top * pixel, (pixel, pixel), width, height)


def _write(
    folder: Path,
    grid: Grid,
    local: LocalProjection,
    views: Sequence[DepthView],
    boxes: Sequence[Box],
) -> None:
    """Write both files, tile by tile."""
    tiles = []
    for tile in _tiles(grid):
        views_of_tile = [v for v, box in zip(views, boxes, strict=True) if _overlap(box, tile.box)]
        tiles.append((tile, views_of_tile))
    with ExitStack() as stack:
        surface = stack.enter_context(raster_writer(folder / SURFACE, "surface model", grid))
        colours = stack.enter_context(raster_writer(folder / ORTHOPHOTO, "orthophoto", grid))
        total = sum(2 * len(views_of_tile) for _, views_of_tile in tiles)
        advance = stack.enter_context(progress_bar("orthophoto", total))
        steps = count(1)
        for tile, views_of_tile in tiles:
            # Pixels at the edge of a tile need neighbours in the next tile.
            padded_tile = tile.part(
                -_FILL_PASSES,
                -_FILL_PASSES,
                tile.height + 2 * _FILL_PASSES,
                tile.width + 2 * _FILL_PASSES,
            )
            fused = _fuse(_Tile(padded_tile, local), views_of_tile, lambda: advance(next(steps)))
            inner = fused[:, _FILL_PASSES:-_FILL_PASSES, _FILL_PASSES:-_FILL_PASSES]
            surface(Patch(tile, inner[:1]))
            colours(Patch(tile, inner[1:]))


def _tiles(grid: Grid) -> Iterator[Grid]:
    for row in range(0, grid.height, _TILE):
        for column in range(0, grid.width, _TILE):
            height, width = min(_TILE, grid.height - row), min(_TILE, grid.width - column)
            yield grid.part(row, column, height, width)


def _overlap(a: Box, b: Box) -> bool:
    # A footprint extends beyond the sampled pixels: allow for 5 % of its longer side and 1 m.
    margin = 0.05 * max(a.right - a.left, a.top - a.bottom) + 1
    apart_x = a.right + margin < b.left or b.right < a.left - margin
    return not (apart_x or a.top + margin < b.bottom or b.top < a.bottom - margin)


@dataclass(frozen=True)
class _Tile:
    """A tile, and the projection of the world to its pixels."""

    grid: Grid
    local: LocalProjection

    def cells(self, view: DepthView) -> tuple[NDArray[np.int64], Array, Array, NDArray[np.bool_]]:
        """Return the points of a photograph inside the tile.

        Returns:
            Cell (flat index of the tile's pixel), height and weight of each point, each (n,), and
            the mask (H, W) of their pixels in the photograph. Views from above have larger weights,
            because they see whole roofs.
        """
        points, mask = view.points()
        coordinates = self.local.coordinates(points)
        x, y = self.grid.columns_rows(coordinates[:, 0], coordinates[:, 1])
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        inside = (column >= 0) & (column < self.grid.width) & (row >= 0) & (row < self.grid.height)
        centre = -view.cam_from_world[:3, :3].T @ view.cam_from_world[:3, 3]
        to_camera = centre - points[inside]
        weight = (to_camera[:, 2] / np.linalg.norm(to_camera, axis=1)) ** 4
        mask[mask] = inside
        cell = (row * self.grid.width + column)[inside]
        return cell, coordinates[inside, 2], np.maximum(weight, 1e-6), mask


def _fuse(
    tile: _Tile, views: Sequence[DepthView], advance: Callable[[], None]
) -> NDArray[np.float32]:
    """Return height and colours of a tile, (4, h, w); NaN without data.

    They are weighted means of the points of all photographs on the highest surface of a pixel.
    """
    shape = (tile.grid.height, tile.grid.width)
    top = np.full(shape[0] * shape[1], -np.inf)
    for view in views:
        cell, height, _, _ = tile.cells(view)
        np.maximum.at(top, cell, height)
        advance()
    floor = top - max(_SAME_SURFACE_M, tile.grid.pixel[0])
    sums = np.zeros((5, len(top)))
    for view in views:
        cell, height, weight, mask = tile.cells(view)
        upper = height >= floor[cell]
        cell, weight = cell[upper], weight[upper]
        rgb = view.rgb()[mask][upper]
        for total, values in zip(sums, (1, height[upper], *rgb.T), strict=True):
            total += np.bincount(cell, weight * values, len(top))
        advance()
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.asarray(sums[1:] / sums[0], np.float32).reshape(4, *shape)
    for _ in range(_FILL_PASSES):
        means = _fill_gaps(means)
    return means


def _fill_gaps(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill each empty pixel of (bands, H, W) with the mean of its eight neighbours that have data.

    At least four of them must have data.
    """
    known = np.isfinite(values[0])
    padded = np.pad(np.where(known, values, 0), ((0, 0), (1, 1), (1, 1)))
    counted = np.pad(known.astype(np.float32), 1)
    height, width = known.shape
    parts = [(slice(r, r + height), slice(c, c + width)) for r in range(3) for c in range(3)]
    count = sum(counted[part] for part in parts)
    total = sum(padded[:, *part] for part in parts)
    # A pixel with neighbours on one side only lies outside the photographed area.
    inner = ~known & (np.asarray(count) >= 4)
    filled = values.copy()
    filled[:, inner] = (total / np.maximum(count, 1))[:, inner]
    return filled
