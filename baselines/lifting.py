"""3D points of keypoints in photographs of the map, from the map points seen in them."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from scene.maps.sparse_map import MapImage

# A keypoint is an observation of the map when it lies within this distance of it (px).
_SAME = 1.0
# A plane goes through so many observations around a keypoint; three would fit anything.
_NEIGHBOURS = 6
# The farthest of them is at most so far from the keypoint, as a share of the picture's width.
_REACH = 0.1
# Their depths differ from the plane's by at most so much (rms, relative).
_ROUGH = 0.01
# The plane goes on past the nearest and the farthest of them by so much (relative).
_BEYOND = 0.02


def observed_points(xy: NDArray[np.float32], image: MapImage) -> NDArray[np.int64]:
    """The map point observed at each keypoint, -1 where the map has none there. (N,).

    For keypoints that the map was built from.

    Args:
        xy: (N, 2) COLMAP pixels.
        image: the photograph they lie in.
    """
    seen = image.point_rows >= 0
    rows = np.full(len(xy), -1, np.int64)
    if not seen.any() or not len(rows):
        return rows
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    observed = image.xy[seen].astype(np.float32)
    for hit in matcher.match(xy, observed):
        if hit.distance <= _SAME:
            rows[hit.queryIdx] = image.point_rows[seen][hit.trainIdx]
    return rows


def interpolated_points(
    xy: NDArray[np.float32], image: MapImage, xyz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """World points (N, 3) on the rays of keypoints, NaN where the map does not say how far.

    A plane in space has an inverse depth that is affine over the rays, so that a plane through the
    observations around a keypoint is a linear fit. It is refused where they do not lie in a plane,
    are too far away, or the keypoint's depth is not among theirs.

    Args:
        xy: (N, 2) COLMAP pixels.
        image: the photograph they lie in.
        xyz: (M, 3) points of the map, world metres.
    """
    points = np.full((len(xy), 3), np.nan)
    seen = image.point_rows >= 0
    local = image.pose.transform(torch.from_numpy(xyz[image.point_rows[seen]]))
    in_front = local[:, 2] > 0
    inverse = 1 / local[in_front, 2]
    if not len(xy) or len(inverse) < _NEIGHBOURS:
        return points
    observed = torch.from_numpy(image.xy[seen])[in_front]
    keypoints = torch.from_numpy(xy.astype(np.float64))
    rays, valid = image.camera.unproject(keypoints)
    at_observed, observed_valid = image.camera.unproject(observed)
    distance, near = torch.cdist(keypoints, observed).topk(_NEIGHBOURS, largest=False)
    # Around the keypoint, so that the plane's value there is its constant.
    offset = (at_observed[near] - rays[:, None])[..., :2]
    design = torch.cat([offset, torch.ones_like(offset[..., :1])], -1)
    depths = inverse[near]
    # Nearer observations say more; the least distance keeps one of them from saying all.
    weight = 1 / (distance + _SAME)[..., None]
    plane = torch.linalg.lstsq(weight * design, weight * depths[..., None]).solution
    residual = ((design @ plane)[..., 0] / depths - 1).square().mean(-1).sqrt()
    value = plane[:, 2, 0]
    kept = valid & observed_valid[near].all(-1) & (residual < _ROUGH)
    kept &= distance[:, -1] < _REACH * image.camera.width
    kept &= value > depths.amin(-1) * (1 - _BEYOND)
    kept &= value < depths.amax(-1) * (1 + _BEYOND)
    world = image.pose.inverse().transform(rays[kept] / value[kept, None])
    points[kept.numpy()] = world.numpy()
    return points
