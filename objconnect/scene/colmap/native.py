"""Set-up of pycolmap 4.2, shared constants, and conversion of cameras and poses."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose

# Progress bars and error messages replace COLMAP's log. Logging to standard error avoids log files
# in the system's temporary folder.
pycolmap.logging.minloglevel = pycolmap.logging.FATAL
pycolmap.logging.logtostderr = True

PYCOLMAP_VERSION: str = pycolmap.__version__
Progress = Callable[[int], None]
"""A function that receives the number of steps done."""

SEED = 0
"""Random seed of COLMAP: the same photographs make the same map."""

LEAST_VARIANCE = 0.01
"""Smallest plausible variance of a pixel coordinate (px^2)."""

MIN_FREE_BYTES = 64 << 20
"""Free disk space required before a step (bytes), because COLMAP ends the process on a full disk.
A chunk of pairs with SQLite's journal takes less."""


def _restore_sigterm() -> None:
    """Restore Python's handler of SIGTERM.

    Importing pycolmap installs a handler that prints a native stack and ends the process without
    clean-up.
    """
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGTERM)
        if handler is not None:  # None means a handler not installed from Python
            signal.signal(signal.SIGTERM, handler)


_restore_sigterm()


def native_camera(camera: Camera, camera_id: int = 1) -> pycolmap.Camera:
    """Convert a camera of known calibration to pycolmap."""
    return pycolmap.Camera(
        model=camera.model,
        width=camera.width,
        height=camera.height,
        params=list(camera.params),
        camera_id=camera_id,
        # Verification then uses an essential matrix, a stronger test than a fundamental matrix.
        has_prior_focal_length=True,
    )


def pose_from_native(native: pycolmap.Rigid3d) -> Pose:
    """Convert a pose of pycolmap."""
    return Pose.from_matrix(np.vstack([native.matrix(), [0, 0, 0, 1]]))


def native_pose(cam_from_world: NDArray[np.float64]) -> pycolmap.Rigid3d:
    """Convert ``cam_from_world`` (4, 4) to pycolmap."""
    return pycolmap.Rigid3d(np.ascontiguousarray(cam_from_world[:3]))
