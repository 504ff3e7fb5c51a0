"""Interpolate missing heights of a site, and estimate the ground below buildings and trees."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Widths (m) of the openings of the progressive morphological filter (Zhang et al., 2003).
_WINDOWS_M = (3.0, 5.0, 9.0, 17.0, 33.0, 49.0)
_STEP_M = 0.4  # minimum height of objects at the smallest window
_SLOPE = 0.15  # maximum slope of the ground
_HIGHEST_STEP_M = 2.5  # upper bound of the minimum height of objects at larger windows
_CELL_M = 1.0  # the filter works on cells of this size
# Standard deviations (m) of the filters over closed holes. The first filter smooths a whole hole.
# Each wider filter starts ``_DEPTH_SIGMAS`` standard deviations inside a hole, and has full weight
# at twice that depth.
_SMOOTH_M = (1.0, 2.0, 4.0, 8.0, 16.0)
_DEPTH_SIGMAS = 2.0
_GROUND_M = 2.0  # standard deviation of the filter over the ground
_MAX_SIGMA_CELLS = 4.0  # maximum standard deviation in cells; wider filters work on larger cells
_ISLAND_M2 = 10.0  # smaller patches of heights in a hole are dropped


def drop_islands(surface: Float, spacing_m: float) -> Float:
    """Drop small patches of heights (n, n) in large holes, because such heights are mostly wrong.

    Where dense depth fails, in woods and on water, the remaining depths agree by chance.
    """
    known = np.isfinite(surface).astype(np.uint8)
    _, patch, stats, _ = cv2.connectedComponentsWithStats(known, connectivity=8)
    is_small = stats[:, cv2.CC_STAT_AREA] * spacing_m**2 < _ISLAND_M2
    return np.where(is_small[patch], np.float32(np.nan), surface)


def close_holes(values: Float, spacing_m: float) -> tuple[Float, Mask]:
    """Fill cells without data from the nearest values, smoothed more strongly deeper in a hole.

    Args:
        values: (n, n) or (n, n, bands), NaN where nothing is known.
        spacing_m: side of a cell, metres.

    Returns:
        The closed values, and the mask (n, n) of the empty cells.
    """
    flat = values if values.ndim == 2 else values.sum(-1)
    hole = ~np.isfinite(flat)
    if not hole.any() or hole.all():
        return values, hole
    depth, nearest = cv2.distanceTransformWithLabels(
        hole.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(~hole)
    index = np.zeros(int(nearest.max()) + 1, np.int64)
    index[nearest[rows, columns]] = np.arange(len(rows))
    source = index[nearest[hole]]
    closed = values.copy()
    closed[hole] = values[rows[source], columns[source]]
    # Nearest values of two edges meet in a step deep in the hole, which the filters smooth.
    share = hole.astype(np.float32)
    for smooth_m in _SMOOTH_M:
        sigma = max(smooth_m / spacing_m, 0.5)
        if smooth_m > _SMOOTH_M[0]:
            share = np.clip(depth / (_DEPTH_SIGMAS * sigma) - 1, 0, 1)
        if not share.any():
            break
        weight = share if closed.ndim == 2 else share[..., None]
        closed = closed + weight * (_blur(closed, sigma) - closed)
    return closed, hole


def _blur(values: Float, sigma: float) -> Float:
    """Smooth a grid. Wide filters work on a coarser grid, which is faster."""
    n = len(values)
    m = min(n, max(4, round(n * _MAX_SIGMA_CELLS / sigma)))
    coarse = cv2.resize(values, (m, m), interpolation=cv2.INTER_AREA) if m < n else values
    soft = cv2.GaussianBlur(coarse, (0, 0), sigma * m / n)
    return np.asarray(cv2.resize(soft, (n, n)) if m < n else soft, np.float32)


def estimate_ground(surface: Float, spacing_m: float) -> Float:
    """Estimate the ground under buildings and trees by a progressive morphological filter.

    Args:
        surface: heights (n, n) without holes, metres.
        spacing_m: distance between neighbouring heights, metres.

    Returns:
        Heights (n, n) of the ground, nowhere above the surface.
    """
    n = len(surface)
    m = max(8, round(n * spacing_m / _CELL_M))
    cell = n * spacing_m / m
    coarse = cv2.resize(surface, (m, m), interpolation=cv2.INTER_AREA) if m < n else surface
    cell = cell if m < n else spacing_m
    is_object = np.zeros(coarse.shape, bool)
    previous_m, filtered = 0.0, coarse
    for width in _WINDOWS_M:
        side = 2 * max(1, round(0.5 * width / cell)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        opened = cv2.morphologyEx(filtered, cv2.MORPH_OPEN, disc, borderType=cv2.BORDER_REPLICATE)
        allowed = min(_STEP_M + _SLOPE * (width - previous_m), _HIGHEST_STEP_M)
        is_object |= filtered - opened > (allowed if previous_m else _STEP_M)
        previous_m, filtered = width, opened
    ground, _ = close_holes(np.where(is_object, np.float32(np.nan), coarse), cell)
    ground = cv2.GaussianBlur(ground, (0, 0), _GROUND_M / cell)
    full = cv2.resize(ground, (n, n), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.minimum(full, surface))


def levelness(surface: Float, spacing_m: float) -> Float:
    """Return the vertical component of a surface's unit normals (n, n): 1 if level, 0 on walls."""
    north, east = np.gradient(surface, spacing_m)
    return np.asarray(1 / np.sqrt(1 + north**2 + east**2), np.float32)


def find_sunlit(surface: Float, spacing_m: float, azimuth: float, elevation: float) -> Mask:
    """Return the mask (n, n) of sunlit cells; ``azimuth`` and ``elevation`` in degrees."""
    rise = np.tan(np.radians(max(elevation, 1.0)))
    east, north = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    tallest = float(surface.max() - surface.min())
    steps = min(int(np.ceil(tallest / rise / spacing_m)), len(surface))
    lit = np.ones(surface.shape, bool)
    for k in range(1, steps + 1):
        shift = np.array([[1, 0, -k * east], [0, 1, -k * north]], np.float32)
        towards = cv2.warpAffine(
            surface, shift, surface.shape[::-1], borderMode=cv2.BORDER_REPLICATE
        )
        # The margin of 0.1 m keeps slopes from shading themselves.
        lit &= towards <= surface + np.float32(k * spacing_m * rise + 0.1)
    return lit
