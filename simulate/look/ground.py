"""Bake the albedo image of a place's ground under a condition: season, light and weather."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.look.conditions import Condition
from simulate.look.cover import NO_COVER, Cover
from simulate.look.noise import grain, noise
from simulate.look.seasons import Season
from simulate.place.paint import SHIFT, to_raster
from simulate.place.world import Ground, Rgb

Float = NDArray[np.float32]

_LABELS = max(CLASSES.values()) + 1
# Contrast of blotches, grain and single spots by class of ground, as fractions of the albedo. Spots
# are tufts, weeds, stones and bare earth.
_TEXTURE: dict[str, tuple[float, float, float]] = {
    "grass": (0.22, 0.24, 0.24),
    "field": (0.18, 0.22, 0.22),
    "road": (0.12, 0.09, 0.10),
    "pavement": (0.10, 0.12, 0.12),
    "parking": (0.12, 0.09, 0.12),
    "driveway": (0.12, 0.14, 0.20),
    "path": (0.14, 0.18, 0.25),
    "water": (0.10, 0.0, 0.0),
}
_SEALED = ("road", "pavement", "parking", "driveway")  # classes on which rain water stays
FLOOD_ALBEDO = np.array([0.060, 0.048, 0.030], np.float32)  # muddy water
_FURROW, _SWATH = 5.0, 0.55  # radians per metre across the rows
_WET_DARKENING = 0.5  # relative darkening of wet ground
# Classes that look the same in every season: linear albedo (deep, shallow).
_SEASONLESS: dict[str, tuple[Rgb, Rgb]] = {"water": ((0.012, 0.024, 0.026), (0.020, 0.034, 0.028))}
# Share of the snow that stays on each class of ground; traffic and shovels clear the rest.
_SNOW_KEPT: dict[str, float] = {
    "grass": 1.0,
    "field": 0.95,
    "road": 0.12,
    "pavement": 0.45,
    "parking": 0.4,
    "driveway": 0.5,
    "path": 0.6,
    "water": 0.0,
}


def bake(
    ground: Ground, condition: Condition, seed: int, cover: Cover = NO_COVER
) -> NDArray[np.uint8]:
    """Return the albedo (n, n, 3) uint8 sRGB of the ground under a condition; row 0 is south.

    Equal seeds give equal blotches under every condition; only colours and the cover change.
    """
    rng = np.random.default_rng([seed, 1])
    n = len(ground.labels)
    side_m = n * ground.texel_m
    broad = noise(rng, n, side_m / 40.0)
    blotch = 0.6 * noise(rng, n, side_m / 9.0) + 0.4 * noise(rng, n, side_m / 2.2)
    fine = 0.4 * noise(rng, n, side_m / 1.1) + 0.4 * noise(rng, n, side_m / 0.5)
    fine += 0.4 * grain(rng, n)
    spots = _spots(rng, n, side_m / 0.5) - _spots(rng, n, side_m / 0.8)
    drift = 0.45 * broad + 0.4 * blotch + 0.15 * fine
    tone = ground.tone.astype(np.float32) / 255.0 - 0.5

    labels, season = ground.labels, condition.season
    blotch_contrast, grain_contrast, spot_contrast = _contrasts()
    # Share of the worn colour, higher in some parcels. For water it is the shallow colour.
    worn = np.clip(0.5 + 0.55 * broad + 0.35 * blotch + 0.9 * tone, 0, 1)
    value = (
        1
        + blotch_contrast[labels] * (0.6 * broad + blotch)
        + grain_contrast[labels] * fine
        + 0.22 * tone
    )
    value *= np.maximum(1 + spot_contrast[labels] * spots, 0.3)
    value *= 1 - _furrows(ground, tone)
    albedo = _mix_worn(labels, season, worn)
    if season.ploughed is not None:
        _plough(albedo, value, ground, season.ploughed, worn)
    albedo *= value[..., None]
    albedo *= _wear(rng, ground)[..., None]

    albedo *= _kerbs(ground)[..., None]
    paint_mask = _marking_mask(ground) * np.clip(0.85 + 0.25 * blotch, 0.3, 1)
    albedo += paint_mask[..., None] * (np.float32(0.72) - albedo)
    if cover.litter is not None:
        _strew_leaves(albedo, cover.litter, labels, season, fine)
    albedo *= 1 - _WET_DARKENING * condition.wet
    if cover.flood is not None:
        albedo += cover.flood[..., None] * (FLOOD_ALBEDO * (1 + 0.1 * drift)[..., None] - albedo)
    if season.snow > 0:
        _lay_snow(albedo, ground, season, drift, cover.shelter)
    return srgb(albedo)


def _contrasts() -> NDArray[np.float32]:
    """Return the contrasts (3, labels) of blotches, grain and spots."""
    contrasts = np.zeros((3, _LABELS), np.float32)
    for name, texture in _TEXTURE.items():
        contrasts[:, CLASSES[name]] = texture
    return contrasts


def _mix_worn(labels: NDArray[np.uint8], season: Season, worn: Float) -> Float:
    """Return the albedo (n, n, 3) of a season, mixed from its fresh and its worn colours."""
    fresh_colour = np.zeros((_LABELS, 3), np.float32)
    worn_colour = np.zeros((_LABELS, 3), np.float32)
    for name in _TEXTURE:
        k = CLASSES[name]
        fresh_colour[k], worn_colour[k] = _SEASONLESS.get(name) or season.ground[name]
    albedo = fresh_colour[labels]
    albedo += worn[..., None] * (worn_colour - fresh_colour)[labels]
    return np.asarray(albedo)


def _plough(
    albedo: Float, value: Float, ground: Ground, colours: tuple[Rgb, Rgb], worn: Float
) -> None:
    """Turn the fields whose tone is an even number into ploughed earth with deep furrows.

    The other fields become stubble, with rows and the swaths of a combine harvester.
    """
    fields = ground.labels == CLASSES["field"]
    ploughed = fields & (ground.tone % 2 == 0)
    fresh, old = (np.array(rgb, np.float32) for rgb in colours)
    albedo[ploughed] = fresh + worn[ploughed][:, None] * (old - fresh)
    across = _measure_across_rows(ground, ground.tone.astype(np.float32) / 255.0 - 0.5)
    value[ploughed] *= 1 + 0.3 * np.sin(across[ploughed] * _FURROW)
    stubble = fields & ~ploughed
    value[stubble] *= 1 + 0.12 * np.sign(np.sin(across[stubble] * _SWATH))


def _strew_leaves(
    albedo: Float, litter: Float, labels: NDArray[np.uint8], season: Season, fine: Float
) -> None:
    """Cover the ground with fallen leaves. Roads and water keep less than half of them."""
    kept = np.ones(_LABELS, np.float32)
    kept[CLASSES["road"]], kept[CLASSES["water"]] = 0.45, 0.25
    share = np.clip(1.5 * litter * kept[labels] - 0.35 + 0.45 * fine, 0, 0.95) * (litter > 0.02)
    brown, bright = (np.array(rgb, np.float32) for rgb in (season.leaf, season.leaf_tip))
    leaves = brown + np.clip(0.45 + 0.5 * fine, 0, 1)[..., None] * (bright - brown)
    albedo += share[..., None] * (leaves - albedo)


def _lay_snow(
    albedo: Float, ground: Ground, season: Season, drift: Float, shelter: Float | None
) -> None:
    """Cover the ground with snow. In thaw, only the sheltered part of the snow remains."""
    snow = np.zeros(_LABELS, np.float32)
    for name, share in _SNOW_KEPT.items():
        snow[CLASSES[name]] = share
    # The coverage is blurred because wheels throw snow to the edges of roads.
    kept = cv2.GaussianBlur(snow[ground.labels], (0, 0), 0.5 / ground.texel_m)
    depth = kept * season.snow * 4.2 - 1.4 + 1.5 * drift
    if shelter is not None:
        depth += season.thaw * kept * (1.9 * shelter - 1.5)
    snow_share = np.clip(depth, 0, 1)
    white = np.array([0.74, 0.77, 0.82], np.float32) * (1 + 0.07 * drift)[..., None]
    albedo += (0.93 * snow_share)[..., None] * (white - albedo)


def specular_map(
    ground: Ground, condition: Condition, seed: int, cover: Cover = NO_COVER
) -> NDArray[np.uint8]:
    """Return the specular share of the ground, (n, n) uint8 from 0 to 255.

    Water is a full mirror. Rain leaves a film and puddles on paved ground.
    """
    n = len(ground.labels)
    water = np.where(ground.labels == CLASSES["water"], 255, 0).astype(np.uint8)
    if cover.flood is not None:
        water = np.maximum(water, np.asarray(255 * cover.flood, np.uint8))
    if condition.wet == 0:
        return water
    rng = np.random.default_rng([seed, 2])
    side_m = n * ground.texel_m
    hollows = 0.6 * noise(rng, n, side_m / 7.0) + 0.4 * noise(rng, n, side_m / 2.0)
    puddles = np.clip((hollows - 0.35) / 0.08, 0, 1)
    sealed = np.isin(ground.labels, [CLASSES[c] for c in _SEALED])
    film = sealed * condition.wet * (0.25 + 0.75 * puddles)
    return np.maximum(water, np.asarray(255 * film, np.uint8))


def _spots(rng: np.random.Generator, n: int, cells: float) -> NDArray[np.float32]:
    """Return a map (n, n) of spots: on a grid of ``cells`` x ``cells``, about one cell in ten has a
    bump of height 1, and the rest is 0."""
    return np.asarray(np.clip(2.5 * noise(rng, n, cells) - 1.2, 0, 1.5))


def _measure_across_rows(ground: Ground, tone: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the coordinate (n, n), metres, at right angles to the rows of each region."""
    n = len(ground.labels)
    axis = (np.arange(n, dtype=np.float32) - 0.5 * n) * ground.texel_m
    angle = tone * 9.0
    return np.asarray(np.cos(angle) * axis[None, :] + np.sin(angle) * axis[:, None])


def _furrows(ground: Ground, tone: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the darkening (n, n) by crop rows and mowing stripes.

    Rows and stripes have a direction that is derived from the region's tone (-0.5 to 0.5), so that
    fields differ.
    """
    across = _measure_across_rows(ground, tone)
    rows = np.where(ground.labels == CLASSES["field"], np.float32(0.11), np.float32(0))
    rows *= 0.5 + 0.5 * np.sin(across * 4.2)
    # About every third lawn is mown in stripes.
    mown = (ground.labels == CLASSES["grass"]) & (ground.tone % 3 == 0) & (ground.tone != 128)
    return np.asarray(rows + mown * 0.05 * (1 + np.sign(np.sin(across * 3.1))), np.float32)


def _wear(rng: np.random.Generator, ground: Ground) -> NDArray[np.float32]:
    """Return the albedo factor (n, n) of cracks, repairs, manholes and stains on paved ground."""
    n = len(ground.labels)
    wear = np.ones((n, n), np.float32)
    sealed = np.isin(ground.labels, [CLASSES[c] for c in ("road", "parking", "driveway")])
    rows, columns = np.nonzero(sealed[::7, ::7])
    if len(rows) == 0:
        return wear
    count = int(sealed.sum() * ground.texel_m**2 / 18.0)
    for i in rng.integers(0, len(rows), count):
        at = (int(columns[i]) * 7, int(rows[i]) * 7)
        kind, angle = rng.random(), float(rng.uniform(0, 180))
        size = rng.uniform(0.6, 3.5, 2) / ground.texel_m
        if kind < 0.25:  # a crack, or the tar that fills it
            course = np.cumsum(np.radians(angle) + rng.normal(0, 0.5, 9))
            steps = 0.35 * size[0] * np.column_stack([np.cos(course), np.sin(course)])
            crack = [np.int32((np.cumsum(steps, 0) + at) * (1 << SHIFT))]
            # The line is one texel wide, so it is fainter where texels are wider than cracks.
            dark = rng.uniform(0.2, 0.45) * min(1.0, 0.1 / ground.texel_m)
            cv2.polylines(wear, crack, False, 1 - dark, 1, cv2.LINE_AA, SHIFT)
        elif kind < 0.55:  # a patch of newer or older asphalt
            box = cv2.boxPoints((at, (float(size[0]), float(0.5 * size[1])), angle))
            cv2.fillPoly(wear, [box.astype(np.int32)], rng.uniform(0.72, 1.22))
        elif kind < 0.65:  # a manhole
            cv2.circle(wear, at, max(1, round(0.35 / ground.texel_m)), 0.55, -1, cv2.LINE_AA)
        else:  # oil and tyre marks
            axes = (max(1, int(0.4 * size[0])), max(1, int(0.12 * size[1])))
            cv2.ellipse(wear, at, axes, angle, 0, 360, rng.uniform(0.75, 0.95), -1, cv2.LINE_AA)
    wear = cv2.GaussianBlur(wear, (0, 0), 0.8)
    return np.where(sealed, wear, np.float32(1))


def _kerbs(ground: Ground) -> NDArray[np.float32]:
    """Return the albedo factor (n, n) of pale kerb stones beside carriageways and dark gutters."""
    road = (ground.labels == CLASSES["road"]).astype(np.uint8)
    width = max(1, round(0.15 / ground.texel_m))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1, 2 * width + 1))
    kerb = cv2.dilate(road, disc) - road
    gutter = road - cv2.erode(road, disc)
    return np.asarray(1 + np.float32(0.35) * kerb - np.float32(0.25) * gutter)


def _marking_mask(ground: Ground) -> NDArray[np.float32]:
    """Return the coverage (n, n), 0 to 1, by painted lines."""
    n = len(ground.labels)
    mask = np.zeros((n, n), np.uint8)
    for marking in ground.markings:
        step = np.diff(marking.line, axis=0)
        normal = np.stack([-step[:, 1], step[:, 0]], -1)
        normal *= 0.5 * marking.width_m / np.linalg.norm(step, axis=1, keepdims=True)
        for a, b, side in zip(marking.line[:-1], marking.line[1:], normal, strict=True):
            quad = np.stack([a - side, b - side, b + side, a + side])
            corners = [to_raster(quad, ground.texel_m, n)]
            cv2.fillPoly(mask, corners, 255, cv2.LINE_AA, SHIFT)
    return mask.astype(np.float32) / 255.0


def srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Convert linear values 0..1 of any shape to sRGB bytes by a table, which is fast."""
    x = np.arange(4096, dtype=np.float64) / 4095.0
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    table = np.round(255 * curve).astype(np.uint8)
    return np.asarray(table[np.clip(linear * 4095.0, 0, 4095).astype(np.uint16)])
