"""From the colours of an orthophoto to the light that the surface reflects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.look.conditions import Condition
from simulate.twin.classes import WATER

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]

# The tone curve of the renderer (AgX, base contrast): display value of grey, and log2 of the value
# in the scene that gives it. Cameras' curves are alike. Rendering applies it again.
_SHOWN = np.linspace(0, 1, 33)
_STOPS = np.array(
    [-10, -7.766, -6.884, -6.198, -5.644, -5.174, -4.768, -4.407, -4.092, -3.806, -3.535, -3.295,
     -3.06, -2.845, -2.631, -2.425, -2.22, -2.006, -1.791, -1.561, -1.328, -1.073, -0.811, -0.524,
     -0.216, 0.116, 0.478, 0.886, 1.341, 1.861, 2.466, 3.17, 4.0]
)  # fmt: skip
# The light that a surface model returns, of what a level plane does: it is rough and shades itself.
_SHADED = 0.81
_DARKEST, _BRIGHTEST = 0.008, 0.85  # albedo of real surfaces
_MOST_GAIN = 5.0  # shadows are brightened by at most this factor
_WALL, _WALL_M = 0.6, 1.0  # less upright normals are walls, whose colours are blurred so far
_SEAM_M = 0.4  # the edge of a shadow is as soft as this
_FEWEST = 200  # cells of a class in the sun and in the shade from which its gain is measured


def reflectance(rgb: Float, shown_in: Condition, mean_albedo: float | None = None) -> Float:
    """Undo a camera's tone curve and exposure.

    Args:
        rgb: colours (n, n, 3) in 0..255.
        shown_in: the condition in which the renderer shows these colours again.
        mean_albedo: the mean albedo of the place, which then decides how bright it is.

    Returns:
        Linear albedo (n, n, 3).
    """
    table = np.exp2(np.interp(np.arange(256) / 255, _SHOWN, _STOPS)).astype(np.float32)
    linear = table[np.clip(np.rint(rgb), 0, 255).astype(np.uint8)]
    share = 1 / _brightness(shown_in) if mean_albedo is None else mean_albedo / linear.mean()
    linear *= np.float32(share)
    return np.clip(linear, _DARKEST, _BRIGHTEST, out=linear)


def _brightness(light: Condition) -> float:
    """Return the exposed value of level, white ground in a condition."""
    sky = light.sky.strength * (sum(light.sky.zenith) + sum(light.sky.horizon)) / 6
    sun = light.sun.watts * np.sin(np.radians(light.sun.elevation)) / np.pi
    return float(_SHADED * 2**light.exposure * (sun + sky))


def even_walls(albedo: Float, upright: Float, cell_m: float) -> Float:
    """Blur the colours (n, n, 3) of walls, of which an orthophoto shows single pixels.

    ``upright`` (n, n) is 1 where the surface is level and 0 on walls.
    """
    wall = np.clip((_WALL - upright) / 0.2, 0, 1)[..., None]
    albedo += wall * (cv2.GaussianBlur(albedo, (0, 0), _WALL_M / cell_m) - albedo)
    return albedo


def soften_shadows(
    albedo: Float, labels: NDArray[np.uint8], lit: Mask, cell_m: float
) -> tuple[Float, float]:
    """Brighten what lay in the shade when the orthophoto was taken, class by class.

    Args:
        albedo: (n, n, 3), changed in place.
        labels: classes (n, n).
        lit: which cells the sun reached, (n, n).
        cell_m: side of a cell, metres.

    Returns:
        The albedo, and the mean factor by which the shade was brightened.
    """
    sigma = _SEAM_M / cell_m
    shade = cv2.GaussianBlur(1 - lit.astype(np.float32), (0, 0), sigma)
    value = albedo.mean(-1)
    gain = np.ones(value.shape, np.float32)
    for label in np.unique(labels).tolist():
        here = labels == label
        sunny, dark = value[here & (shade < 0.05)], value[here & (shade > 0.95)]
        if label == WATER or min(len(sunny), len(dark)) < _FEWEST:
            continue
        gain[here] = np.clip(np.median(sunny) / np.median(dark), 1.0, _MOST_GAIN)
    gain = cv2.GaussianBlur(gain, (0, 0), sigma)
    albedo *= (1 + shade * (gain - 1))[..., None]
    np.clip(albedo, _DARKEST, _BRIGHTEST, out=albedo)
    return albedo, float(gain[shade > 0.5].mean()) if (shade > 0.5).any() else 1.0
