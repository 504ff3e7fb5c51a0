"""Ground resolution of photographs, and the scale that gives a photograph a target resolution."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

# Least number of points in view from which the resolution of a photograph is known.
_MIN_POINTS: Final = 10
# Sine of the least angle of the optical axis below the horizon. Flatter views, as from a car, show
# near and far things side by side and have no single resolution.
_MIN_DOWN_SINE: Final = math.sin(math.radians(20))
SAME_RESOLUTION: Final = 1.25
"""Ratio of resolutions below which photographs are not resized, because networks tolerate it."""


def metres_per_pixel(
    pose: Pose,
    camera: Camera,
    xyz: NDArray[np.float64],
    view_from_camera: NDArray[np.float64] | None = None,
) -> float:
    """Return the ground resolution (m/px) of a photograph at the median depth of points in view.

    It is NaN if too few points are in view, or if the camera looks nearly along the ground.

    Args:
        pose: ``cam_from_world``.
        camera: camera of the photograph.
        xyz: (N, 3) points that may be in view, world metres.
        view_from_camera: (3, 3) rotation to the levelled view of the photograph whose resolution is
            wanted; None if it is not levelled.
    """
    axis = np.array([0.0, 0.0, 1.0]) if view_from_camera is None else view_from_camera[2]
    if -float(axis @ pose.rotation.numpy()[:, 2]) < _MIN_DOWN_SINE:
        return math.nan
    in_camera = pose.transform(torch.from_numpy(xyz))
    projected = camera.project(in_camera)
    shown = projected.valid & camera.contains(projected.xy)
    if int(shown.sum()) < _MIN_POINTS:
        return math.nan
    depth = in_camera[shown] @ torch.from_numpy(np.asarray(axis, np.float64))
    return float(depth.median()) / float(np.mean(camera.focal))


def map_resolution(sparse_map: SparseMap, scale_of: Callable[[Camera], float]) -> float:
    """Return the median metres per pixel of a map's resized photographs; NaN if unknown.

    ``scale_of`` returns the scale to which photographs of a camera are resized.
    """
    resolutions = [
        metres_per_pixel(image.pose, image.camera, observed_xyz(image, sparse_map))
        / scale_of(image.camera)
        for image in sparse_map.images.values()
    ]
    known = [each for each in resolutions if math.isfinite(each)]
    return float(np.median(known)) if known else math.nan


def observed_xyz(image: MapImage, sparse_map: SparseMap) -> NDArray[np.float64]:
    """Return the points (N, 3) that a photograph of a map observes, world metres."""
    return np.asarray(sparse_map.xyz[np.unique(image.point_rows[image.point_rows >= 0])])


def scale_to(
    target: float, resolution: float, largest: float, same_resolution: float = SAME_RESOLUTION
) -> float:
    """Return the scale of a photograph that gives a target resolution.

    Args:
        target: metres per pixel of the result; NaN if unknown.
        resolution: metres per pixel of the photograph; NaN if unknown.
        largest: the largest scale. Scales above 1 are used only to reach ``target``.
        same_resolution: ratio of resolutions below which the photograph is not resized.

    Examples:
        >>> scale_to(target=0.2, resolution=0.1, largest=1.0)
        0.5
        >>> scale_to(target=0.11, resolution=0.1, largest=1.0)
        1.0
    """
    unmagnified = min(1.0, largest)
    matching = resolution / target
    if (
        math.isfinite(matching)
        and not 1 / same_resolution < matching / unmagnified < same_resolution
    ):
        return min(matching, largest)
    return unmagnified
