"""From the colours of an orthophoto to the light that the surface reflects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.twin.classes import WATER

Float = NDArray[np.float32]
Mask = NDArray[np.bool_]

# The tone curve of the renderer (AgX, base contrast): display value of grey, and log2 of the scene's
# value that gives it. Cameras' curves are alike. Rendering applies it again.
_SHOWN = np.linspace(0, 1, 33)
_STOPS = np.array(
    [-10, -7.766, -6.884, -6.198, -5.644, -5.174, -4.768, -4.407, -4.092, -3.806, -3.535, -3.295,
     -3.06, -2.845, -2.631, -2.425, -2.22, -2.006, -1.791, -1.561, -1.328, -1.073, -0.811, -0.524,
     -0.216, 0.116, 0.478, 0.886, 1.341, 1.861, 2.466, 3.17, 4.0]
)  # fmt: skip
_DARKEST, _BRIGHTEST = 0.008, 0.85  # albedo of real surfaces
_MOST_GAIN = 5.0  # shadows are brightened by at most this factor
_SEAM_M = 0.4  # the edge of a shadow is as soft as this
_FEWEST = 200  # cells of a class in the sun and in the shade from which its gain is measured


def reflectance(rgb: Float, mean_albedo: float) -> Float:
    """Undo a camera's tone curve and exposure.

    Args:
        rgb: colours (n, n, 3) in 0..255.
        mean_albedo: the mean albedo of the place.

    Returns:
        Linear albedo (n, n, 3).
    """
    table = np.exp2(np.interp(np.arange(256) / 255, _SHOWN, _STOPS)).astype(np.float32)
    linear = table[np.clip(np.rint(rgb), 0, 255).astype(np.uint8)]
    linear *= np.float32(mean_albedo / float(linear.mean()))
    return np.clip(linear, _DARKEST, _BRIGHTEST, out=linear)


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
