"""Estimate the albedo of a site from the colours of its orthophoto."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.look.conditions import Condition
from simulate.twin.classes import WATER

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Tone curve of the renderer (AgX, base contrast): display values of grey, and log2 of the scene
# values that give them. Cameras have similar curves. Rendering applies the curve again.
_DISPLAY_VALUES = np.linspace(0, 1, 33)
_STOPS = np.array(
    [-10, -7.766, -6.884, -6.198, -5.644, -5.174, -4.768, -4.407, -4.092, -3.806, -3.535, -3.295,
     -3.06, -2.845, -2.631, -2.425, -2.22, -2.006, -1.791, -1.561, -1.328, -1.073, -0.811, -0.524,
     -0.216, 0.116, 0.478, 0.886, 1.341, 1.861, 2.466, 3.17, 4.0]
)  # fmt: skip
# Light that a rough surface model reflects, relative to a level plane. It is less than 1, because
# rough surfaces shade a part of themselves.
_SELF_SHADING = 0.81
_DARKEST, _BRIGHTEST = 0.008, 0.85  # limits of the albedo of real surfaces
_MAX_GAIN = 5.0  # upper bound of the brightening of shadows
_WALL_LEVELNESS, _WALL_BLUR_M = 0.6, 1.0  # maximum levelness of a wall, and blur of its colours (m)
_TRANSITION_M = 0.4  # width of the transition at the edge of a shadow
_MIN_CELLS = 200  # minimum number of sunny and of shaded cells of a class to measure its gain


def estimate_albedo(rgb: Float, condition: Condition, mean_albedo: float | None = None) -> Float:
    """Invert a camera's tone curve and exposure.

    Args:
        rgb: colours (n, n, 3) in 0..255.
        condition: condition under which rendering reproduces these colours.
        mean_albedo: mean albedo of the site, which overrides the exposure.

    Returns:
        Linear albedo (n, n, 3).
    """
    table = np.exp2(np.interp(np.arange(256) / 255, _DISPLAY_VALUES, _STOPS)).astype(np.float32)
    linear = table[np.clip(np.rint(rgb), 0, 255).astype(np.uint8)]
    scale = 1 / _brightness(condition) if mean_albedo is None else mean_albedo / linear.mean()
    linear *= np.float32(scale)
    return np.clip(linear, _DARKEST, _BRIGHTEST, out=linear)


def _brightness(condition: Condition) -> float:
    """Return the linear value of level white ground after exposure, under a condition."""
    sky = condition.sky.strength * (sum(condition.sky.zenith) + sum(condition.sky.horizon)) / 6
    sun = condition.sun.watts * np.sin(np.radians(condition.sun.elevation)) / np.pi
    return float(_SELF_SHADING * 2**condition.exposure * (sun + sky))


def blur_walls(albedo: Float, levelness: Float, cell_m: float) -> Float:
    """Blur the colours (n, n, 3) of walls, which cover few pixels of an orthophoto.

    ``levelness`` (n, n) is 1 where the surface is level and 0 on walls.
    """
    wall = np.clip((_WALL_LEVELNESS - levelness) / 0.2, 0, 1)[..., None]
    albedo += wall * (cv2.GaussianBlur(albedo, (0, 0), _WALL_BLUR_M / cell_m) - albedo)
    return albedo


def soften_shadows(
    albedo: Float, labels: NDArray[np.uint8], lit: Mask, cell_m: float
) -> tuple[Float, float]:
    """Brighten the shadows of an orthophoto, class by class.

    Args:
        albedo: (n, n, 3), changed in place.
        labels: classes (n, n).
        lit: mask (n, n) of sunlit cells.
        cell_m: side of a cell, metres.

    Returns:
        The albedo, and the mean gain of shadows.
    """
    sigma = _TRANSITION_M / cell_m
    shade = cv2.GaussianBlur(1 - lit.astype(np.float32), (0, 0), sigma)
    value = albedo.mean(-1)
    gain = np.ones(value.shape, np.float32)
    for label in np.unique(labels).tolist():
        of_class = labels == label
        sunny, dark = value[of_class & (shade < 0.05)], value[of_class & (shade > 0.95)]
        if label == WATER or min(len(sunny), len(dark)) < _MIN_CELLS:
            continue
        gain[of_class] = np.clip(np.median(sunny) / np.median(dark), 1.0, _MAX_GAIN)
    gain = cv2.GaussianBlur(gain, (0, 0), sigma)
    albedo *= (1 + shade * (gain - 1))[..., None]
    np.clip(albedo, _DARKEST, _BRIGHTEST, out=albedo)
    return albedo, float(gain[shade > 0.5].mean()) if (shade > 0.5).any() else 1.0
