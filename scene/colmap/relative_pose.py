"""How one camera stands to another, from 2D-2D matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from scene.colmap.native import native_camera, pose_from_native
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose


@dataclass(frozen=True)
class RelativePose:
    """How one camera stands to another, as far as 2D-2D matches tell.

    Attributes:
        b_from_a: its translation has length one: how far apart the cameras are stays unknown.
        inliers: (N,) bool.
    """

    b_from_a: Pose
    inliers: NDArray[np.bool_]


def estimate_relative_pose(
    xy_a: NDArray[np.float64],
    xy_b: NDArray[np.float64],
    camera_a: Camera,
    camera_b: Camera,
    max_error: float,
    seed: int = 0,
) -> RelativePose | None:
    """Essential matrix by LO-RANSAC, decomposed and refined; None when none has support.

    Args:
        xy_a: (N, 2) pixels of the matches in one picture.
        xy_b: (N, 2) and in the other.
        camera_a: of the one.
        camera_b: of the other.
        max_error: inlier threshold of the Sampson error, pixels.
        seed: of the sampling; the same seed gives the same pose.
    """
    options = pycolmap.RANSACOptions(max_error=max_error, random_seed=seed)
    a, b = native_camera(camera_a), native_camera(camera_b)
    answer = pycolmap.estimate_relative_pose(a, xy_a, b, xy_b, options)
    if answer is None:
        return None
    inliers = np.asarray(answer["inlier_mask"], bool)
    native = answer["cam2_from_cam1"]
    refined = pycolmap.refine_relative_pose(native, a, xy_a, b, xy_b, inliers)
    if refined is not None:
        native = refined["cam2_from_cam1"]
    pose = pose_from_native(native)
    length = pose.translation.norm()
    if not bool(length > 0) or not bool(pose.matrix().isfinite().all()):
        return None
    return RelativePose(Pose(pose.rotation, pose.translation / length), inliers)
