"""Find the objects of a place that can change the picture of a camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulate.camera.pinhole import PinholeCamera
from simulate.place.world import WorldObject

REACH_M = 200.0
"""Maximum distance (m) from the view at which reflected light of objects is considered."""


class Reach:
    """Finds the objects that are in a camera's view, or whose shadow or reflection may be.

    Args:
        objects: objects of a world.
        elevation: elevation of the sun, or of the moon at night, degrees.
    """

    def __init__(self, objects: Sequence[WorldObject], elevation: float) -> None:
        self._centres = np.array([item.centre for item in objects]).reshape(-1, 3)
        sizes = np.array([item.size for item in objects]).reshape(-1, 3)
        shadows = sizes[:, 2] / np.tan(np.radians(max(elevation, 1.0)))
        self._reach = 0.5 * np.linalg.norm(sizes, axis=1) + shadows + REACH_M

    def __call__(
        self, camera: PinholeCamera, cam_from_world: NDArray[np.float64], travel_m: float
    ) -> NDArray[np.bool_]:
        """Return the mask (N,) of objects that a frame needs.

        Args:
            camera: the pinhole camera.
            cam_from_world: pose (4, 4).
            travel_m: displacement of the camera while the picture is read out, metres.
        """
        inside = depth_inside(self._centres, camera, cam_from_world)
        return np.asarray(inside > -(self._reach + travel_m))


def depth_inside(
    points: NDArray[np.float64], camera: PinholeCamera, cam_from_world: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how far points (N, 3) lie inside a camera's view, (N,) metres; negative outside."""
    # Inward normals of the four sides of the view, in camera coordinates.
    planes = np.array(
        [
            [camera.f, 0.0, camera.cx],
            [-camera.f, 0.0, camera.width - camera.cx],
            [0.0, camera.f, camera.cy],
            [0.0, -camera.f, camera.height - camera.cy],
        ]
    )
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    local = points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    return np.asarray((local @ planes.T).min(1))
