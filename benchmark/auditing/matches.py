"""SIFT matches between photographs, found without poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.matching.retrieval import VladIndex
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.sift import SiftExtractor
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.features import unit_descriptors
from objconnect.scene.maps.matching import match
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

Array = NDArray[np.float64]

# Photographs are shrunk to at most this many pixels on the longer side before they are matched.
WORKING_SIDE = 1000
# Largest number of keypoints of a photograph, and Lowe's ratio of descriptor distances.
_MAX_FEATURES = 3000
_RATIO = 0.8
# Each photograph is matched with this many successors and with this many similar photographs.
_SUCCESSORS = 2
_SIMILAR = 4
# Inlier threshold of the fundamental matrix, in thousandths of the longer side.
_INLIER_THRESHOLD = 2.0
# Two photographs with fewer inliers do not overlap.
LEAST_MATCHES = 30


@dataclass(frozen=True)
class Pair:
    """Inliers of a fundamental matrix between two photographs.

    Attributes:
        first: row of one photograph.
        second: row of the other.
        xy_first: pixels (K, 2) of the matches in the first, at the size of the file.
        xy_second: pixels (K, 2) in the second.
    """

    first: int
    second: int
    xy_first: Array
    xy_second: Array

    def __len__(self) -> int:
        return len(self.xy_first)


@dataclass(frozen=True)
class _PhotographFeatures:
    """Features of one photograph: pixels of the file, unit descriptors, and the longer side."""

    xy: Array
    unit: torch.Tensor
    side: int


def match_photographs(
    files: Sequence[Path], cameras: Sequence[Camera | None], rows: Sequence[int]
) -> list[Pair]:
    """Match photographs of a data set with each other.

    Args:
        files: all photographs of the data set.
        cameras: their cameras; where one is known, its distortion is removed before matches are
            checked against a fundamental matrix.
        rows: photographs to match; those that cannot be read are left out.
    """
    extract = SiftExtractor(SiftOptions(max_features=_MAX_FEATURES))
    features_of: dict[int, _PhotographFeatures] = {}
    with progress_bar("features", len(rows)) as advance:
        for done, row in enumerate(rows, 1):
            features = _extract(files[row], extract)
            if features is not None:
                features_of[row] = features
            advance(done)
    candidates = _choose_pairs(features_of)
    pairs = []
    with progress_bar("matches", len(candidates)) as advance:
        for done, (a, b) in enumerate(candidates, 1):
            pair = _match(a, b, features_of, cameras)
            if pair is not None:
                pairs.append(pair)
            advance(done)
    return pairs


def _extract(file: Path, extract: SiftExtractor) -> _PhotographFeatures | None:
    """Return the SIFT features of a photograph; None if it cannot be read."""
    try:
        rgb = read_rgb(file)
    except InputError:
        return None  # the check of files reports it
    height, width = rgb.shape[:2]
    scale = min(1.0, WORKING_SIDE / max(height, width))
    shrunk = rgb
    if scale < 1:
        size = (max(round(scale * width), 1), max(round(scale * height), 1))
        shrunk = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    features = extract(shrunk)
    # The origin of pixel coordinates is the image corner, so that the ratio of sizes scales them.
    factor = np.array([width / shrunk.shape[1], height / shrunk.shape[0]])
    xy = features.xy.astype(np.float64) * factor
    return _PhotographFeatures(xy, unit_descriptors(features.descriptors), max(height, width))


def _choose_pairs(features_of: dict[int, _PhotographFeatures]) -> list[tuple[int, int]]:
    """Return pairs of rows to match: photographs that follow each other, and similar ones."""
    rows = [row for row in features_of if len(features_of[row].xy) >= LEAST_MATCHES]
    if len(rows) < 2:
        return []
    descriptors = [features_of[row].unit.numpy() for row in rows]
    index = VladIndex.build(descriptors)
    pairs = set()
    for k in range(len(rows)):
        successors = range(k + 1, min(k + 1 + _SUCCESSORS, len(rows)))
        similar = [int(j) for j in index.rank(descriptors[k], _SIMILAR + 1) if j != k][:_SIMILAR]
        pairs |= {(min(k, j), max(k, j)) for j in (*successors, *similar)}
    return [(rows[a], rows[b]) for a, b in sorted(pairs)]


def _match(
    a: int, b: int, features_of: dict[int, _PhotographFeatures], cameras: Sequence[Camera | None]
) -> Pair | None:
    """Match the photographs of rows ``a`` and ``b``; None if they do not overlap."""
    matches = match(features_of[a].unit, features_of[b].unit, _RATIO)
    if len(matches) < LEAST_MATCHES:
        return None
    xy_a, xy_b = features_of[a].xy[matches[:, 0]], features_of[b].xy[matches[:, 1]]
    threshold = _INLIER_THRESHOLD / 1000 * max(features_of[a].side, features_of[b].side)
    flat_a, flat_b = undistort(xy_a, cameras[a]), undistort(xy_b, cameras[b])
    try:
        _, mask = cv2.findFundamentalMat(flat_a, flat_b, cv2.USAC_MAGSAC, threshold, 0.999, 5000)
    except cv2.error:  # OpenCV fails an assertion if no geometry fits the matches
        return None
    if mask is None or int(mask.sum()) < LEAST_MATCHES:
        return None
    is_inlier = mask.ravel().astype(bool)
    return Pair(a, b, xy_a[is_inlier], xy_b[is_inlier])


def undistort(xy: Array, camera: Camera | None) -> Array:
    """Return pixels (K, 2) without the distortion of the camera; unchanged without a camera."""
    if camera is None or not any(camera.distortion):
        return xy
    rays, _ = camera.unproject(torch.from_numpy(xy))
    focal, principal = torch.tensor(camera.focal), torch.tensor(camera.principal)
    return np.asarray((rays[:, :2] * focal + principal).numpy(), np.float64)
