"""True objects in a crop of a rendered frame, from its instance layer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.learning.training.crops import Crop
from objconnect.learning.training.objects import GROUND, UNKNOWN, PairObjects
from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.geometry.views import from_pixel_centres

# Classes of long objects, of which photographs show parts, and the largest side of other objects.
LINES: Final = frozenset({"wire", "fence", "hedge"})
LARGEST_M: Final = 40.0
_BEYOND: Final = 65535


def objects_of(
    instances: NDArray[np.uint16],
    cut: Crop,
    crop_from_world: NDArray[np.float64],
    objects: Mapping[int, SceneObject],
    first_id: int,
) -> PairObjects:
    """Return the objects in a crop of a frame.

    Args:
        instances: (H, W) ids of the frame's pixels, 0 for none.
        cut: the crop.
        crop_from_world: (4, 4) pose of the crop's camera.
        objects: objects of the scene by id.
        first_id: offset of the ids, which makes those of several scenes differ.
    """
    size = cut.image.shape[1], cut.image.shape[0]
    moved = from_pixel_centres(cut.affine)
    turned = cv2.warpAffine(instances, moved, size, flags=cv2.INTER_NEAREST, borderValue=_BEYOND)
    labels = np.full(turned.shape, GROUND, np.int32)
    labels[turned == _BEYOND] = UNKNOWN
    rows: list[tuple[float, ...]] = []
    ids: list[int] = []
    for number, pixels in zip(*np.unique(turned, return_counts=True), strict=True):
        if number in (0, _BEYOND):
            continue
        item = objects.get(int(number))
        if item is None or item.class_name in LINES or max(item.size[:2]) > LARGEST_M:
            labels[turned == number] = UNKNOWN
            continue
        middle = crop_from_world[:3, :3] @ np.array(item.centre) + crop_from_world[:3, 3]
        xy = cut.camera.project(middle[None])[0]
        per_metre = float(np.mean(cut.camera.focal)) / middle[2]
        side = np.sqrt(item.size[0] * item.size[1]) * per_metre
        labels[turned == number] = len(ids)
        ids.append(first_id + item.id)
        rows.append((*xy, side, item.size[2] / 2 * per_metre, float(pixels)))
    table = np.array(rows, np.float64).reshape(-1, 5)
    single = table.astype(np.float32)
    count = table[:, 4].astype(np.int64)
    return PairObjects(
        labels, np.array(ids, np.int64), single[:, :2], single[:, 2], single[:, 3], count
    )
