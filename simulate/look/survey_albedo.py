"""Bake the albedo image of a site under a condition: its orthophoto in another season."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.look.conditions import SEASONS, Condition, Season
from simulate.look.ground import grain, noise, srgb
from simulate.place.world import World

Float = NDArray[np.float32]

_SEALED = ("pavement",)
_WET_DARKENING: dict[str, float] = {"pavement": 0.5, "grass": 0.4, "building": 0.35, "tree": 0.25}
_SNOW_RGB = np.array([0.74, 0.77, 0.82], np.float32)
_OPAQUE, _ON_CROWNS = 0.93, 0.7  # share of a surface that deep snow hides
_STRIP = 1024  # rows that are painted at once
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
    ratio *= (1 - condition.weather.wet * _table(_WET_DARKENING))[:, None]
    drift = _drift(world, n) if condition.season.snow > 0 else None
    out = np.empty((n, n, 3), np.uint8)
    for first in range(0, n, _STRIP):
        rows = slice(first, first + _STRIP)
        albedo = _LINEAR[imagery.albedo[rows]] * ratio[labels[rows]]
        if drift is not None:
            _lay_snow(albedo, labels[rows], imagery.snow[rows], drift[rows], condition.season.snow)
        out[rows] = srgb(albedo)
    return out


def bake_gloss(world: World, condition: Condition) -> NDArray[np.uint8]:
    """Return the specular share of a site, (n, n) uint8 from 0 to 255."""
    labels = world.ground.labels
    standing = np.where(labels == CLASSES["water"], 255, 0).astype(np.uint8)
    if condition.weather.wet == 0:
        return standing
    rng = np.random.default_rng([world.seed, 2])
    across = len(labels) * world.ground.texel_m
    hollows = noise(rng, len(labels), across / 4.0)
    puddles = np.clip((hollows - 0.5) / 0.1, 0, 1)
    sealed = np.isin(labels, [CLASSES[name] for name in _SEALED])
    film = sealed * condition.weather.wet * (0.15 + 0.6 * puddles)
    return np.maximum(standing, np.asarray(255 * film, np.uint8))


def _drift(world: World, n: int) -> Float:
    """Return the variation of snow, (n, n), with mean 0."""
    rng = np.random.default_rng([world.seed, 1])
    across = n * world.ground.texel_m
    broad = noise(rng, n, across / 40.0)
    blotch = 0.6 * noise(rng, n, across / 9.0) + 0.4 * noise(rng, n, across / 2.2)
    fine = 0.4 * (noise(rng, n, across / 1.1) + noise(rng, n, across / 0.5) + grain(rng, n))
    return np.asarray(0.45 * broad + 0.4 * blotch + 0.15 * fine, np.float32)


def _lay_snow(
    albedo: Float,
    labels: NDArray[np.uint8],
    kept: NDArray[np.uint8],
    drift: Float,
    amount: float,
) -> None:
    """Cover rows of the albedo (h, n, 3) with snow, as ``simulate.look.ground.bake`` does."""
    cover = np.clip(kept * np.float32(amount * 4.2 / 255) - 1.4 + 1.5 * drift, 0, 1)
    cover *= np.where(labels == CLASSES["tree"], np.float32(_ON_CROWNS), np.float32(1))
    white = _SNOW_RGB * (1 + 0.07 * drift)[..., None]
    albedo += (_OPAQUE * cover)[..., None] * (white - albedo)


def _table(values: dict[str, float]) -> Float:
    """Return values as a table by label; missing labels have 0."""
    table = np.zeros(max(CLASSES.values()) + 1, np.float32)
    for name, value in values.items():
        table[CLASSES[name]] = value
    return table


def _ratios(shown: Season, wanted: Season) -> Float:
    """Return the ratio of the colours of two seasons, (labels, 3)."""
    table = np.ones((max(CLASSES.values()) + 1, 3), np.float32)
    for name in ("grass", "pavement"):
        before, after = (np.mean(season.ground[name], axis=0) for season in (shown, wanted))
        table[CLASSES[name]] = after / before
    table[CLASSES["tree"]] = _foliage(wanted) / _foliage(shown)
    return table


def _foliage(season: Season) -> NDArray[np.float64]:
    return np.asarray(0.6 * np.array(season.leaf) + 0.4 * np.array(season.leaf_tip))
