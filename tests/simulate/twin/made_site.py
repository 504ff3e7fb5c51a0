"""A synthetic site of 140 m with all classes, and its rasters in any reference system.

Heights, colours and classes are functions of the world's east and north, so that what the twin
finds can be compared with numbers that no file went through.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from tests.objconnect.scene.geo.made_site import _world

Array = NDArray[np.float64]

ORIGIN = Geodetic(47.0, 8.0, 450.0)
HALF_M, PIXEL_M = 70.0, 0.5
ROOF_M, CROWN_M = 8.0, 7.0
# west, east, south, north
HOUSE = (-30.0, -14.0, 10.0, 22.0)
POND = (10.0, 45.0, -50.0, -20.0)
YARD = (-60.0, 0.0, -45.0, -5.0)  # paved
TREES = ((20.0, 20.0, 5.0), (35.0, 35.0, 4.0), (25.0, 45.0, 3.5), (48.0, 12.0, 4.5))
GREEN, GREY, ROOF_RGB, WATER_RGB, CROWN_RGB = (
    np.array(rgb)
    for rgb in ((110, 128, 74), (120, 120, 122), (150, 140, 138), (38, 52, 62), (60, 80, 36))
)


def _inside(x: Array, y: Array, box: tuple[float, float, float, float]) -> NDArray[np.bool_]:
    west, east, south, north = box
    return np.asarray((x > west) & (x < east) & (y > south) & (y < north))


def ground(x: Array, y: Array) -> Array:
    """World height of the ground, metres: hills, level around the pond."""
    hills = 1.2 * np.sin(x / 25) * np.cos(y / 30) + 0.02 * x
    west, east, south, north = POND
    off = np.maximum.reduce([west - x, x - east, south - y, y - north, np.zeros_like(x)])
    return np.asarray(hills * np.clip(off / 10, 0, 1))


def height(x: Array, y: Array) -> Array:
    """World height of the surface, metres."""
    z = ground(x, y)
    z = np.where(_inside(x, y, HOUSE), ROOF_M, z)
    for east, north, radius in TREES:
        off = np.hypot(x - east, y - north) / radius
        bumps = 0.8 * np.sin(2.6 * x) * np.sin(2.9 * y)
        crown = CROWN_M * np.sqrt(np.clip(1 - off**2, 0, 1)) + bumps
        z = np.where(off < 0.95, np.maximum(z + 1.0, crown), z)
    return np.asarray(z)


def classes(x: Array, y: Array) -> NDArray[np.uint8]:
    """Labels of the surface."""
    label = np.where(_inside(x, y, YARD), 4, 1)
    label = np.where(_inside(x, y, POND), 8, label)
    label = np.where(_inside(x, y, HOUSE), 16, label)
    for east, north, radius in TREES:
        label = np.where(np.hypot(x - east, y - north) < 0.95 * radius, 17, label)
    return np.asarray(label, np.uint8)


def colour(x: Array, y: Array) -> Array:
    """Colour of the surface, (..., 3) in 0..255, with grain everywhere but on water."""
    label = classes(x, y)
    rgb = np.zeros((*x.shape, 3))
    for value, own in ((1, GREEN), (4, GREY), (8, WATER_RGB), (16, ROOF_RGB), (17, CROWN_RGB)):
        rgb[label == value] = own
    grain = np.sin(5.1 * x + 2 * np.sin(3.3 * y)) * np.sin(4.3 * y + 2 * np.sin(2.7 * x))
    rgb += np.where(label == 8, 1.0, 14.0)[..., None] * grain[..., None]
    return np.clip(rgb, 0, 255)


def rasters(
    folder: Path,
    crs: str = "EPSG:32632",
    half_m: float = HALF_M,
    shaded: Callable[[Array, Array], NDArray[np.bool_]] | None = None,
    hole: tuple[float, float, float, float] | None = None,
    east_m: float = 0.0,
) -> tuple[Path, Path]:
    """Write ``ortho.tif`` and ``dsm.tif`` of a square around the origin.

    Args:
        folder: where to write.
        crs: reference system.
        half_m: half the side of the square.
        shaded: tells which parts of the world are darkened to a third.
        hole: part of the world without data.
        east_m: how far east the orthophoto is moved, with what it shows.
    """
    projection = Projection(crs)
    corners = [np.array([s * half_m, t * half_m, 0.0]) for s in (-1, 1) for t in (-1, 1)]
    ends = np.array([projection.from_geodetic(geodetic_from_enu(c, ORIGIN)) for c in corners])
    left, top = ends[:, 0].min(), ends[:, 1].max()
    width, tall = (round(np.ptp(ends[:, k]) / PIXEL_M) for k in (0, 1))
    east = left + (np.arange(width) + 0.5) * PIXEL_M
    north = top - (np.arange(tall) + 0.5) * PIXEL_M
    x, y = _world(projection, *np.meshgrid(east, north))
    heights = ORIGIN.altitude + height(x, y) + (x**2 + y**2) / (2 * 6.38e6)
    if hole is not None:
        heights[_inside(x, y, hole)] = np.nan
    rgb = colour(x, y)
    if shaded is not None:
        rgb[shaded(x, y)] /= 3
    size = {"driver": "GTiff", "width": width, "height": tall, "crs": crs}
    folder.mkdir(parents=True, exist_ok=True)
    place = from_origin(left, top, PIXEL_M, PIXEL_M)
    with rasterio.open(
        folder / "dsm.tif", "w", count=1, dtype="float32", transform=place, **size
    ) as file:
        file.write(heights.astype(np.float32), 1)
    place = from_origin(left + east_m, top, PIXEL_M, PIXEL_M)
    with rasterio.open(
        folder / "ortho.tif", "w", count=3, dtype="uint8", transform=place, **size
    ) as file:
        file.write(np.rint(rgb).astype(np.uint8).transpose(2, 0, 1))
    return folder / "ortho.tif", folder / "dsm.tif"
