"""3D points of keypoints in a map's photographs, from the photographs' observed map points."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.maps.sparse_map import MapImage

# Largest distance (px) at which a keypoint and an observation of the map are the same.
_SAME_PX: Final = 1.0
# Number of observations to which a plane is fitted around a keypoint. A plane fits any three.
_NEIGHBOURS: Final = 6
# Largest distance of these observations from the keypoint, as a share of the picture's width,
# because surfaces are planar only locally.
_MAX_DISTANCE: Final = 0.1
# Largest relative difference (rms) between the inverse depths of the observations and the plane.
_MAX_ROUGHNESS: Final = 0.01
# Share by which the keypoint's inverse depth may lie outside the range of the observations'.
_DEPTH_MARGIN: Final = 0.02


def find_observations(xy: NDArray[np.float32], image: MapImage) -> NDArray[np.int64]:
    """Return the row of the map point observed at each keypoint, (N,); -1 for none.

    Observations lie at keypoints only if the map was built from these keypoints.

    Args:
        xy: (N, 2) COLMAP pixels.
        image: the photograph of the keypoints.
    """
    seen = image.point_rows >= 0
    rows = np.full(len(xy), -1, np.int64)
    if not seen.any() or not len(rows):
        return rows
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    observed = image.xy[seen].astype(np.float32)
    for hit in matcher.match(xy, observed):
        if hit.distance <= _SAME_PX:
            rows[hit.queryIdx] = image.point_rows[seen][hit.trainIdx]
    return rows


def interpolate_points(
    xy: NDArray[np.float32], image: MapImage, xyz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return world points (N, 3) on the rays of keypoints, metres; NaN where the depth is unknown.

    The inverse depth of a plane is affine in the coordinates of the rays, so a plane through the
    observations around a keypoint is a linear fit. It is rejected if the observations do not lie in
    a plane or are too far from the keypoint, or if the keypoint's depth is outside the range of the
    observations' depths.

    Args:
        xy: (N, 2) COLMAP pixels.
        image: the photograph of the keypoints.
        xyz: (M, 3) points of the map, world metres.
    """
    points = np.full((len(xy), 3), np.nan)
    seen = image.point_rows >= 0
    in_camera = image.pose.transform(torch.from_numpy(xyz[image.point_rows[seen]]))
    in_front = in_camera[:, 2] > 0
    inverse_depth = 1 / in_camera[in_front, 2]
    if not len(xy) or len(inverse_depth) < _NEIGHBOURS:
        return points
    observed = torch.from_numpy(image.xy[seen])[in_front]
    keypoints = torch.from_numpy(xy.astype(np.float64))
    rays, valid = image.camera.unproject(keypoints)
    observed_rays, observed_valid = image.camera.unproject(observed)
    distance, near = torch.cdist(keypoints, observed).topk(_NEIGHBOURS, largest=False)
    # Offsets are relative to the keypoint, so that the plane's constant is its value there.
    offset = (observed_rays[near] - rays[:, None])[..., :2]
    design = torch.cat([offset, torch.ones_like(offset[..., :1])], -1)
    near_depths = inverse_depth[near]
    # Nearer observations weigh more. The added distance keeps a single one from outweighing all.
    weight = 1 / (distance + _SAME_PX)[..., None]
    plane = torch.linalg.lstsq(weight * design, weight * near_depths[..., None]).solution
    residual = ((design @ plane)[..., 0] / near_depths - 1).square().mean(-1).sqrt()
    value = plane[:, 2, 0]
    kept = valid & observed_valid[near].all(-1) & (residual < _MAX_ROUGHNESS)
    kept &= distance[:, -1] < _MAX_DISTANCE * image.camera.width
    kept &= value > near_depths.amin(-1) * (1 - _DEPTH_MARGIN)
    kept &= value < near_depths.amax(-1) * (1 + _DEPTH_MARGIN)
    world = image.pose.inverse().transform(rays[kept] / value[kept, None])
    points[kept.numpy()] = world.numpy()
    return points
