"""Radiance of a black body between 8 and 14 micrometres, and the temperature that belongs to it.

Planck's law is integrated over the band, in which uncooled thermal cameras see. A camera calibrated
on a black body reports the brightness temperature: the temperature of a black body of equal
radiance.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

BAND_M: Final = (8e-6, 14e-6)
"""Limits of the band, metres."""
LOWEST_K: Final = 100.0
HIGHEST_K: Final = 655.35
"""Limits of the temperatures in the table, kelvin. The highest is the largest 16-bit count."""

_H: Final = 6.62607015e-34  # Planck constant, J s
_C: Final = 299792458.0  # speed of light, m/s
_K: Final = 1.380649e-23  # Boltzmann constant, J/K
# With this step, linear interpolation is within 1e-6 K of the integral.
_STEP_K: Final = 0.01
_NODES: Final = 24  # nodes of the Gauss-Legendre quadrature, whose error is then below 1e-12


def integrate_planck(kelvin: ArrayLike) -> Array:
    """Return the radiance of a black body in the band, W/(m2 sr), at temperatures of any shape."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)  # type: ignore[no-untyped-call]
    low, high = BAND_M
    wavelength = 0.5 * (low + high) + 0.5 * (high - low) * nodes
    temperature = np.asarray(kelvin, float)[..., None]
    spectral = 2 * _H * _C**2 / wavelength**5
    spectral = spectral / np.expm1(_H * _C / (wavelength * _K * temperature))
    return np.asarray(0.5 * (high - low) * (spectral @ weights))


@cache
def _table() -> tuple[Array, Array]:
    """Return the temperatures of the table, and the radiance at each."""
    count = round((HIGHEST_K - LOWEST_K) / _STEP_K) + 1
    kelvin = np.linspace(LOWEST_K, HIGHEST_K, count)
    return kelvin, integrate_planck(kelvin)


def band_radiance(kelvin: ArrayLike) -> Array:
    """Return the radiance of a black body in the band, W/(m2 sr), from a table.

    Temperatures are clipped to ``LOWEST_K`` and ``HIGHEST_K``.
    """
    return np.asarray(np.interp(np.asarray(kelvin, float), *_table()))


def brightness_temperature(radiance: ArrayLike) -> Array:
    """Return the temperature, kelvin, of a black body of a radiance; inverse of ``band_radiance``.

    The result is clipped to ``LOWEST_K`` and ``HIGHEST_K``.
    """
    kelvin, values = _table()
    return np.asarray(np.interp(np.asarray(radiance, float), values, kelvin))
