"""Points on small things that stand on the ground, and of which a map has none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from baselines.views import looks_down
from objconnect.network import ObjConnectNet
from objconnect.segmentation import Labels
from objconnect.supplement.association import Detections
from objconnect.supplement.config import SupplementConfig
from objconnect.supplement.judge import Judge, measured
from objconnect.supplement.raised import costs
from objconnect.supplement.spots import Spots, find
from objconnect.supplement.standing import Ground, nearest
from objconnect.supplement.tracks import Tracks, distinct, follow, solve
from objconnect.supplement.triangulation import Lifted, triangulate
from scene.errors import InputError
from scene.images import read_rgb
from scene.progress import progress_bar
from scene.sparse_map import MapImage, SparseMap


@dataclass(frozen=True)
class Places:
    """Where photographs of a map show one spot a little above the ground.

    Attributes:
        images: photographs.
        spots: of each.
        tracks: T places.
        figures: (T, F) what was measured of them: ``judge.measured``.
    """

    images: list[MapImage]
    spots: list[Spots]
    tracks: Tracks
    figures: NDArray[np.float32]


def find_places(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> Places:
    """Every place where a small thing may be; arguments and errors as ``supplement_points``."""
    names = [name for name in sparse_map.names if masks is None or name in masks]
    images = [sparse_map.images[name] for name in names]
    # The judge learned from above.
    images = [image for image in images if looks_down(image.cam_from_world[:3, :3])]
    if names and not images:
        raise InputError(
            "no photograph looks down by 30 degrees: small things are known from above alone"
        )
    spots: list[Spots] = []
    with progress_bar("spots", len(images)) as advance:
        for image in images:
            rgb = read_rgb(folder / image.name, image.camera)
            spots.append(find(rgb, network, None if masks is None else masks[image.name]))
            advance(len(spots))
    ground = Ground.of(sparse_map.xyz)
    tracks = follow(images, spots, ground, config.views)
    tracks = distinct(solve(images, spots, tracks, config.views), config.views)
    above = tracks.xyz[:, 2] - ground.at(tracks.xyz[:, :2])
    tracks = tracks.only((above > config.above_m) & (above < config.below_m))
    found = costs(images, folder, spots, ground, tracks)
    return Places(images, spots, tracks, measured(images, spots, ground, tracks, found))


def supplement_points(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    judge: Judge,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> tuple[list[Lifted], dict[str, Detections]]:
    """Find small things that have no point in a map, and points on them.

    Args:
        sparse_map: without added points; up is z.
        folder: of its photographs.
        config: thresholds.
        judge: who says which places are on things.
        network: see ``spots.find``.
        masks: of objects, by photograph; photographs without are left out.

    Raises:
        InputError: a photograph is missing or damaged, or none looks down.
    """
    places = find_places(sparse_map, folder, config, network, masks)
    names = [image.name for image in places.images]
    detections = {name: each.detections for name, each in zip(names, places.spots, strict=True)}
    likely = judge.likely(places.figures)
    tracks = places.tracks.only(likely > config.likely)
    points = []
    for track in range(len(tracks.xyz)):
        mine = tracks.track == track
        views, rows = tracks.view[mine].tolist(), tracks.row[mine].tolist()
        members = {names[view]: row for view, row in zip(views, rows, strict=True)}
        point = triangulate(sparse_map, detections, members, config)
        if point is not None:
            points.append(point)
    return _missing(sparse_map, points, config), detections


def _missing(sparse_map: SparseMap, points: list[Lifted], config: SupplementConfig) -> list[Lifted]:
    """Those away from what the map has."""
    if not points:
        return []
    _, off = nearest(np.array([point.xyz for point in points]), sparse_map.xyz, 1)
    return [point for point, far in zip(points, off[:, 0] > config.apart_m, strict=True) if far]
