"""Points on small things that stand on the ground, and of which a map has none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.network import ObjConnectNet
from objconnect.segmentation import Labels
from objconnect.supplement.association import Detections
from objconnect.supplement.config import SupplementConfig
from objconnect.supplement.raised import costs, stands_out
from objconnect.supplement.spots import Spots, find
from objconnect.supplement.standing import Ground, nearest
from objconnect.supplement.tracks import Tracks, distinct, follow, solve
from objconnect.supplement.triangulation import Lifted, triangulate
from scene.images import read_rgb
from scene.progress import progress_bar
from scene.sparse_map import SparseMap


def supplement_points(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> tuple[list[Lifted], dict[str, Detections]]:
    """Find small things that have no point in a map, and points on them.

    Args:
        sparse_map: without added points; up is z.
        folder: of its photographs.
        config: thresholds.
        network: see ``spots.find``.
        masks: of objects, by photograph; photographs without are left out.

    Raises:
        InputError: a photograph is missing or damaged.
    """
    names = [name for name in sparse_map.names if masks is None or name in masks]
    images = [sparse_map.images[name] for name in names]
    spots: list[Spots] = []
    with progress_bar("spots", len(names)) as advance:
        for image in images:
            rgb = read_rgb(folder / image.name, image.camera)
            spots.append(find(rgb, network, None if masks is None else masks[image.name]))
            advance(len(spots))
    detections = {name: each.detections for name, each in zip(names, spots, strict=True)}
    ground = Ground.of(sparse_map.xyz)
    tracks = follow(images, spots, ground, config.views)
    tracks = distinct(solve(images, spots, tracks, config.views), config.views)
    above = tracks.xyz[:, 2] - ground.at(tracks.xyz[:, :2])
    tracks = tracks.only((above > config.above_m) & (above < config.below_m))
    found = costs(images, folder, spots, ground, tracks)
    tracks = tracks.only(_standing(tracks, spots, ground, found, config))
    points = []
    for track in range(len(tracks.xyz)):
        mine = tracks.track == track
        views, rows = tracks.view[mine].tolist(), tracks.row[mine].tolist()
        members = {names[view]: row for view, row in zip(views, rows, strict=True)}
        point = triangulate(sparse_map, detections, members, config)
        if point is not None:
            points.append(point)
    return _missing(sparse_map, points, config), detections


def _standing(
    tracks: Tracks,
    spots: list[Spots],
    ground: Ground,
    found: NDArray[np.float64],
    config: SupplementConfig,
) -> NDArray[np.bool_]:
    """Which places stand on the ground: those that photographs agree on clearly better than on
    the ground under them, and those that nearly all see as a strong spot."""
    above = tracks.xyz[:, 2] - ground.at(tracks.xyz[:, :2])
    share, off = stands_out(found, above)
    strength = np.concatenate([each.strength for each in spots])
    first = np.cumsum([0] + [len(each.xy) for each in spots])[:-1]
    mean = np.bincount(
        tracks.track, strength[first[tracks.view] + tracks.row], len(above)
    ) / tracks.views.clip(1)
    clear = (above > config.clear_m) & (share < config.clearly) & (off < config.together_m)
    bright = (tracks.views > config.views) & (tracks.views >= config.nearly_all * tracks.visible)
    return np.asarray(clear | (bright & (mean > config.strong) & (share < config.hardly)))


def _missing(sparse_map: SparseMap, points: list[Lifted], config: SupplementConfig) -> list[Lifted]:
    """Those away from what the map has."""
    if not points:
        return []
    _, off = nearest(np.array([point.xyz for point in points]), sparse_map.xyz, 1)
    return [point for point, far in zip(points, off[:, 0] > config.apart_m, strict=True) if far]
