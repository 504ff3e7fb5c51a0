"""Associate detections of the same object across photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.scene.maps.sparse_map import MapImage, SparseMap


@dataclass(frozen=True)
class Detections:
    """Detected centres of objects in one photograph.

    Attributes:
        xy: positions (K, 2), COLMAP pixels.
        descriptors: descriptors (K, D) of unit length.
        confidence: confidence (K,), 0 to 1.
    """

    xy: NDArray[np.float64]
    descriptors: NDArray[np.float32]
    confidence: NDArray[np.float64]


@dataclass(frozen=True)
class Pairs:
    """E mutually most similar pairs of detections in two photographs.

    Attributes:
        views: rows (E, 2) of the photographs, in the order of the map's names.
        rows: rows (E, 2) of the detections in their photographs.
    """

    views: NDArray[np.int64]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.views)


def associate(
    sparse_map: SparseMap, detections: Mapping[str, Detections], config: SupplementConfig
) -> Pairs:
    """Pair the detections of photographs that share map points.

    The detections of a pair lie near each other's epipolar lines, and each is the most similar one
    to the other.

    Args:
        sparse_map: map with the poses.
        detections: detections by name of the photograph.
        config: thresholds.
    """
    names = sparse_map.names
    views, rows = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2), np.int64)]
    for i, j in _pair_photographs(sparse_map, config.neighbours):
        if names[i] not in detections or names[j] not in detections:
            continue
        a, b = detections[names[i]], detections[names[j]]
        if not len(a.xy) or not len(b.xy):
            continue
        error_px = _epipolar_error(sparse_map.images[names[i]], a, sparse_map.images[names[j]], b)
        similarity = (a.descriptors @ b.descriptors.T).astype(np.float64)
        similarity[(error_px > config.epipolar_px) | (similarity < config.similarity)] = -np.inf
        best = similarity.argmax(1)
        mutual = np.flatnonzero(
            (similarity.max(1) > -np.inf) & (similarity.argmax(0)[best] == np.arange(len(best)))
        )
        views.append(np.tile([i, j], (len(mutual), 1)))
        rows.append(np.stack([mutual, best[mutual]], 1))
    return Pairs(np.concatenate(views), np.concatenate(rows))


def _pair_photographs(sparse_map: SparseMap, count: int) -> list[tuple[int, int]]:
    """Pair each photograph with those that share the most map points with it."""
    observed = [
        np.unique(image.point_rows[image.point_rows >= 0])
        for image in (sparse_map.images[name] for name in sparse_map.names)
    ]
    photograph = np.repeat(np.arange(len(observed)), [len(rows) for rows in observed])
    all_rows = np.concatenate(observed)
    chosen = set()
    for i, rows in enumerate(observed):
        is_observed = np.zeros(len(sparse_map.xyz), bool)
        is_observed[rows] = True
        shared = np.bincount(photograph[is_observed[all_rows]], minlength=len(observed))
        shared[i] = 0
        for j in np.argsort(-shared, kind="stable")[:count].tolist():
            if shared[j]:
                chosen.add((min(i, j), max(i, j)))
    return sorted(chosen)


def _epipolar_error(
    image_a: MapImage, a: Detections, image_b: MapImage, b: Detections
) -> NDArray[np.float64]:
    """Return the epipolar errors (A, B) of all pairs of detections, pixels.

    An error is the larger of two angles, each between a detection's ray and the epipolar plane of
    the other detection, in pixels at the middle of the picture. It is infinite where a pixel has no
    ray.
    """
    toward_a, toward_b = directions(image_a, a.xy), directions(image_b, b.xy)
    baseline = image_b.centre - image_a.centre
    volume = np.abs(np.cross(toward_a, baseline) @ toward_b.T)  # triple products, (A, B)
    with np.errstate(divide="ignore", invalid="ignore"):
        from_b = volume / np.linalg.norm(np.cross(baseline, toward_b), axis=1)[None, :]
        from_a = volume / np.linalg.norm(np.cross(baseline, toward_a), axis=1)[:, None]
    error_px = np.maximum(from_b * min(image_a.camera.focal), from_a * min(image_b.camera.focal))
    return np.where(np.isfinite(error_px), error_px, np.inf)


def directions(image: MapImage, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rays (K, 3) of pixels (K, 2), unit vectors in the world; NaN without a ray."""
    rays, valid = image.camera.unproject(torch.from_numpy(xy))
    world = torch.nn.functional.normalize(rays, dim=-1).numpy() @ image.cam_from_world[:3, :3]
    return np.where(valid.numpy()[:, None], world, np.nan)
