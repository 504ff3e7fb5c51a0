"""Snow that stays on a synthetic, level site of 60 m with roads, a lot and paths, at 0.25 m."""

from __future__ import annotations

import numpy as np
import pytest

from simulate.twin.classes import LOW_VEGETATION, PAVED, ROOF
from simulate.twin.snow import snow_by_slope, snow_share

TEXEL_M, N = 0.25, 240


def strip(west_m: float, east_m: float) -> tuple[slice, slice]:
    """A strip from south to north, in texels."""
    return slice(None), slice(round(west_m / TEXEL_M), round(east_m / TEXEL_M))


def middle(snow: np.ndarray, west_m: float, east_m: float) -> float:
    """The median of a strip, without a metre at both sides and ten at both ends."""
    inside = strip(west_m + 1, east_m - 1)[1]
    return float(np.median(snow[40:-40, inside]))


def snow_left(found: np.ndarray, albedo: np.ndarray, above: np.ndarray | None = None) -> np.ndarray:
    level = np.zeros((N + 1, N + 1), np.float32)
    standing = np.zeros((N, N), np.float32) if above is None else above
    return snow_share(level, TEXEL_M, found, standing, albedo, TEXEL_M)


def test_roads_are_cleared_and_lots_and_paths_keep_more() -> None:
    found = np.full((N, N), LOW_VEGETATION, np.uint8)
    albedo = np.full((N, N, 3), 0.1, np.float32)
    for west, east in ((2, 10), (14, 17), (24, 56)):
        found[strip(west, east)] = PAVED
    snow = snow_left(found, albedo)
    assert middle(snow, 2, 10) == pytest.approx(0.12, abs=0.02)
    assert middle(snow, 14, 17) == pytest.approx(0.5, abs=0.05)
    assert middle(snow, 24, 56) == pytest.approx(0.4, abs=0.02)
    assert middle(snow, 18, 22) > 0.97


def test_a_light_pavement_beside_a_road_keeps_more_than_the_road_and_paint_does_not() -> None:
    found = np.full((N, N), LOW_VEGETATION, np.uint8)
    albedo = np.full((N, N, 3), 0.1, np.float32)
    found[strip(20, 31)] = PAVED
    albedo[strip(28, 31)] = 0.26
    albedo[strip(23.5, 23.75)] = 0.7  # a line
    snow = snow_left(found, albedo)
    assert snow[100, round(29.5 / TEXEL_M)] > 0.4
    assert snow[100, round(23.6 / TEXEL_M)] < 0.15


def test_cars_keep_their_snow_on_a_road() -> None:
    found = np.full((N, N), LOW_VEGETATION, np.uint8)
    found[strip(20, 28)] = PAVED
    above = np.zeros((N, N), np.float32)
    above[100:116, 92:100] = 1.5
    snow = snow_left(found, np.full((N, N, 3), 0.1, np.float32), above)
    assert snow[104:112, 94:98].min() > 0.85
    assert snow[60, 96] < 0.15


def test_walls_are_bare_and_the_ground_beside_them_is_not() -> None:
    surface = np.zeros((N + 1, N + 1), np.float32)
    surface[80:160, 80:160] = 8.0
    lies = snow_by_slope(surface, TEXEL_M, N)
    assert lies[100:140, 79].max() < 0.05, "the cell of the wall"
    assert lies[100:140, 76].min() > 0.9, "a metre before it"
    assert lies[100:140, 84].min() > 0.9, "on the roof"
    found = np.where(surface[:-1, :-1] > 0, ROOF, LOW_VEGETATION).astype(np.uint8)
    snow = snow_share(
        surface, TEXEL_M, found, surface[:-1, :-1], np.full((N, N, 3), 0.1, np.float32), TEXEL_M
    )
    assert snow[100:140, 100:140].min() > 0.95


def test_low_sides_hold_most_of_their_snow() -> None:
    surface = np.zeros((N + 1, N + 1), np.float32)
    surface[:, 100:108] = 1.0  # a hedge
    lies = snow_by_slope(surface, TEXEL_M, N)
    assert lies[50:190].min() > 0.6
