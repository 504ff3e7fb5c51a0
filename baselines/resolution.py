"""Metres of ground per pixel: features know a place again at about the size they first saw it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.maps.sparse_map import MapImage, SparseMap

# Views whose resolutions differ by less are compared as they are: networks bear that, and streets
# have no one resolution.
_ALIKE: Final = 1.25
_LEAST_POINTS: Final = 10


def metres_per_pixel(pose: Pose, camera: Camera, xyz: NDArray[np.float64]) -> float:
    """Of a photograph, in the middle of the points it shows; NaN where these are too few.

    Args:
        pose: ``cam_from_world``.
        camera: of the photograph.
        xyz: (N, 3) points that may be in view.
    """
    in_camera = pose.transform(torch.from_numpy(xyz))
    projected = camera.project(in_camera)
    shown = projected.valid & camera.contains(projected.xy)
    if int(shown.sum()) < _LEAST_POINTS:
        return math.nan
    return float(in_camera[shown, 2].median()) / float(np.mean(camera.focal))


def of_map(sparse_map: SparseMap, shrunk: Callable[[Camera], float]) -> float:
    """Metres per pixel at which most photographs of a map are seen; NaN if not known.

    Args:
        sparse_map: whose photographs.
        shrunk: pixels seen per pixel of a camera's photographs.
    """
    found = [
        metres_per_pixel(image.pose, image.camera, observed(image, sparse_map))
        / shrunk(image.camera)
        for image in sparse_map.images.values()
    ]
    known = [each for each in found if math.isfinite(each)]
    return float(np.median(known)) if known else math.nan


def observed(image: MapImage, sparse_map: SparseMap) -> NDArray[np.float64]:
    """The points that a photograph of a map observes, (N, 3)."""
    return np.asarray(sparse_map.xyz[np.unique(image.point_rows[image.point_rows >= 0])])


def scale_to(wanted: float, own: float, largest: float) -> float:
    """At which scale to look at a photograph.

    Args:
        wanted: metres per pixel of the view.
        own: of the photograph; either may be NaN, not known.
        largest: scale; beyond 1 it is used only to reach ``wanted``.
    """
    plain = min(1.0, largest)
    matching = own / wanted
    if math.isfinite(matching) and not 1 / _ALIKE < matching / plain < _ALIKE:
        return min(matching, largest)
    return plain
