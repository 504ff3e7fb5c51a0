"""Model where snow lies on a site: by slope, shelter, and clearing of paved ground."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.twin.classes import CROWN, LOW_VEGETATION, PAVED, ROOF, WATER

Float = NDArray[np.float32]
Labels = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# Distance within which a wall shelters the ground, and its height for the full effect.
_SHELTER_M, _SHELTER_RISE_M = 2.5, 4.0
_SHELTER_LOSS = 0.08  # share of the snow that a high wall keeps off
# Vertical component of unit normals up to which no snow lies, and from which all snow stays.
_STEEP_NORMAL, _LEVEL_NORMAL = 0.35, 0.75
# Height steps lower than this (hedges, banks, noise of the surface model) keep at least this share.
_LOW_STEP_M, _LOW_STEP_SHARE = 1.2, 0.7
# Share of the snow that stays, by class. Crowns keep this share on every slope, because snow lies
# on them in patches.
_KEPT_SHARE = {LOW_VEGETATION: 1.0, ROOF: 1.0, CROWN: 0.42, WATER: 0.0}
# Share of the snow that stays on roads, car parks and paths. Traffic clears roads, and car parks in
# part. Narrow or light ground (pavements, gravel yards) counts as a path, which is walked on.
_ROAD_SHARE, _LOT_SHARE, _PATH_SHARE = 0.12, 0.4, 0.5
_PATH_M, _LOT_M = 4.0, 14.0  # maximum width of paths, minimum width of car parks
# Light ground has an albedo between these multiples of that of roads. Painted lines are lighter.
_MIN_LIGHT, _MAX_LIGHT = 1.8, 3.3
_PAINT_M = 0.7  # blur of the albedo, against painted lines
_MIN_CROWN_M = 2.0  # minimum width of crowns; narrower ones are misclassified edges of roofs
# Minimum height of cars and other objects, and share of the snow that stays on them.
_MIN_OBJECT_M, _OBJECT_SHARE = 0.6, 0.9
_SPLASH_M = 0.5  # distance over which wheels throw snow to the edges


def snow_share(
    surface: Float,
    spacing_m: float,
    classes: Labels,
    above_ground: Float,
    albedo: Float,
    texel_m: float,
) -> Float:
    """Return the share of the snow that stays on each texel, (n, n).

    Args:
        surface: Heights at the nodes (m, m), metres.
        spacing_m: Distance between nodes, metres.
        classes: Classes (n, n).
        above_ground: Height above the ground (n, n), metres.
        albedo: Linear colours (n, n, 3).
        texel_m: Side of a texel, metres.
    """
    by_slope = snow_by_slope(surface, spacing_m, len(classes))
    kept = np.zeros(256, np.float32)
    kept[list(_KEPT_SHARE)] = list(_KEPT_SHARE.values())
    share = np.asarray(kept[classes])
    paved = classes == PAVED
    share[paved] = _snow_on_pavement(paved, albedo, texel_m)[paved]
    share = cv2.GaussianBlur(share, (0, 0), _SPLASH_M / texel_m)
    share[classes == WATER] = 0.0
    share[paved & (above_ground > _MIN_OBJECT_M)] = _OBJECT_SHARE
    crown = _open_mask(classes == CROWN, _MIN_CROWN_M, texel_m)
    share[crown] = _KEPT_SHARE[CROWN]
    return np.asarray(share * np.where(crown, np.float32(1), by_slope), np.float32)


def snow_by_slope(surface: Float, spacing_m: float, n: int) -> Float:
    """Return the share of snow by slope and shelter on (n, n) texels of a surface (m, m).

    No snow lies on walls, and a little less lies beside high walls than elsewhere.
    """
    # Slopes of the cells between nodes, because slopes at nodes affect the ground beside walls.
    east = 0.5 * (np.diff(surface[1:], axis=1) + np.diff(surface[:-1], axis=1)) / spacing_m
    north = 0.5 * (np.diff(surface[:, 1:], axis=0) + np.diff(surface[:, :-1], axis=0)) / spacing_m
    up = 1 / np.sqrt(1 + east**2 + north**2)
    by_slope = np.clip((up - _STEEP_NORMAL) / (_LEVEL_NORMAL - _STEEP_NORMAL), 0, 1)
    kernel = np.ones((3, 3), np.uint8)
    step = (cv2.dilate(surface, kernel) - cv2.erode(surface, kernel))[:-1, :-1]
    by_slope = np.where(step < _LOW_STEP_M, np.maximum(by_slope, _LOW_STEP_SHARE), by_slope)
    width = 2 * max(1, round(_SHELTER_M / spacing_m)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    rise = np.clip((cv2.dilate(surface, disc) - surface) / _SHELTER_RISE_M, 0, 1)[:-1, :-1]
    share = (by_slope * (1 - _SHELTER_LOSS * rise)).astype(np.float32)
    return np.asarray(cv2.resize(share, (n, n), interpolation=cv2.INTER_LINEAR))


def _snow_on_pavement(paved: Mask, albedo: Float, texel_m: float) -> Float:
    """Return the share of the snow that stays on paved ground (n, n), by its width and colour."""
    narrow = ~_open_mask(paved, _PATH_M, texel_m)
    wide = _open_mask(paved, _LOT_M, texel_m)
    share = np.where(wide, _LOT_SHARE, _ROAD_SHARE).astype(np.float32)
    value = cv2.GaussianBlur(albedo.mean(-1), (0, 0), _PAINT_M / texel_m)
    driven = paved & ~narrow
    if driven.any():
        road_value = float(np.median(value[driven]))
        share[(value > _MIN_LIGHT * road_value) & (value < _MAX_LIGHT * road_value)] = _PATH_SHARE
    share[narrow] = _PATH_SHARE
    return share


def _open_mask(mask: Mask, width_m: float, texel_m: float) -> Mask:
    """Return the parts of a mask (n, n) into which a disc of diameter ``width_m`` fits."""
    radius = 0.5 * width_m / texel_m
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) > radius
    reach = (
        cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5) if inside.any() else None
    )
    return np.zeros_like(mask) if reach is None else np.asarray(mask & (reach <= radius + 1))
