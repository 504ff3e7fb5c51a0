"""Measure the coverage of masks by points, for scenes without ground truth of objects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.network.segmentation import NOTHING, Labels
from objconnect.scene.bundle.manifest import size_class
from objconnect.scene.bundle.object_points import ObjectCoverage
from objconnect.scene.errors import InputError
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

# The depth of a mask is the median over this many observations, those nearest to its centre.
_NEIGHBOURS = 8


def mask_coverage(
    sparse_map: SparseMap, masks: Mapping[str, Labels], kept: NDArray[np.bool_]
) -> dict[str, ObjectCoverage]:
    """Count masks with and without a point, by the size class of the objects that they show.

    Each mask of each photograph is counted once. Its points are those observed inside it. Its size
    is the longer side of its bounding box at the median depth of the observations around it.

    Args:
        sparse_map: map of the photographs.
        masks: label maps (H, W) by photograph.
        kept: (M,) bool, which points are counted.

    Raises:
        InputError: the size of a mask differs from that of its photograph.
    """
    counts: dict[str, list[int]] = {}
    for name, labels in masks.items():
        image = sparse_map.images[name]
        check_size(labels, image)
        is_observed = image.point_rows >= 0
        points_in = points_by_label(labels, image, kept)
        xy, rows = image.xy[is_observed], image.point_rows[is_observed]
        depth = image.pose.transform(torch.from_numpy(sparse_map.xyz[rows]))[:, 2].numpy()
        for label in np.unique(labels[labels != NOTHING]).tolist():
            if not len(depth):
                continue  # without points, the distance is not known
            row, column = np.nonzero(labels == label)
            middle = column.mean() + 0.5, row.mean() + 0.5
            nearest = np.argsort(np.square(xy - middle).sum(1), kind="stable")[:_NEIGHBOURS]
            longest = max(np.ptp(row), np.ptp(column)) + 1
            metres = float(longest * np.median(depth[nearest]) / min(image.camera.focal))
            counts.setdefault(size_class((metres, 0, 0)), []).append(points_in.get(label, 0))
    return {
        size: ObjectCoverage(len(points), sum(count > 0 for count in points), sum(points))
        for size, points in sorted(counts.items())
    }


def points_by_label(labels: Labels, image: MapImage, kept: NDArray[np.bool_]) -> dict[int, int]:
    """Return the number of kept points that a photograph observes in each mask, by label."""
    is_observed = image.point_rows >= 0
    is_observed[is_observed] = kept[image.point_rows[is_observed]]
    column, row = np.floor(image.xy[is_observed]).astype(int).T
    height, width = labels.shape
    observed = labels[row.clip(0, height - 1), column.clip(0, width - 1)]
    values, counts = np.unique(observed[observed != NOTHING], return_counts=True)
    return dict(zip(values.tolist(), counts.tolist(), strict=True))


def check_size(labels: Labels, image: MapImage) -> None:
    """Check that masks have the size of their photograph.

    Raises:
        InputError: the sizes differ.
    """
    expected = (image.camera.height, image.camera.width)
    if labels.shape != expected:
        raise InputError(
            f"the masks of {image.name} are {labels.shape[1]} x {labels.shape[0]} pixels, the "
            f"photograph {expected[1]} x {expected[0]}: resize them by nearest neighbour"
        )
