"""Calibrated cameras in COLMAP's models and pixel convention.

Only the methods that return tensors import torch, so opening a scene does not load it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.colmap_models import convert_model

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from objconnect.scene.geometry.projection import Intrinsics, Projection

# Larger parameters come from a damaged file, and their squares overflow.
_MAX_PARAMETER = 1e9
# Smaller distortion coefficients have no measurable effect.
_MIN_COEFFICIENT = 1e-12
# Perspective models with more coefficients are rational: their distortion has a denominator.
_POLYNOMIAL_COUNT = 4
# Smaller products of coefficients are treated as zero. A root is real if its imaginary part is at
# most this share of its absolute value.
_MIN_PRODUCT, _MAX_IMAGINARY_SHARE = 1e-30, 1e-6

MODELS: Final[dict[str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": (*("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"), "k3", "k4", "k5", "k6"),
}
"""The parameter names of every supported camera model, in COLMAP's order."""


@dataclass(frozen=True)
class Camera:
    """One calibrated camera.

    Attributes:
        model: camera model, a key of ``MODELS``.
        width: image width, pixels.
        height: image height, pixels.
        params: focal lengths and principal point (pixels) and distortion coefficients, in COLMAP's
            order for the model.

    Raises:
        InputError: the model is unknown, the number of parameters is wrong, or a value is invalid.

    Examples:
        >>> camera = Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0))
        >>> camera.focal
        (500.0, 500.0)
        >>> import torch
        >>> camera.project(torch.tensor([[1.0, 0.0, 10.0]])).xy
        tensor([[370., 240.]])
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"unknown camera model {self.model!r}; known: {', '.join(MODELS)}")
        expected = MODELS[self.model]
        if len(self.params) != len(expected):
            raise InputError(
                f"camera model {self.model} takes {len(expected)} parameters "
                f"({' '.join(expected)}), got {len(self.params)}"
            )
        if self.width <= 0 or self.height <= 0:
            raise InputError(f"camera size must be positive, got {self.width} x {self.height}")
        if not all(math.isfinite(p) for p in self.params):
            raise InputError(f"camera parameters must be finite, got {self.params}")
        if max(abs(p) for p in self.params) > _MAX_PARAMETER:
            raise InputError(f"camera parameters are out of range, got {self.params}")
        if min(self.focal) <= 0:
            raise InputError(f"focal length must be positive, got {self.focal}")

    @staticmethod
    def parse(words: Sequence[str]) -> Camera:
        """Parse ``MODEL width height params...``, the form of COLMAP's and hloc's text files.

        Models of ``colmap_models`` are converted to the equal supported model.

        Raises:
            InputError: a word is missing or is not a number, or the model is not supported.

        Examples:
            >>> Camera.parse("SIMPLE_PINHOLE 640 480 500 320 240".split()).principal
            (320.0, 240.0)
        """
        try:
            model, width, height = words[0], int(words[1]), int(words[2])
            params = tuple(float(w) for w in words[3:])
        except (IndexError, ValueError):
            raise InputError(
                f"expected 'MODEL width height params...', got {' '.join(words)!r}"
            ) from None
        model, params = convert_model(model, params)
        return Camera(model, width, height, params)

    def __str__(self) -> str:
        numbers = " ".join(repr(p) for p in self.params)
        return f"{self.model} {self.width} {self.height} {numbers}"

    def _value(self, name: str, default: float = 0.0) -> float:
        names = MODELS[self.model]
        return self.params[names.index(name)] if name in names else default

    @property
    def focal(self) -> tuple[float, float]:
        """Return the focal lengths (fx, fy), pixels."""
        if "f" in MODELS[self.model]:
            return self._value("f"), self._value("f")
        return self._value("fx"), self._value("fy")

    @property
    def principal(self) -> tuple[float, float]:
        """Return the principal point (cx, cy), COLMAP pixels."""
        return self._value("cx"), self._value("cy")

    @property
    def distortion(self) -> tuple[float, ...]:
        """Return (k1, k2, p1, p2), or (k1, k2, k3, k4) for the fisheye model.

        FULL_OPENCV has (k1, k2, p1, p2, k3, k4, k5, k6), in OpenCV's order. Coefficients that the
        model lacks are zero.
        """
        last = ("k3", "k4") if self.is_fisheye else ("p1", "p2")
        more = ("k3", "k4", "k5", "k6") if self.model == "FULL_OPENCV" else ()
        return tuple(self._value(n) for n in ("k1", "k2", *last, *more))

    @property
    def is_fisheye(self) -> bool:
        """Return whether the model is equidistant rather than perspective."""
        return self.model == "OPENCV_FISHEYE"

    @property
    def calibration(self) -> NDArray[np.float64]:
        """Return the calibration matrix K, (3, 3) float64, COLMAP pixels, without distortion."""
        (fx, fy), (cx, cy) = self.focal, self.principal
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)

    def fold_limit(self) -> float:
        """Return the radius x/z, or angle (rad) of a fisheye, where the distortion folds over.

        The distorted radius stops growing there; points beyond it would be projected back into the
        image. The limit is infinite (for the fisheye: a right angle) if the radius always grows. A
        rational distortion also ends where its denominator vanishes.
        """
        return _fold_limit(self.is_fisheye, self.distortion)

    def intrinsics(
        self, dtype: torch.dtype | None = None, device: torch.device | None = None
    ) -> Intrinsics:
        """Return the camera as tensors for batched projection; ``dtype`` is float64 by default."""
        import torch

        from objconnect.scene.geometry.projection import Intrinsics

        def tensor(values: object) -> Tensor:
            return torch.tensor(values, dtype=dtype or torch.float64, device=device)

        return Intrinsics(
            fisheye=self.is_fisheye,
            focal=tensor(self.focal),
            principal=tensor(self.principal),
            distortion=tensor(self.distortion),
            limit=tensor(self.fold_limit()),
        )

    def project(self, points: Tensor, jacobian: bool = False) -> Projection:
        """Project points (..., N, 3) of the camera frame; see ``Intrinsics.project``."""
        return self.intrinsics(points.dtype, points.device).project(points, jacobian)

    def unproject(self, xy: Tensor) -> tuple[Tensor, Tensor]:
        """Return the rays with z = 1 through pixels (..., N, 2); see ``Intrinsics.unproject``."""
        return self.intrinsics(xy.dtype, xy.device).unproject(xy)

    def contains(self, xy: Tensor, border: float = 0.0) -> Tensor:
        """Return whether pixels (..., 2) lie in the image, at least ``border`` from its edge."""
        x, y = xy[..., 0], xy[..., 1]
        return (
            (x >= border) & (x <= self.width - border) & (y >= border) & (y <= self.height - border)
        )

    def pixel_grid(self, dtype: torch.dtype | None = None) -> Tensor:
        """Return the pixel centres, (H, W, 2), x before y; ``dtype`` is float64 by default."""
        import torch

        dtype = dtype or torch.float64
        x = torch.arange(self.width, dtype=dtype) + 0.5
        y = torch.arange(self.height, dtype=dtype) + 0.5
        return torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)

    def resize(self, width: int, height: int) -> Camera:
        """Return the camera of the same image resized to ``width`` x ``height`` pixels.

        Raises:
            InputError: the model has one focal length and cannot hold two different scales.

        Examples:
            >>> camera = Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0))
            >>> str(camera.resize(320, 240))
            'PINHOLE 320 240 250.0 250.0 160.0 120.0'
        """
        sx, sy = width / self.width, height / self.height
        if "f" in MODELS[self.model] and not math.isclose(sx, sy, rel_tol=1e-3):
            raise InputError(
                f"{self.model} has one focal length and cannot be resized from "
                f"{self.width} x {self.height} to {width} x {height}"
            )
        scale = {"f": sx, "fx": sx, "cx": sx, "fy": sy, "cy": sy}
        names = MODELS[self.model]
        params = tuple(p * scale.get(n, 1.0) for n, p in zip(names, self.params, strict=True))
        return Camera(self.model, width, height, params)

    def crop(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera of a crop whose top left corner is at pixel (``left``, ``top``).

        Examples:
            >>> camera = Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0))
            >>> str(camera.crop(20, 40, 600, 400))
            'PINHOLE 600 400 500.0 500.0 300.0 200.0'
        """
        shift = {"cx": left, "cy": top}
        names = MODELS[self.model]
        params = tuple(p - shift.get(n, 0) for n, p in zip(names, self.params, strict=True))
        return Camera(self.model, width, height, params)


@lru_cache(maxsize=1024)
def _fold_limit(fisheye: bool, distortion: tuple[float, ...]) -> float:
    """Return ``Camera.fold_limit``, cached because every projection needs it."""
    if len(distortion) > _POLYNOMIAL_COUNT:
        return _rational_limit(distortion)
    k1, k2, k3, k4 = distortion
    if fisheye:
        slope, unbounded = [9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0], math.pi / 2
    else:
        slope, unbounded = [5 * k2, 3 * k1, 1.0], math.inf
    while abs(slope[0]) < _MIN_COEFFICIENT:
        slope = slope[1:]
    roots = np.roots(slope)
    squares = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and r.real > 0]
    return min([unbounded, *(math.sqrt(s) for s in squares)])


def _rational_limit(distortion: tuple[float, ...]) -> float:
    """Return the radius at which a rational distortion folds over or its denominator vanishes."""
    k1, k2, _, _, k3, k4, k5, k6 = distortion
    numerator, denominator = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    # The derivative of r * numerator / denominator times the squared denominator, a polynomial in
    # r^2.
    derivative = numerator.deriv() * denominator - numerator * denominator.deriv()
    slope = numerator * denominator + 2 * np.poly1d([1.0, 0.0]) * derivative
    limits = [math.inf]
    for polynomial in (slope.coeffs, denominator.coeffs):
        roots = np.roots(polynomial[np.argmax(np.abs(polynomial) > _MIN_PRODUCT) :])
        limits += [
            math.sqrt(r.real)
            for r in roots
            if r.real > 0 and abs(r.imag) <= _MAX_IMAGINARY_SHARE * abs(r)
        ]
    return min(limits)
