"""Bake the albedo image of a site, a real place: its orthophoto in another season and weather."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.look.conditions import Condition
from simulate.look.cover import cover
from simulate.look.ground import FLOOD_ALBEDO, srgb
from simulate.look.noise import grain, noise
from simulate.look.seasons import SEASONS, Season
from simulate.place.world import World

Float = NDArray[np.float32]

_SEALED = ("pavement",)  # classes on which rain water stays
# Relative darkening of wet surfaces, by class.
_WET_DARKENING: dict[str, float] = {"pavement": 0.5, "grass": 0.4, "building": 0.35, "tree": 0.25}
_SNOW_RGB = np.array([0.74, 0.77, 0.82], np.float32)
_SNOW_OPACITY = 0.93  # share of a surface's colour that deep snow hides
_CROWN_COVER = 0.7  # factor of the snow's cover on crowns
_STRIP_ROWS = 1024  # rows that are painted at once
# Linear light of each sRGB byte.
_LINEAR = np.where(
    np.arange(256) <= 10,
    np.arange(256) / 255 / 12.92,
    ((np.arange(256) / 255 + 0.055) / 1.055) ** 2.4,
).astype(np.float32)


def bake_albedo(world: World, condition: Condition) -> NDArray[np.uint8]:
    """Return the albedo (n, n, 3) uint8 sRGB of a site; row 0 is south.

    Colours of vegetation and ground are multiplied by the ratio of the two seasons' colours, which
    keeps the detail of the orthophoto. Leafless crowns are coloured like twigs and litter and keep
    their shape.
    """
    imagery = world.imagery
    assert imagery is not None
    labels, n = world.ground.labels, len(world.ground.labels)
    ratio = _ratios(SEASONS.load(imagery.season), condition.season)
    ratio *= (1 - condition.wet * _table(_WET_DARKENING))[:, None]
    drift = _drift(world, n) if condition.season.snow > 0 else None
    flood = cover(world, condition).flood
    out = np.empty((n, n, 3), np.uint8)
    for first in range(0, n, _STRIP_ROWS):
        rows = slice(first, first + _STRIP_ROWS)
        albedo = _LINEAR[imagery.albedo[rows]] * ratio[labels[rows]]
        if flood is not None:
            albedo += flood[rows, :, None] * (FLOOD_ALBEDO - albedo)
        if drift is not None:
            _lay_snow(albedo, labels[rows], imagery.snow[rows], drift[rows], condition.season)
        out[rows] = srgb(albedo)
    return out


def bake_specular(world: World, condition: Condition) -> NDArray[np.uint8]:
    """Return the specular share of a site, (n, n) uint8 from 0 to 255."""
    labels = world.ground.labels
    water = np.where(labels == CLASSES["water"], 255, 0).astype(np.uint8)
    flood = cover(world, condition).flood
    if flood is not None:
        water = np.maximum(water, np.asarray(255 * flood, np.uint8))
    if condition.wet == 0:
        return water
    rng = np.random.default_rng([world.seed, 2])
    side_m = len(labels) * world.ground.texel_m
    hollows = noise(rng, len(labels), side_m / 4.0)
    puddles = np.clip((hollows - 0.5) / 0.1, 0, 1)
    sealed = np.isin(labels, [CLASSES[name] for name in _SEALED])
    film = sealed * condition.wet * (0.15 + 0.6 * puddles)
    return np.maximum(water, np.asarray(255 * film, np.uint8))


def _drift(world: World, n: int) -> Float:
    """Return the variation (n, n) of the depth of snow, with mean 0."""
    rng = np.random.default_rng([world.seed, 1])
    side_m = n * world.ground.texel_m
    broad = noise(rng, n, side_m / 40.0)
    blotch = 0.6 * noise(rng, n, side_m / 9.0) + 0.4 * noise(rng, n, side_m / 2.2)
    fine = 0.4 * (noise(rng, n, side_m / 1.1) + noise(rng, n, side_m / 0.5) + grain(rng, n))
    return np.asarray(0.45 * broad + 0.4 * blotch + 0.15 * fine, np.float32)


def _lay_snow(
    albedo: Float,
    labels: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    drift: Float,
    season: Season,
) -> None:
    """Cover rows of the albedo (h, n, 3) with snow, as ``simulate.look.ground.bake`` does.

    ``kept`` is the share (h, n) of the snow that stays, in 1/255. Unlike in that function, snow in
    the shade thaws as fast as snow in the sun.
    """
    snow_share = np.clip(
        kept * np.float32(season.snow * 4.2 / 255) - _bare_threshold(season) + 1.5 * drift, 0, 1
    )
    snow_share *= np.where(labels == CLASSES["tree"], np.float32(_CROWN_COVER), np.float32(1))
    white = _SNOW_RGB * (1 + 0.07 * drift)[..., None]
    albedo += (_SNOW_OPACITY * snow_share)[..., None] * (white - albedo)


def _bare_threshold(season: Season) -> float:
    """Return the amount of snow up to which the ground is bare.

    With an amount larger by 1, snow covers the ground completely.
    """
    return 1.4 + 0.5 * season.thaw


def _table(values: dict[str, float]) -> Float:
    """Return values as a table by label; missing labels have 0."""
    table = np.zeros(max(CLASSES.values()) + 1, np.float32)
    for name, value in values.items():
        table[CLASSES[name]] = value
    return table


def _ratios(imaged: Season, wanted: Season) -> Float:
    """Return the colours of the wanted season relative to the imaged season, (labels, 3)."""
    table = np.ones((max(CLASSES.values()) + 1, 3), np.float32)
    for name in ("grass", "pavement"):
        before, after = (np.mean(season.ground[name], axis=0) for season in (imaged, wanted))
        table[CLASSES[name]] = after / before
    table[CLASSES["tree"]] = _foliage(wanted) / _foliage(imaged)
    return table


def _foliage(season: Season) -> NDArray[np.float64]:
    return np.asarray(0.6 * np.array(season.leaf) + 0.4 * np.array(season.leaf_tip))
