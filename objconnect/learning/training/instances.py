"""Ground-truth objects in a crop of a rendered frame, from the object id of each pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.learning.training.crops import Crop
from objconnect.learning.training.objects import GROUND, UNKNOWN, PairObjects
from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.geometry.views import opencv_affine

LINE_CLASSES: Final = frozenset({"wire", "fence", "hedge"})
"""Classes of long objects. They are not detected, because photographs show only parts of them."""
MAX_SIDE_M: Final = 40.0
"""Largest horizontal side of objects of other classes that are detected, metres."""
# Id of pixels outside the photograph.
_OUTSIDE: Final = 65535


def objects_of(
    instances: NDArray[np.uint16],
    crop: Crop,
    crop_from_world: NDArray[np.float64],
    objects: Mapping[int, SceneObject],
    first_id: int,
) -> PairObjects:
    """Return the objects in a crop of a frame.

    Args:
        instances: (H, W) ids of the frame's pixels, 0 for none.
        crop: the crop.
        crop_from_world: (4, 4) pose of the crop's camera.
        objects: objects of the scene by id.
        first_id: offset of the ids, so that ids of several scenes differ.
    """
    size = crop.image.shape[1], crop.image.shape[0]
    affine = opencv_affine(crop.affine)
    crop_ids = cv2.warpAffine(
        instances, affine, size, flags=cv2.INTER_NEAREST, borderValue=_OUTSIDE
    )
    labels = np.full(crop_ids.shape, GROUND, np.int32)
    labels[crop_ids == _OUTSIDE] = UNKNOWN
    rows: list[tuple[float, ...]] = []
    ids: list[int] = []
    for number, pixels in zip(*np.unique(crop_ids, return_counts=True), strict=True):
        if number in (0, _OUTSIDE):
            continue
        item = objects.get(int(number))
        if item is None or item.class_name in LINE_CLASSES or max(item.size[:2]) > MAX_SIDE_M:
            labels[crop_ids == number] = UNKNOWN
            continue
        middle = crop_from_world[:3, :3] @ np.array(item.centre) + crop_from_world[:3, 3]
        xy = crop.camera.project(middle[None])[0]
        pixels_per_metre = float(np.mean(crop.camera.focal)) / middle[2]
        side = np.sqrt(item.size[0] * item.size[1]) * pixels_per_metre
        labels[crop_ids == number] = len(ids)
        ids.append(first_id + item.id)
        rows.append((*xy, side, item.size[2] / 2 * pixels_per_metre, float(pixels)))
    table = np.array(rows, np.float64).reshape(-1, 5)
    single = table.astype(np.float32)
    count = table[:, 4].astype(np.int64)
    return PairObjects(
        labels, np.array(ids, np.int64), single[:, :2], single[:, 2], single[:, 3], count
    )
