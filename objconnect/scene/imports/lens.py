"""Conversion of other programs' lenses to cameras of this project.

Photogrammetry programs describe a lens by up to four radial coefficients and skew. With two
coefficients it is COLMAP's OPENCV model, with three the FULL_OPENCV model with k4 to k6 zero. With
four, or with skew, the nearest FULL_OPENCV camera is fitted; a lens that it cannot approximate is
refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera

MAX_FIT_ERROR: Final = 1e-3
"""Largest error of the camera fitted to a lens, as a share of the picture's longer side."""

LONGEST_FOCAL: Final = 100.0
"""Largest plausible focal length, in units of the picture's longer side."""

LARGEST_SIDE: Final = 1_000_000
"""Largest plausible width and height of a picture (pixels)."""

# Rays of the fit: directions around the axis, and steps from the axis to the corner.
_DIRECTIONS, _STEPS = 48, 60
# Iterations of Lawson's method, which reweights least squares to minimize the maximum error.
_ROUNDS = 20


def require_inside(
    principal: tuple[float, float], size: tuple[int, int], names: tuple[str, str]
) -> None:
    """Refuse a principal point outside the picture, which indicates another origin or unit.

    Args:
        principal: (cx, cy), COLMAP pixels.
        size: width and height, pixels.
        names: names of the two fields, for the message.

    Raises:
        InputError: the principal point is outside.
    """
    for pixel, side, name in zip(principal, size, names, strict=True):
        if not 0 <= pixel <= side:
            raise InputError(
                f"{name} puts the principal point at {pixel:.0f} of {side} pixels, outside the "
                "picture: it is counted from another point or in another unit"
            )


@dataclass(frozen=True)
class BrownLens:
    """A lens of the Brown model with OpenCV's order and signs of coefficients.

    A point (x, y) = (X/Z, Y/Z) of radius r is at x (1 + k1 r^2 + ... + k4 r^8) + 2 p1 x y +
    p2 (r^2 + 2 x^2), and y likewise with p1 and p2 exchanged, then multiplied by the focal lengths.

    Attributes:
        size: width and height, pixels.
        focal: (fx, fy), pixels.
        principal: (cx, cy), COLMAP pixels.
        radial: (k1, k2, k3, k4).
        tangential: (p1, p2).
        skew: pixels of x per unit of y.
    """

    size: tuple[int, int]
    focal: tuple[float, float]
    principal: tuple[float, float]
    radial: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0

    def camera(self) -> Camera:
        """Return the equivalent OPENCV or FULL_OPENCV camera, or the nearest one.

        Raises:
            InputError: the parameters are invalid, or no camera is within ``MAX_FIT_ERROR``.
        """
        k1, k2, k3, k4 = self.radial
        exact = self._make_camera((*self.focal, *self.principal, k1, k2, *self.tangential, k3))
        if not (k4 or self.skew):
            return exact
        extra = (k4, self.skew)
        if not np.isfinite(extra).all() or np.abs(extra).max() > 1e9:
            raise InputError("the coefficient k4 or the skew is out of range")
        return self._fit()

    def _make_camera(self, params: Sequence[float]) -> Camera:
        """Return the camera of fx, fy, cx, cy, k1, k2, p1, p2 and k3."""
        *opencv, k3 = params
        if k3 == 0:
            return Camera("OPENCV", *self.size, tuple(opencv))
        return Camera("FULL_OPENCV", *self.size, (*opencv, k3, 0.0, 0.0, 0.0))

    def project(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pixels (N, 2) of rays (x, y, 1), each (N,)."""
        r2, (p1, p2) = x * x + y * y, self.tangential
        k1, k2, k3, k4 = self.radial
        stretch = 1 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
        u = x * stretch + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * stretch + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
        (fx, fy), (cx, cy) = self.focal, self.principal
        return np.stack([fx * u + self.skew * v + cx, fy * v + cy], -1)

    def _rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays (x, y), each (N,), inside the picture and the fold-over limit."""
        angle = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)[:, None]
        reach = 2 * np.hypot(self.size[0] / self.focal[0], self.size[1] / self.focal[1])
        radius = np.linspace(0, reach, 4 * _STEPS)[None, :]
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        xy = self.project(x.ravel(), y.ravel()).reshape(*x.shape, 2)
        inside = ((xy >= 0) & (xy <= np.array(self.size))).all(-1)
        distance = np.linalg.norm(xy - np.array(self.principal), axis=-1)
        inside[:, 1:] &= np.diff(distance, axis=1) > 0
        valid = np.logical_and.accumulate(inside, axis=1)
        return x[valid], y[valid]

    def _fit(self) -> Camera:
        """Fit focal length and five coefficients by least squares over the picture."""
        with np.errstate(over="ignore", invalid="ignore"):
            x, y = self._rays()
        r2, ratio = x * x + y * y, self.focal[1] / self.focal[0]
        if len(x) < _STEPS:
            raise InputError(
                "the distortion folds back within the picture: its coefficients are wrong"
            )
        along_x = np.stack([x, x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], -1)
        along_y = np.stack([y, y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], -1)
        rows = np.concatenate([along_x, along_y])
        # Focal length times each coefficient is linear in the pixels.
        pixels = ((self.project(x, y) - np.array(self.principal)) / [1.0, ratio]).T.ravel()
        weight = np.ones(len(x))
        for _ in range(_ROUNDS):
            root = np.sqrt(np.tile(weight, 2))
            solution = np.linalg.lstsq(rows * root[:, None], pixels * root, rcond=None)[0]
            errors = np.linalg.norm((rows @ solution - pixels).reshape(2, -1), axis=0)
            if not errors.any():
                break
            weight *= errors / (weight @ errors)
        f, *scaled_coefficients = solution.tolist()
        max_error = float(errors.max()) / max(self.size)
        if not (max_error <= MAX_FIT_ERROR and f > 0):
            raise InputError(
                f"the lens is {max_error * max(self.size):.1f} px from the nearest FULL_OPENCV "
                "camera: undistort the photographs, or calibrate without skew and with fewer "
                "coefficients"
            )
        return self._make_camera(
            (f, f * ratio, *self.principal, *(value / f for value in scaled_coefficients))
        )
