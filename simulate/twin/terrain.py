"""The surface of a site: holes closed, and the ground below what stands on it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Widths (m) of the openings of the progressive morphological filter (Zhang et al., 2003).
_WINDOWS_M = (3.0, 5.0, 9.0, 17.0, 33.0, 49.0)
_STEP_M = 0.4  # what stands out by less, at the smallest window, is ground
_SLOPE = 0.15  # ground rises by at most this much per metre of a window
_HIGHEST_STEP_M = 2.5
_CELL_M = 1.0  # the filter works on cells of this size
_SMOOTH_M = 2.0  # standard deviation of the filter over the ground that is found


def close_holes(values: Float, spacing_m: float, smooth_m: float = 1.0) -> tuple[Float, Mask]:
    """Give each cell without data the value of the nearest one, smoothed inside the hole.

    Args:
        values: (n, n) or (n, n, bands), NaN where nothing is known.
        spacing_m: side of a cell, metres.
        smooth_m: standard deviation of the smoothing, metres.

    Returns:
        The closed values, and the mask (n, n) of the cells that were empty.
    """
    flat = values if values.ndim == 2 else values.sum(-1)
    hole = ~np.isfinite(flat)
    if not hole.any() or hole.all():
        return values, hole
    _, nearest = cv2.distanceTransformWithLabels(
        hole.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(~hole)
    index = np.zeros(int(nearest.max()) + 1, np.int64)
    index[nearest[rows, columns]] = np.arange(len(rows))
    source = index[nearest[hole]]
    closed = values.copy()
    closed[hole] = values[rows[source], columns[source]]
    soft = cv2.GaussianBlur(closed, (0, 0), max(smooth_m / spacing_m, 0.5))
    closed[hole] = soft[hole]
    return closed, hole


def ground_below(surface: Float, spacing_m: float) -> Float:
    """Estimate the ground under buildings and trees by a progressive morphological filter.

    Args:
        surface: heights (n, n) without holes, metres.
        spacing_m: distance between them, metres.

    Returns:
        Heights (n, n) of the ground, nowhere above the surface.
    """
    n = len(surface)
    m = max(8, round(n * spacing_m / _CELL_M))
    cell = n * spacing_m / m
    small = cv2.resize(surface, (m, m), interpolation=cv2.INTER_AREA) if m < n else surface
    cell = cell if m < n else spacing_m
    stands = np.zeros(small.shape, bool)
    before, filtered = 0.0, small
    for width in _WINDOWS_M:
        side = 2 * max(1, round(0.5 * width / cell)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        opened = cv2.morphologyEx(filtered, cv2.MORPH_OPEN, disc, borderType=cv2.BORDER_REPLICATE)
        allowed = min(_STEP_M + _SLOPE * (width - before), _HIGHEST_STEP_M)
        stands |= filtered - opened > (allowed if before else _STEP_M)
        before, filtered = width, opened
    ground, _ = close_holes(np.where(stands, np.float32(np.nan), small), cell, _SMOOTH_M)
    ground = cv2.GaussianBlur(ground, (0, 0), _SMOOTH_M / cell)
    full = cv2.resize(ground, (n, n), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.minimum(full, surface))


def steepness(surface: Float, spacing_m: float) -> Float:
    """Return how upright the normals of a surface (n, n) are: 1 where it is level, 0 on walls."""
    north, east = np.gradient(surface, spacing_m)
    return np.asarray(1 / np.sqrt(1 + north**2 + east**2), np.float32)


def sunlit(surface: Float, spacing_m: float, azimuth: float, elevation: float) -> Mask:
    """Return which cells the sun reaches, (n, n); ``azimuth`` and ``elevation`` in degrees."""
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
        # Half a cell of height lets a slope not shade itself.
        lit &= towards <= surface + np.float32(k * spacing_m * rise + 0.1)
    return lit
