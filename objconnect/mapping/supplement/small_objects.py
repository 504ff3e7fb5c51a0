"""Points on small objects that stand on the ground and have no point in the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.mapping.supplement.association import Detections
from objconnect.mapping.supplement.blobs import Blobs, find
from objconnect.mapping.supplement.classifier import PlaceClassifier, measure
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.ground_plane import Ground, nearest
from objconnect.mapping.supplement.photoconsistency import costs
from objconnect.mapping.supplement.tracks import Tracks, distinct, follow, solve
from objconnect.mapping.supplement.triangulation import Lifted, triangulate
from objconnect.network.network import ObjConnectNet
from objconnect.network.segmentation import Labels
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.views import looks_down
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

# Heights of a place above the ground around it (m): lower ones are not told from the ground, higher
# ones do not stand on it alone.
_ABOVE_M: Final = 0.1
_BELOW_M: Final = 3.2
# Least probability of being on an object, by the classifier. docs/evidence/mapping.md has its
# precision.
_LIKELY: Final = 0.8
# Least distance (m) of a place from the map's own points, which are on an object already.
_APART_M: Final = 0.5


@dataclass(frozen=True)
class Places:
    """Places a little above the ground where several photographs show a blob.

    Attributes:
        images: photographs of the map.
        blobs: blobs of each photograph.
        tracks: T places.
        figures: figures (T, F) of the places, results of ``classifier.measured``.
    """

    images: list[MapImage]
    blobs: list[Blobs]
    tracks: Tracks
    figures: NDArray[np.float32]


def find_places(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> Places:
    """Find places of possible small objects; arguments and errors as ``supplement_points``."""
    names = [name for name in sparse_map.names if masks is None or name in masks]
    images = [sparse_map.images[name] for name in names]
    # The classifier was trained on nadir photographs.
    images = [image for image in images if looks_down(image.cam_from_world[:3, :3])]
    if names and not images:
        raise InputError(
            "no photograph looks down by 30 degrees: small objects are recognised only from above"
        )
    blobs: list[Blobs] = []
    with progress_bar("blobs", len(images)) as advance:
        for image in images:
            rgb = read_rgb(folder / image.name, image.camera)
            given = None if masks is None else masks[image.name]
            blobs.append(find(rgb, network, given))
            advance(len(blobs))
    ground = Ground.of(sparse_map.xyz)
    tracks = follow(images, blobs, ground, config.views)
    tracks = solve(images, blobs, tracks, config.views)
    tracks = distinct(tracks, config.views)
    above = tracks.xyz[:, 2] - ground.at(tracks.xyz[:, :2])
    tracks = tracks.only((above > _ABOVE_M) & (above < _BELOW_M))
    place_costs = costs(images, folder, blobs, ground, tracks)
    figures = measure(images, blobs, ground, tracks, place_costs)
    return Places(images, blobs, tracks, figures)


def supplement_points(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    classifier: PlaceClassifier,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> tuple[list[Lifted], dict[str, Detections]]:
    """Find points on small objects that have no point in a map.

    Args:
        sparse_map: map without added points, with z up.
        folder: folder of its photographs.
        config: thresholds.
        classifier: decides which places are on objects.
        network: network for ``blobs.find``.
        masks: label maps of objects by photograph; photographs without one are left out.

    Returns:
        The points, and the detections by photograph.

    Raises:
        InputError: a photograph is missing or damaged, or none looks down.
    """
    places = find_places(sparse_map, folder, config, network, masks)
    names = [image.name for image in places.images]
    detections = {name: each.detections for name, each in zip(names, places.blobs, strict=True)}
    likely = classifier.likely(places.figures)
    tracks = places.tracks.only(likely > _LIKELY)
    points = []
    for track in range(len(tracks.xyz)):
        mine = tracks.track == track
        views, rows = tracks.view[mine].tolist(), tracks.row[mine].tolist()
        members = {names[view]: row for view, row in zip(views, rows, strict=True)}
        point = triangulate(sparse_map, detections, members, config)
        if point is not None:
            points.append(point)
    return _missing(sparse_map, points), detections


def _missing(sparse_map: SparseMap, points: list[Lifted]) -> list[Lifted]:
    """Return the points that are far enough from those of the map."""
    if not points:
        return []
    _, off = nearest(np.array([point.xyz for point in points]), sparse_map.xyz, 1)
    return [point for point, far in zip(points, off[:, 0] > _APART_M, strict=True) if far]
