"""The relative pose of two cameras from 2D-2D matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.native import native_camera, pose_from_native
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose


@dataclass(frozen=True)
class RelativePose:
    """A relative pose estimated from 2D-2D matches.

    Attributes:
        b_from_a: pose with a translation of length one, because the baseline is unknown.
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
    """Estimate an essential matrix by LO-RANSAC, decompose and refine it; None without support.

    Args:
        xy_a: pixels of the matches in image a, (N, 2).
        xy_b: pixels of the matches in image b, (N, 2).
        camera_a: camera of image a.
        camera_b: camera of image b.
        max_error: inlier threshold of the Sampson error, pixels.
        seed: random seed of the sampling; the same seed gives the same pose.
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
