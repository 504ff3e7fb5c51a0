"""Classify a site's surface by colour, height above the ground and roughness."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.errors import InputError

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]
Labels = NDArray[np.uint8]

LOW_VEGETATION, PAVED, WATER, ROOF, CROWN = (
    CLASSES[name] for name in ("grass", "pavement", "water", "building", "tree")
)
NAMES: Final = {
    LOW_VEGETATION: "low vegetation",
    PAVED: "ground",
    WATER: "water",
    ROOF: "roof",
    CROWN: "tree",
}

_HIGH_M = 1.8  # minimum height of buildings and trees above the ground
_GREEN = 0.035  # minimum excess of green, see ``_excess_green``
_SCALE_M = 0.6  # standard deviation of the blur of colours
# Minimum deviation (m) of a crown from a plane if the crown is green, and if it is faintly green
# like dry leaves; and minimum excess of green of a faintly green crown.
_GREEN_ROUGH_M, _FAINT_ROUGH_M, _FAINT = 0.2, 0.5, 0.015
_GRAINY = 0.25  # minimum grain of leaves with their shadows; lawns have 0.1 to 0.15
_LEVEL = 0.06  # maximum slope of water
_DARK = 0.34  # maximum brightness of water, 0 to 1
_CALM = 0.045  # maximum deviation of the brightness of water
_MIN_WATER_M2, _MIN_PATCH_M2 = 120.0, 6.0  # smaller patches are dropped
_NARROWEST_WATER_M = 2.5


def classify(
    rgb: Float, surface: Float, ground: Float, cell_m: float, unknown_height: Mask | None = None
) -> Labels:
    """Classify water, low vegetation, ground, roofs and crowns.

    Where heights are unknown, crowns are recognised by a greenish colour and the grain of leaves.

    Args:
        rgb: colours (n, n, 3) in 0..255.
        surface: heights (n, n), metres.
        ground: heights of the ground (n, n), metres.
        cell_m: side of a cell, metres.
        unknown_height: mask (n, n) of unknown heights.

    Returns:
        Labels (n, n) of ``objconnect.scene.bundle.labels.CLASSES``.
    """
    sigma = max(_SCALE_M / cell_m, 0.6)
    blurred = cv2.GaussianBlur(rgb, (0, 0), sigma) / np.float32(255)
    excess = _excess_green(blurred)
    green = excess > _GREEN
    above_ground = surface - ground
    labels = np.where(green, LOW_VEGETATION, PAVED).astype(np.uint8)
    labels[_water(rgb, blurred, surface, above_ground, cell_m)] = WATER
    high = _drop_small_patches(above_ground > _HIGH_M, _MIN_PATCH_M2, cell_m)
    rough = _roughness(above_ground, high, cell_m)
    leafy = (green & (rough > _GREEN_ROUGH_M)) | ((excess > _FAINT) & (rough > _FAINT_ROUGH_M))
    crown = _majority(leafy, high, cell_m)
    labels[high] = np.where(crown, CROWN, ROOF)[high]
    if unknown_height is not None:
        candidates = unknown_height & ~high & (labels != WATER)
        leaves = _majority((excess > 0) & (_grain(rgb, cell_m) > _GRAINY), candidates, cell_m)
        labels[_drop_small_patches(leaves & candidates, _MIN_PATCH_M2, cell_m)] = CROWN
    return labels


def apply_mask(mask: Labels, classified: Labels) -> Labels:
    """Return the classes of a mask, with ``classified`` where the mask is 0.

    Raises:
        InputError: The mask has other values.
    """
    invalid = set(np.unique(mask).tolist()) - {0, *NAMES}
    if invalid:
        raise InputError(
            f"the mask of classes has the value {min(invalid)}: use 1 (low vegetation), 4 "
            "(ground), 8 (water), 16 (building), 17 (tree), and 0 where unknown"
        )
    return np.where(mask > 0, mask, classified).astype(np.uint8)


def _excess_green(rgb: Float) -> Float:
    """Return the excess of green over the mean of red and blue, relative to their sum, (n, n)."""
    red, green, blue = np.moveaxis(rgb, -1, 0)
    total = np.maximum(red + green + blue, np.float32(0.05))
    return np.asarray((2 * green - red - blue) / total, np.float32)


def _grain(rgb: Float, cell_m: float) -> Float:
    """Return the relative standard deviation of brightness within a metre, (n, n)."""
    value = rgb.mean(-1)
    sigma = 1.0 / cell_m
    mean = cv2.GaussianBlur(value, (0, 0), sigma)
    variance = cv2.GaussianBlur(value * value, (0, 0), sigma) - mean * mean
    return np.asarray(np.sqrt(np.maximum(variance, 0)) / np.maximum(mean, 1))


def _water(rgb: Float, blurred: Float, surface: Float, above_ground: Float, cell_m: float) -> Mask:
    """Return the mask (n, n) of water: dark, bluish, smooth, level and wide."""
    value = rgb.mean(-1) / np.float32(255)
    sigma = 1.5 / cell_m
    mean = cv2.GaussianBlur(value, (0, 0), sigma)
    variance = cv2.GaussianBlur(value * value, (0, 0), sigma) - mean * mean
    calm = np.sqrt(np.maximum(variance, 0)) < _CALM
    smooth = cv2.GaussianBlur(surface, (0, 0), sigma)
    north, east = np.gradient(smooth, cell_m)
    level = (np.hypot(north, east) < _LEVEL) & (np.abs(surface - smooth) < 0.1)
    bluish = blurred[..., 2] > blurred[..., 0] * np.float32(1.06)
    is_waterlike = bluish & (value < _DARK) & (above_ground < 0.5)
    side = 2 * max(1, round(0.5 * _NARROWEST_WATER_M / cell_m)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    sure = (is_waterlike & calm & level & (mean < _DARK)).astype(np.uint8)
    wide = _drop_small_patches(
        cv2.morphologyEx(sure, cv2.MORPH_OPEN, disc) > 0, _MIN_WATER_M2, cell_m
    )
    # Cells near the shore fail the tests for smooth and level water, whose filters cross the shore.
    shore = cv2.dilate(wide.astype(np.uint8), disc, iterations=2)
    return np.asarray(wide | (is_waterlike & (shore > 0)))


def _drop_small_patches(mask: Mask, min_area_m2: float, cell_m: float) -> Mask:
    """Return the mask (n, n) without connected patches that are smaller than ``min_area_m2``."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    keep = stats[:count, cv2.CC_STAT_AREA] * cell_m**2 >= min_area_m2
    keep[0] = False
    return np.asarray(keep[labels])


def _roughness(above_ground: Float, high: Mask, cell_m: float) -> Float:
    """Return the deviation of heights from a local plane, (n, n) metres, 0 outside of ``high``.

    Heights outside ``high`` are ignored, so that the edge of a flat roof is not rough.
    """
    weight = high.astype(np.float32)
    sigma = 1.0 / cell_m

    def mean(values: Float) -> Float:
        total = cv2.GaussianBlur(values * weight, (0, 0), sigma)
        return np.asarray(total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3))

    # At its edges, a sloping roof deviates from the biased mean. Averaging dampens this deviation.
    plane = mean(above_ground)
    return np.asarray(mean(np.abs(above_ground - plane)) * weight)


def _majority(mask: Mask, region: Mask, cell_m: float) -> Mask:
    """Return where most cells of ``region`` within about a metre are in ``mask``, (n, n)."""
    sigma = 1.2 / cell_m
    weight = cv2.GaussianBlur(region.astype(np.float32), (0, 0), sigma)
    share = cv2.GaussianBlur((mask & region).astype(np.float32), (0, 0), sigma)
    return np.asarray(share > 0.5 * weight)
