"""Radiances between 8 and 14 micrometres against known integrals, and their inverse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from simulate.thermal.planck import (
    HIGHEST_K,
    LOWEST_K,
    band_radiance,
    brightness_temperature,
    integrate_planck,
)


@pytest.mark.parametrize("kelvin", [150.0, 220.0, 273.15, 300.0, 350.0, 600.0])
def test_radiance_is_the_integral_of_planck(kelvin: float) -> None:
    def spectral(micrometres: float) -> float:
        x = 14387.768775039337 / (micrometres * kelvin)  # second radiation constant, um K
        return float(1.191042972397188e8 / micrometres**5 / np.expm1(x))  # W um4 / (m2 sr)

    expected, _ = quad(spectral, 8, 14, epsabs=1e-12)
    assert integrate_planck(kelvin) == pytest.approx(expected, rel=1e-9)


def test_the_inverse_is_exact() -> None:
    kelvin = np.random.default_rng(0).uniform(200, 400, (50, 40))
    assert np.abs(brightness_temperature(band_radiance(kelvin)) - kelvin).max() < 1e-6
    assert np.abs(brightness_temperature(integrate_planck(kelvin)) - kelvin).max() < 1e-6


def test_hotter_is_brighter_and_limits_hold() -> None:
    kelvin = np.linspace(LOWEST_K, HIGHEST_K, 5000)
    assert (np.diff(band_radiance(kelvin)) > 0).all()
    assert brightness_temperature(0.0) == LOWEST_K
    assert brightness_temperature(1e6) == HIGHEST_K


def test_the_band_is_a_part_of_all_radiation() -> None:
    """At 300 K, a black body sends 38 % of its power between 8 and 14 micrometres."""
    share = np.pi * integrate_planck(300.0) / (5.670374419e-8 * 300.0**4)
    assert share == pytest.approx(0.376, abs=0.002)
