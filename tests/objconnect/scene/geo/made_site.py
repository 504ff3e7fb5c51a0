"""A made place on earth: hills with a house, and its orthophoto and surface model in any grid.

Heights and colours are functions of the world's east and north, so that what is read from files can
be compared with numbers that no file went through. The files are written by rasterio alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu

Array = NDArray[np.float64]

ORIGIN = Geodetic(47.0, 8.0, 450.0)
ROOF_M = 6.0
HOUSE = (4.0, 12.0, -6.0, 2.0)  # west, east, south, north
_WAVES = np.random.default_rng(3)
_PHASE = _WAVES.uniform(0, 2 * np.pi, (3, 16))
_TURN = _WAVES.uniform(0, np.pi, (3, 16))
_LENGTH = np.geomspace(0.6, 12.0, 16)


def height(x: Array, y: Array) -> Array:
    """World height of the surface, metres."""
    hills = 1.5 * np.sin(x / 17) * np.cos(y / 13) + 0.03 * x
    west, east, south, north = HOUSE
    inside = (x > west) & (x < east) & (y > south) & (y < north)
    return np.where(inside, ROOF_M, hills)


def colour(x: Array, y: Array) -> Array:
    """Colour of the surface, (..., 3) in 0..255: waves of many lengths, none shorter than 0.6 m."""
    found = []
    for phase, turn in zip(_PHASE, _TURN, strict=True):
        along = x[..., None] * np.cos(turn) + y[..., None] * np.sin(turn)
        waves = np.sin(2 * np.pi * along / _LENGTH + phase) * np.sqrt(_LENGTH)
        found.append(127 + 127 * np.tanh(waves.sum(-1) / 8))
    return np.stack(found, -1)


def cast(camera: Camera, cam_from_world: Array) -> tuple[Array, Array]:
    """The surface that the pixels of a camera see.

    Returns:
        Planar depth (H, W) and world points (H, W, 3), by steps of 0.3 m, then bisections.
    """
    rays = camera.unproject(camera.pixel_grid())[0].numpy() @ cam_from_world[:3, :3]
    start = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]

    def clear(depth: Array) -> Array:
        at = start + depth[..., None] * rays
        return np.asarray(at[..., 2] - height(at[..., 0], at[..., 1]))

    depth = np.full(rays.shape[:2], start[2] - ROOF_M - 3)
    while (above := clear(depth) > 0).any():
        depth = depth + 0.3 * above
    low, high = depth - 0.3, depth
    for _ in range(20):
        middle = (low + high) / 2
        below = clear(middle) <= 0
        low, high = np.where(below, low, middle), np.where(below, middle, high)
    return high, start + high[..., None] * rays


def down_from(east: float, north: float, up: float, tilt_deg: float = 0.0) -> Array:
    """``cam_from_world`` of a camera whose top is north, tilted to the north."""
    tilt = np.deg2rad(tilt_deg)
    rotation = np.array(
        [
            [1, 0, 0],
            [0, -np.cos(tilt), -np.sin(tilt)],
            [0, np.sin(tilt), -np.cos(tilt)],
        ]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.array([east, north, up])
    return pose


def rasters(folder: Path, crs: str, pixel: float = 0.1, half: float = 20.0) -> tuple[Path, Path]:
    """Write ``ortho.tif`` and ``dsm.tif`` of the square of side ``2 * half`` around the origin."""
    projection = Projection(crs)
    corners = [np.array([s * half, t * half, 0.0]) for s in (-1, 1) for t in (-1, 1)]
    ends = np.array([projection.from_geodetic(geodetic_from_enu(c, ORIGIN)) for c in corners])
    left, top = ends[:, 0].min(), ends[:, 1].max()
    width, tall = (round(np.ptp(ends[:, k]) / pixel) for k in (0, 1))
    east = left + (np.arange(width) + 0.5) * pixel
    north = top - (np.arange(tall) + 0.5) * pixel
    # Over so small a place the way to the world is a plane and its bend: degree 3 leaves microns.
    x, y = _world(projection, *np.meshgrid(east, north))
    z = height(x, y)
    # The height above the ellipsoid; the ground of the world bends away from its plane.
    heights = ORIGIN.altitude + z + (x**2 + y**2) / (2 * 6.38e6)
    place = {"crs": crs, "transform": from_origin(left, top, pixel, pixel)}
    size = {"driver": "GTiff", "width": width, "height": tall}
    folder.mkdir(parents=True, exist_ok=True)
    with rasterio.open(folder / "dsm.tif", "w", count=1, dtype="float32", **size, **place) as file:
        file.write(heights.astype(np.float32), 1)
    with rasterio.open(folder / "ortho.tif", "w", count=3, dtype="uint8", **size, **place) as file:
        file.write(np.rint(colour(x, y)).astype(np.uint8).transpose(2, 0, 1))
    return folder / "ortho.tif", folder / "dsm.tif"


def _world(projection: Projection, east: Array, north: Array) -> tuple[Array, Array]:
    """World east and north of coordinates on the ground, through a fit to exact points."""
    low, high = np.array([east.min(), north.min()]), np.array([east.max(), north.max()])
    nodes = np.linspace(-1, 1, 6)
    u, v = (a.ravel() for a in np.meshgrid(nodes, nodes))
    at = low + (np.stack([u, v], -1) + 1) / 2 * (high - low)
    places = [projection.to_geodetic(np.array([*p, ORIGIN.altitude])) for p in at]
    exact = np.array([enu_from_geodetic(place, ORIGIN)[:2] for place in places])
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    fit = np.linalg.lstsq(np.stack([u**i * v**j for i, j in powers], -1), exact, rcond=None)[0]
    s = 2 * (east - low[0]) / (high[0] - low[0]) - 1
    t = 2 * (north - low[1]) / (high[1] - low[1]) - 1
    x, y = (
        sum(c * s**i * t**j for c, (i, j) in zip(fit[:, k], powers, strict=True)) for k in (0, 1)
    )
    return np.asarray(x), np.asarray(y)
