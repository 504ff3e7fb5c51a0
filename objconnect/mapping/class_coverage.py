"""Measure the share of each kind of surface in pixels, keypoints and map points.

In real photographs, a kind of surface has about the same share of keypoints as of pixels. Rendered
surfaces need enough texture for this; otherwise most map points would be on the ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES, FIRST_OBJECT_LABEL
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import SparseMap

KINDS = ("ground", "buildings", "vegetation", "other things")
"""Kinds of surfaces. The sky belongs to none."""


@dataclass(frozen=True)
class KindShare:
    """Shares (0 to 1) of a kind of surface in map photographs' pixels and keypoints, and points."""

    pixels: float
    keypoints: float
    points: float


def class_coverage(
    scene: Scene, sparse_map: SparseMap, features: Mapping[str, Features]
) -> dict[str, KindShare]:
    """Measure the share of each of ``KINDS``.

    A keypoint has the kind of its pixel, and a point the most frequent kind of its observations.

    Args:
        scene: scene with semantic images, which give the class of each pixel.
        sparse_map: map of the scene.
        features: features of the map's photographs, by name.

    Raises:
        InputError: a session is missing or damaged.
    """
    kind_of = _kind_of_label()
    pixels, keypoints = np.zeros(len(KINDS) + 1), np.zeros(len(KINDS) + 1)
    votes = np.zeros((len(sparse_map.xyz), len(KINDS) + 1))
    for session in scene.sessions:
        with scene.layers(session) as layers:
            for k, name in enumerate(scene.frames(session).names):
                if name not in features:
                    continue
                kind = kind_of[layers.read("semantic", k)]
                pixels += np.bincount(kind.ravel(), minlength=len(pixels))
                keypoints += np.bincount(_values_at(kind, features[name].xy), minlength=len(pixels))
                if name in sparse_map.images:
                    image = sparse_map.images[name]
                    is_observed = image.point_rows >= 0
                    np.add.at(
                        votes,
                        (image.point_rows[is_observed], _values_at(kind, image.xy[is_observed])),
                        1,
                    )
    points = np.bincount(votes.argmax(1), minlength=len(pixels))
    shares = [counts[:-1] / max(counts[:-1].sum(), 1) for counts in (pixels, keypoints, points)]
    return {name: KindShare(*(float(share[k]) for share in shares)) for k, name in enumerate(KINDS)}


def _kind_of_label() -> NDArray[np.int64]:
    """Return the index into KINDS by semantic label; the sky has the index after the last."""
    kind = np.full(256, KINDS.index("other things"))
    kind[:FIRST_OBJECT_LABEL] = KINDS.index("ground")
    kind[CLASSES["sky"]] = len(KINDS)
    kind[CLASSES["building"]] = KINDS.index("buildings")
    kind[[CLASSES["tree"], CLASSES["hedge"]]] = KINDS.index("vegetation")
    return kind


def _values_at(kind: NDArray[np.int64], xy: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
    """Return the values of a raster (H, W) at COLMAP pixels (N, 2)."""
    column, row = np.floor(xy).astype(int).T
    height, width = kind.shape
    return np.asarray(kind[row.clip(0, height - 1), column.clip(0, width - 1)])
