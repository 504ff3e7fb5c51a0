"""Where snow lies on a site: by slope, by shelter, and by what people clear."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.twin.classes import CROWN, LOW, PAVED, ROOF, WATER

Float = NDArray[np.float32]
Labels = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_SHELTER_M, _SHELTER_RISE_M = 2.5, 4.0  # how far and how high what keeps snow off stands
_SHELTERED = 0.08  # share of the snow that a high wall keeps off
_SNOW_FROM, _SNOW_TO = 0.35, 0.75  # uprightness of normals on which no snow lies, and all
# Sides lower than this hold most of their snow: hedges, banks, noise of the surface model.
_LOW_SIDE_M, _ON_LOW_SIDES = 1.2, 0.7
# Share of the snow that stays by class. Crowns are specked with it on all sides.
_KEPT = {LOW: 1.0, ROOF: 1.0, CROWN: 0.42, WATER: 0.0}
# Share that stays on paved ground: wheels clear roads, lots keep some, and what is narrow or light
# (paths, pavements, yards of gravel) is walked on more than driven on.
_ON_ROADS, _ON_LOTS, _ON_PATHS = 0.12, 0.4, 0.5
_PATH_M, _LOT_M = 4.0, 14.0  # widths: paths are narrower than the first, lots wider than the second
_LIGHT, _TOO_LIGHT = 1.8, 3.3  # times the albedo of roads; lighter still are their markings
_PAINT_M = 0.7  # albedo is compared over this distance, so that lines of paint do not count
_RIM_M = 2.0  # edges of roofs, which look rough and dark, are taken for crowns so far
_STANDS_M, _ON_THINGS = 0.6, 0.9  # cars and other things keep their snow on cleared ground
_SPLASH_M = 0.5  # wheels throw snow to the edges so far


def snow_that_stays(
    surface: Float, spacing_m: float, found: Labels, above: Float, albedo: Float, texel_m: float
) -> Float:
    """Return the share of the snow that stays on each texel, (n, n).

    Args:
        surface: Heights at the nodes (m, m), metres.
        spacing_m: Distance between nodes, metres.
        found: Classes (n, n).
        above: Height above the ground (n, n), metres.
        albedo: Linear colours (n, n, 3).
        texel_m: Side of a texel, metres.
    """
    lies = where_snow_lies(surface, spacing_m, len(found))
    kept = np.zeros(256, np.float32)
    kept[list(_KEPT)] = list(_KEPT.values())
    share = np.asarray(kept[found])
    paved = found == PAVED
    share[paved] = _snow_on_pavement(paved, albedo, texel_m)[paved]
    share = cv2.GaussianBlur(share, (0, 0), _SPLASH_M / texel_m)
    share[found == WATER] = 0.0
    share[paved & (above > _STANDS_M)] = _ON_THINGS
    crown = _open_mask(found == CROWN, _RIM_M, texel_m)  # what is thinner is the rim of a wall
    share[crown] = _KEPT[CROWN]
    return np.asarray(share * np.where(crown, np.float32(1), lies), np.float32)


def where_snow_lies(surface: Float, spacing_m: float, n: int) -> Float:
    """Return the share of the snow that lies on the n x n texels of a surface of nodes (m, m).

    Nothing lies on walls, and a little less beside what stands much higher.
    """
    # Slopes of the cells between nodes: those at nodes would bare the ground beside walls.
    east = 0.5 * (np.diff(surface[1:], axis=1) + np.diff(surface[:-1], axis=1)) / spacing_m
    north = 0.5 * (np.diff(surface[:, 1:], axis=0) + np.diff(surface[:, :-1], axis=0)) / spacing_m
    up = 1 / np.sqrt(1 + east**2 + north**2)
    lies = np.clip((up - _SNOW_FROM) / (_SNOW_TO - _SNOW_FROM), 0, 1)
    around = np.ones((3, 3), np.uint8)
    side = (cv2.dilate(surface, around) - cv2.erode(surface, around))[:-1, :-1]
    lies = np.where(side < _LOW_SIDE_M, np.maximum(lies, _ON_LOW_SIDES), lies)
    width = 2 * max(1, round(_SHELTER_M / spacing_m)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    rise = np.clip((cv2.dilate(surface, disc) - surface) / _SHELTER_RISE_M, 0, 1)[:-1, :-1]
    share = (lies * (1 - _SHELTERED * rise)).astype(np.float32)
    return np.asarray(cv2.resize(share, (n, n), interpolation=cv2.INTER_LINEAR))


def _snow_on_pavement(paved: Mask, albedo: Float, texel_m: float) -> Float:
    """Return the share of the snow that stays on paved ground (n, n), by its width and colour."""
    narrow = ~_open_mask(paved, _PATH_M, texel_m)
    wide = _open_mask(paved, _LOT_M, texel_m)
    share = np.where(wide, _ON_LOTS, _ON_ROADS).astype(np.float32)
    value = cv2.GaussianBlur(albedo.mean(-1), (0, 0), _PAINT_M / texel_m)
    driven = paved & ~narrow
    if driven.any():
        usual = float(np.median(value[driven]))
        share[(value > _LIGHT * usual) & (value < _TOO_LIGHT * usual)] = _ON_PATHS
    share[narrow] = _ON_PATHS
    return share


def _open_mask(mask: Mask, width_m: float, texel_m: float) -> Mask:
    """Return the parts of a mask (n, n) that a disc of this diameter fits into."""
    radius = 0.5 * width_m / texel_m
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) > radius
    reach = (
        cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5) if inside.any() else None
    )
    return np.zeros_like(mask) if reach is None else np.asarray(mask & (reach <= radius + 1))
