"""Points on small things that stand on the ground, and of which a map has none.

The middle of a segment is no place of the surface that two photographs would find again. So places
in every photograph are swept along their rays, and those become points that stand above the ground
and that the sweeps of several photographs put at the same place in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.sweep import Sweeper, Window
from objconnect.network import ObjConnectNet
from objconnect.segmentation import Labels
from objconnect.supplement.association import Detections
from objconnect.supplement.config import SupplementConfig
from objconnect.supplement.segments import find
from objconnect.supplement.standing import heights, nearest
from objconnect.supplement.triangulation import Lifted, triangulate
from scene.images import read_rgb
from scene.progress import progress_bar
from scene.sparse_map import MapImage, SparseMap

# A bollard is three pixels wide: larger windows show the ground behind it.
_WINDOW: Final = Window(5, 1.0)
_NEIGHBOURS: Final = 6
# Depths that a place may have: around that of so many observations near it, as much nearer and
# farther (m).
_AROUND: Final = 12
_NEARER_M: Final = 4.0
_FARTHER_M: Final = 1.5
# Places that are looked at around a place in space.
_MEMBERS: Final = 32


def supplement_points(
    sparse_map: SparseMap,
    images: Path,
    config: SupplementConfig,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> tuple[list[Lifted], dict[str, Detections]]:
    """Find small things that have no point in a map, and points on them.

    Args:
        sparse_map: without added points; up is z.
        images: folder of its photographs.
        config: thresholds.
        network: see ``segments.find``.
        masks: of objects, by photograph, in place of segments; photographs without are left out.

    Raises:
        InputError: a photograph is missing or damaged.
    """
    sweep = Sweeper(sparse_map, images, window=_WINDOW, neighbours=_NEIGHBOURS)
    detections, places = {}, [np.zeros((0, 3))]
    names = [name for name in sparse_map.names if masks is None or name in masks]
    with progress_bar("sweep", len(names)) as advance:
        for done, name in enumerate(names, 1):
            image = sparse_map.images[name]
            rgb = read_rgb(images / name, image.camera)
            found = find(rgb, network, None if masks is None else masks[name])
            bounds = _bounds(sparse_map, image, found.xy)
            if bounds is not None:
                swept = sweep(name, found.xy, bounds)
                kept = swept.sure
                detections[name] = Detections(
                    found.xy[kept],
                    found.descriptors[kept],
                    found.confidence[kept] * swept.score[kept],
                )
                places.append(swept.xyz[kept])
            advance(done)
    return _points(sparse_map, detections, np.concatenate(places), config), detections


def _bounds(
    sparse_map: SparseMap, image: MapImage, xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Nearest and farthest depths of places (N, 2), from the map's points around them."""
    seen = image.point_rows >= 0
    z = image.pose.transform(torch.from_numpy(sparse_map.xyz[image.point_rows[seen]]))[:, 2].numpy()
    if len(z) < _AROUND or not len(xy):
        return None
    rows, _ = nearest(xy, image.xy[seen], _AROUND)
    middle = np.median(z[rows], axis=1)
    return np.maximum(middle - _NEARER_M, 0.1 * middle), middle + _FARTHER_M


def _points(
    sparse_map: SparseMap,
    detections: Mapping[str, Detections],
    places: NDArray[np.float64],
    config: SupplementConfig,
) -> list[Lifted]:
    """Of places (P, 3), in the order of photographs and their detections, those that several
    photographs agree on."""
    cloud = np.concatenate([sparse_map.xyz, places])
    above = heights(places, cloud)
    standing = np.flatnonzero((above > config.above_m) & (above < config.below_m))
    if len(standing) < _MEMBERS:
        return []
    view = np.repeat(np.arange(len(detections)), [len(d.xy) for d in detections.values()])
    row = np.concatenate([np.arange(len(d.xy)) for d in detections.values()])
    names = list(detections)
    xyz, view, row = places[standing], view[standing], row[standing]
    near, far_off = nearest(xyz, xyz, _MEMBERS)
    within = far_off < config.together_m
    support = np.array([len(set(view[n[w]])) for n, w in zip(near, within, strict=True)])
    taken = np.zeros(len(xyz), bool)
    points: list[Lifted] = []
    for place in np.argsort(-support, kind="stable"):
        if support[place] < config.views:
            break
        if taken[place]:
            continue
        members = near[place][within[place]]
        # The nearest of each photograph.
        rows = {names[view[k]]: int(row[k]) for k in members[::-1] if not taken[k]}
        point = triangulate(sparse_map, detections, rows, config)
        if point is not None:
            points.append(point)
            taken[members] = True
    return _missing(sparse_map, points, cloud, config)


def _missing(
    sparse_map: SparseMap,
    points: list[Lifted],
    cloud: NDArray[np.float64],
    config: SupplementConfig,
) -> list[Lifted]:
    """Those that still stand above the ground, away from what the map has."""
    if not points:
        return []
    xyz = np.array([point.xyz for point in points])
    above = heights(xyz, cloud)
    _, off = nearest(xyz, sparse_map.xyz, 1)
    kept = (above > config.above_m) & (above < config.below_m) & (off[:, 0] > config.apart_m)
    return [point for point, good in zip(points, kept, strict=True) if good]
