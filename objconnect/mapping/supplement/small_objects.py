"""Find points on small objects that stand on the ground and have no point in the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.mapping.supplement.association import Detections
from objconnect.mapping.supplement.blobs import Blobs, find_blobs
from objconnect.mapping.supplement.classifier import PointClassifier, compute_features
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.ground_plane import Ground, find_nearest
from objconnect.mapping.supplement.photoconsistency import compute_costs
from objconnect.mapping.supplement.tracks import (
    Tracks,
    drop_overlapping,
    follow_blobs,
    refine_tracks,
)
from objconnect.mapping.supplement.triangulation import TriangulatedPoint, triangulate
from objconnect.network.network import ObjConnectNet
from objconnect.network.segmentation import Labels
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.views import looks_down
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

# Range of heights above the ground (m): lower points cannot be distinguished from the ground,
# higher ones are not on small objects.
_MIN_HEIGHT_M: Final = 0.1
_MAX_HEIGHT_M: Final = 3.2
# Minimum probability of being on an object. docs/evidence/mapping.md states which share of the
# added points is near a surface.
_MIN_PROBABILITY: Final = 0.8
# Minimum distance (m) from the map's points. An object nearer to one of them has a point already.
_MIN_DISTANCE_M: Final = 0.5


@dataclass(frozen=True)
class Proposals:
    """Proposed points a little above the ground, at which several photographs show a blob.

    Attributes:
        images: photographs of the map.
        blobs: blobs of each photograph.
        tracks: T tracks of blobs with their points.
        features: inputs (T, F) of the classifier, from ``classifier.compute_features``.
    """

    images: list[MapImage]
    blobs: list[Blobs]
    tracks: Tracks
    features: NDArray[np.float32]


def propose_points(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> Proposals:
    """Propose points on possible small objects.

    Arguments and errors are those of ``supplement_points``, which gives the proposals to its
    classifier.
    """
    names = [name for name in sparse_map.names if masks is None or name in masks]
    images = [sparse_map.images[name] for name in names]
    # Views near the horizon are left out: the classifier was trained on nadir photographs.
    images = [image for image in images if looks_down(image.cam_from_world[:3, :3])]
    if names and not images:
        raise InputError(
            "no photograph looks down by 30 degrees or more: supplement needs views from above"
        )
    blobs: list[Blobs] = []
    with progress_bar("blobs", len(images)) as advance:
        for image in images:
            rgb = read_rgb(folder / image.name, image.camera)
            labels = None if masks is None else masks[image.name]
            blobs.append(find_blobs(rgb, network, labels))
            advance(len(blobs))
    ground = Ground.of(sparse_map.xyz)
    tracks = follow_blobs(images, blobs, ground, config.views)
    tracks = refine_tracks(images, blobs, tracks, config.views)
    tracks = drop_overlapping(tracks, config.views)
    height = tracks.xyz[:, 2] - ground.height_at(tracks.xyz[:, :2])
    tracks = tracks.select((height > _MIN_HEIGHT_M) & (height < _MAX_HEIGHT_M))
    costs = compute_costs(images, folder, blobs, ground, tracks)
    features = compute_features(images, blobs, ground, tracks, costs)
    return Proposals(images, blobs, tracks, features)


def supplement_points(
    sparse_map: SparseMap,
    folder: Path,
    config: SupplementConfig,
    classifier: PointClassifier,
    network: ObjConnectNet | None = None,
    masks: Mapping[str, Labels] | None = None,
) -> tuple[list[TriangulatedPoint], dict[str, Detections]]:
    """Find points on small objects that have no point in a map.

    Args:
        sparse_map: map without added points, with z up.
        folder: folder of its photographs.
        config: thresholds.
        classifier: decides which proposals are on objects.
        network: network for ``blobs.find_blobs``.
        masks: label maps of objects by photograph; photographs without one are left out.

    Returns:
        The points, and the detections by photograph.

    Raises:
        InputError: a photograph is missing or damaged, or none looks down.
    """
    proposals = propose_points(sparse_map, folder, config, network, masks)
    names = [image.name for image in proposals.images]
    detections = {name: each.detections for name, each in zip(names, proposals.blobs, strict=True)}
    probability = classifier.predict(proposals.features)
    tracks = proposals.tracks.select(probability > _MIN_PROBABILITY)
    points = []
    for track in range(len(tracks.xyz)):
        is_member = tracks.track == track
        views, rows = tracks.view[is_member].tolist(), tracks.row[is_member].tolist()
        row_of = {names[view]: row for view, row in zip(views, rows, strict=True)}
        point = triangulate(sparse_map, detections, row_of, config)
        if point is not None:
            points.append(point)
    return _drop_known(sparse_map, points), detections


def _drop_known(sparse_map: SparseMap, points: list[TriangulatedPoint]) -> list[TriangulatedPoint]:
    """Return the points that are far enough from the map's points."""
    if not points:
        return []
    _, distance = find_nearest(np.array([point.xyz for point in points]), sparse_map.xyz, 1)
    return [
        point for point, far in zip(points, distance[:, 0] > _MIN_DISTANCE_M, strict=True) if far
    ]
