"""The residual of registration between two orthophotos, measured on windows of the ground.

A season changes colours and reverses contrasts, but edges stay. Each window is described by its
gradients. Their angles are doubled, so that the sign of the contrast has no effect, and their
lengths are divided by the mean length nearby. The offset of a window is the maximum of the
correlation of both dates, whose spectrum is partly whitened: orientation correlation (Fitch et al.,
BMVC 2002) and phase correlation combined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.virtual.surface import sample_colours
from objconnect.scene.errors import InputError
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.runtime.progress import progress_bar

Array = NDArray[np.float64]

# Smallest and largest side (px) of windows, and their maximum number along an axis. Neighbours
# overlap by half at most; in a large area they lie apart.
_MIN_SIDE: Final = 64
_MAX_SIDE: Final = 128
_MAX_WINDOWS: Final = 8
# Windows keep this distance (px) from the border of the area. Windows with a larger share of pixels
# without data are left out. Outermost pixels may have no data; the taper suppresses them.
_RIM_PX: Final = 4
_MAX_UNKNOWN: Final = 0.05
# Sigmas (px) of the Gaussian before the gradient and of the mean that normalizes it, and the
# response of the gradient's filter (grey levels) below which it is noise. A window without a larger
# response has no edges.
_GRADIENT_PX: Final = 1.0
_NEARBY_PX: Final = 12.0
_NOISE_LEVEL: Final = 2.0
# Power of the spectrum's amplitude that is divided out; 1 is phase correlation.
_WHITENING: Final = 0.5
# Offsets are searched up to this share of a window.
_REACH: Final = 0.25
# An offset is clear if its correlation exceeds this many times the largest correlation at offsets
# that differ from it by more than ``_PEAK_PX`` (px) in either axis.
_MIN_PEAK_RATIO: Final = 1.25
_PEAK_PX: Final = 3
# Windows agree if their offsets differ from the median by less (px). The registration
# is known if at least this many windows agree, and this share of the windows with a clear offset.
_AGREE_PX: Final = 6.0
_MIN_AGREEING: Final = 5
_MIN_AGREEING_SHARE: Final = 0.6
_PERCENTILE: Final = 90


class Area(NamedTuple):
    """A rectangle of the ground: south-west and north-east ends (2,), world metres."""

    low: Array
    high: Array


@dataclass(frozen=True)
class Registration:
    """The offset between two orthophotos, measured on windows of the ground.

    Attributes:
        pixel_m: pixel in which offsets are measured, metres.
        windows: number of windows with data in both orthophotos.
        clear: number of windows with edges and a clear offset.
        agreeing: number of clear windows that agree.
        offset_m: median offset of the second orthophoto to the east and north, metres; None if too
            few windows agree.
        median_m: median residual of agreeing windows after the median offset, metres; None
            likewise.
        largest_m: residual that 90 % of the agreeing windows do not exceed, metres; None likewise.
    """

    pixel_m: float
    windows: int
    clear: int = 0
    agreeing: int = 0
    offset_m: tuple[float, float] | None = None
    median_m: float | None = None
    largest_m: float | None = None

    def text(self) -> str:
        """Return the statistics in one line."""
        counts = f"{self.agreeing} of {self.windows} windows agree ({self.clear} clear)"
        if self.median_m is None or self.largest_m is None:
            return f"registration unknown: {counts}"
        median, largest = self.median_m / self.pixel_m, self.largest_m / self.pixel_m
        return (
            f"registration: {counts}; residual {median:.1f} px ({self.median_m:.2f} m) in the "
            f"median, {_PERCENTILE} % within {largest:.1f} px ({self.largest_m:.2f} m)"
        )


def register(
    first: Raster, second: Raster, area: Area, origin: Geodetic, files: tuple[Path, Path]
) -> Registration:
    """Measure the offset of the second orthophoto from the first one.

    Args:
        first: orthophoto.
        second: orthophoto of another date, in any reference system.
        area: ground that both orthophotos cover.
        origin: origin of the world, on the ground.
        files: files of both orthophotos, to name in errors.

    Raises:
        InputError: a file is damaged, or no window of an orthophoto has edges.
    """
    pixel = max(*first.grid.ground_pixel, *second.grid.ground_pixel)
    side, corners = _lay_windows(area, pixel)
    has_edges, offsets = [], []
    with progress_bar("registration", len(corners)) as advance:
        for k, corner in enumerate(corners, 1):
            points = _window_points(corner, side, pixel)
            first_edges, second_edges = (
                _edges(sample_colours(orthophoto, origin, points, pixel), side)
                for orthophoto in (first, second)
            )
            advance(k)
            if first_edges is None or second_edges is None:
                continue
            has_edges.append((first_edges.any(), second_edges.any()))
            offset = _offset(first_edges, second_edges) if all(has_edges[-1]) else None
            if offset is not None:
                offsets.append(offset)
    for file, any_edges in zip(files, np.any(has_edges, 0), strict=True) if has_edges else ():
        if not any_edges:
            raise InputError(
                f"{file} has no contrast where both orthophotos are compared: it shows one colour, "
                "or values that are too close together; give another file or stretch its values"
            )
    return _summarize(pixel, len(has_edges), np.array(offsets, np.float64).reshape(-1, 2))


def _lay_windows(area: Area, pixel: float) -> tuple[int, Array]:
    """Return the side of the windows (px) and their south-west corners (N, 2), world metres."""
    first, end = area.low + _RIM_PX * pixel, area.high - _RIM_PX * pixel
    sides = (end - first) / pixel
    half = max(float(sides.min()) / 2, 1.0)
    side = int(np.clip(2 ** int(math.log2(half)), _MIN_SIDE, _MAX_SIDE))
    if sides.min() < side:
        return side, np.empty((0, 2))
    counts = np.clip(np.floor(2 * sides / side).astype(int) - 1, 1, _MAX_WINDOWS)
    last = end - side * pixel
    axes = [np.linspace(a, b, n) for a, b, n in zip(first, last, counts, strict=True)]
    return side, np.stack(np.meshgrid(*axes), -1).reshape(-1, 2)


def _window_points(corner: Array, side: int, pixel: float) -> Array:
    """Return the ground points (side * side, 3) of a window's pixels, row by row from the north."""
    steps = (np.arange(side) + 0.5) * pixel
    north, east = np.meshgrid(corner[1] + steps[::-1], corner[0] + steps, indexing="ij")
    return np.stack([east.ravel(), north.ravel(), np.zeros(side * side)], -1)


def _edges(colours: Array, side: int) -> NDArray[np.complex64] | None:
    """Return the gradients with doubled angle (side, side) of colours (side * side, channels).

    None is returned if too many pixels have no data; a window without edges has zeros.
    """
    known = np.isfinite(colours).all(1)
    if known.mean() < 1 - _MAX_UNKNOWN:
        return None
    grey = np.where(known, colours.mean(1), colours[known].mean()).reshape(side, side)
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _GRADIENT_PX)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1)))
    gradient = np.asarray(across + 1j * down, np.complex64)
    length = np.abs(gradient)
    if length.max() < _NOISE_LEVEL:
        return np.zeros_like(gradient)
    nearby = np.sqrt(cv2.GaussianBlur(length**2, (0, 0), _NEARBY_PX))
    return np.asarray(gradient**2 / (length + 1e-6) / (nearby + _NOISE_LEVEL), np.complex64)


def _offset(first: NDArray[np.complex64], second: NDArray[np.complex64]) -> Array | None:
    """Return the offset (2,) of the second window to the east and north, px; None if unclear."""
    side = len(first)
    taper = np.outer(np.hanning(side), np.hanning(side))
    spectra = [np.fft.fft2((edges - edges.mean()) * taper) for edges in (first, second)]
    product = spectra[1] * np.conj(spectra[0])
    strength = np.abs(product) ** _WHITENING
    correlation = np.fft.fftshift(np.fft.ifft2(product / (strength + 1e-12)).real)
    middle, reach = side // 2, int(_REACH * side)
    searched = correlation[middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
    row, column = (int(x) for x in np.unravel_index(int(searched.argmax()), searched.shape))
    others = searched.copy()
    others[_slice_around(row), _slice_around(column)] = -np.inf
    if searched[row, column] <= _MIN_PEAK_RATIO * max(float(others.max()), 0.0):
        return None
    down = row + _vertex(searched[:, column], row) - reach
    across = column + _vertex(searched[row], column) - reach
    return np.array([across, -down])


def _slice_around(index: int) -> slice:
    return slice(max(0, index - _PEAK_PX), index + _PEAK_PX + 1)


def _vertex(values: Array, index: int) -> float:
    """Return the vertex of the parabola through a maximum and its neighbours, -0.5 to 0.5."""
    if not 0 < index < len(values) - 1:
        return 0.0
    before, at, after = values[index - 1 : index + 2].tolist()
    bend = before - 2 * at + after
    return 0.0 if bend >= 0 else float(np.clip((before - after) / (2 * bend), -0.5, 0.5))


def _summarize(pixel: float, windows: int, offsets: Array) -> Registration:
    """Return the registration from clear offsets (N, 2), px."""
    clear = len(offsets)
    best = max((_agreeing(offsets, each) for each in offsets), key=np.sum, default=None)
    if best is None:
        return Registration(pixel, windows)
    agreeing = _agreeing(offsets, np.median(offsets[best], 0))
    number = int(agreeing.sum())
    if number < max(_MIN_AGREEING, _MIN_AGREEING_SHARE * clear):
        return Registration(pixel, windows, clear, number)
    offset = np.median(offsets[agreeing], 0)
    residuals = np.linalg.norm(offsets[agreeing] - offset, axis=1) * pixel
    median, largest = np.percentile(residuals, [50, _PERCENTILE]).tolist()
    east, north = (offset * pixel).tolist()
    return Registration(pixel, windows, clear, number, (east, north), median, largest)


def _agreeing(offsets: Array, centre: Array) -> NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(offsets - centre, axis=1) < _AGREE_PX)
