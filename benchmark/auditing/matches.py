"""Points that photographs share, found by SIFT without any pose."""

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

# Longest side (px) at which photographs are matched; conventions show at any resolution.
WORKING_SIDE = 1000
# Most keypoints of a photograph.
_FEATURES = 3000
_RATIO = 0.8
# Photographs that each is matched with: its successors in order, and those that look alike.
_SUCCESSORS = 2
_ALIKE = 4
# The threshold of the fundamental matrix, in thousandths of the longer side.
_INLIER = 2.0
# Two photographs with fewer matches that agree do not overlap.
LEAST_MATCHES = 30


@dataclass(frozen=True)
class Pair:
    """Matches between two photographs that agree on a fundamental matrix.

    Attributes:
        first: row of one photograph.
        second: row of the other.
        xy_first: pixels (K, 2) of the matches in the first, as the file is stored.
        xy_second: pixels (K, 2) in the second.
    """

    first: int
    second: int
    xy_first: Array
    xy_second: Array

    def __len__(self) -> int:
        return len(self.xy_first)


@dataclass(frozen=True)
class _Seen:
    """Features of one photograph: pixels of the file, unit descriptors, and the longer side."""

    xy: Array
    unit: torch.Tensor
    side: int


def match_photographs(
    files: Sequence[Path], cameras: Sequence[Camera | None], rows: Sequence[int]
) -> list[Pair]:
    """Match some photographs among each other.

    Args:
        files: all photographs of the data set.
        cameras: their cameras; where one is known, its distortion is removed before matches are
            checked against a fundamental matrix.
        rows: which photographs to match; those that cannot be read are left out.
    """
    extract = SiftExtractor(SiftOptions(max_features=_FEATURES))
    seen: dict[int, _Seen] = {}
    with progress_bar("features", len(rows)) as advance:
        for done, row in enumerate(rows, 1):
            found = _features(files[row], extract)
            if found is not None:
                seen[row] = found
            advance(done)
    wanted = _candidates(seen)
    pairs = []
    with progress_bar("matches", len(wanted)) as advance:
        for done, (a, b) in enumerate(wanted, 1):
            pair = _match(a, b, seen, cameras)
            if pair is not None:
                pairs.append(pair)
            advance(done)
    return pairs


def _features(file: Path, extract: SiftExtractor) -> _Seen | None:
    try:
        rgb = read_rgb(file)
    except InputError:
        return None  # the check of files has said so
    height, width = rgb.shape[:2]
    scale = min(1.0, WORKING_SIDE / max(height, width))
    small = rgb
    if scale < 1:
        size = (max(round(scale * width), 1), max(round(scale * height), 1))
        small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    features = extract(small)
    # Pixels count from the corner, so that sizes alone convert them.
    factor = np.array([width / small.shape[1], height / small.shape[0]])
    xy = features.xy.astype(np.float64) * factor
    return _Seen(xy, unit_descriptors(features.descriptors), max(height, width))


def _candidates(seen: dict[int, _Seen]) -> list[tuple[int, int]]:
    """Return the pairs to match: neighbours in order, and photographs that look alike."""
    rows = [row for row in seen if len(seen[row].xy) >= LEAST_MATCHES]
    if len(rows) < 2:
        return []
    described = [seen[row].unit.numpy() for row in rows]
    index = VladIndex.build(described)
    wanted = set()
    for k in range(len(rows)):
        successors = range(k + 1, min(k + 1 + _SUCCESSORS, len(rows)))
        alike = [int(j) for j in index.rank(described[k], _ALIKE + 1) if j != k][:_ALIKE]
        wanted |= {(min(k, j), max(k, j)) for j in (*successors, *alike)}
    return [(rows[a], rows[b]) for a, b in sorted(wanted)]


def _match(a: int, b: int, seen: dict[int, _Seen], cameras: Sequence[Camera | None]) -> Pair | None:
    matches = match(seen[a].unit, seen[b].unit, _RATIO)
    if len(matches) < LEAST_MATCHES:
        return None
    xy_a, xy_b = seen[a].xy[matches[:, 0]], seen[b].xy[matches[:, 1]]
    threshold = _INLIER / 1000 * max(seen[a].side, seen[b].side)
    flat_a, flat_b = straight(xy_a, cameras[a]), straight(xy_b, cameras[b])
    try:
        _, mask = cv2.findFundamentalMat(flat_a, flat_b, cv2.USAC_MAGSAC, threshold, 0.999, 5000)
    except cv2.error:  # of matches to which no geometry fits, it fails an assertion of its own
        return None
    if mask is None or int(mask.sum()) < LEAST_MATCHES:
        return None
    kept = mask.ravel().astype(bool)
    return Pair(a, b, xy_a[kept], xy_b[kept])


def straight(xy: Array, camera: Camera | None) -> Array:
    """Return pixels (K, 2) without the distortion of a camera."""
    if camera is None or not any(camera.distortion):
        return xy
    rays, _ = camera.unproject(torch.from_numpy(xy))
    focal, principal = torch.tensor(camera.focal), torch.tensor(camera.principal)
    return np.asarray((rays[:, :2] * focal + principal).numpy(), np.float64)
