"""The set-up of pycolmap, and the conversion of cameras and poses, for all modules of this package.

It is written for pycolmap 4.2.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose

# COLMAP logs every step, but our progress bar and error messages take the place of its log. Logging
# to standard error keeps it from leaving log files in the system's temporary folder.
pycolmap.logging.minloglevel = pycolmap.logging.FATAL
pycolmap.logging.logtostderr = True

VERSION: str = pycolmap.__version__
Progress = Callable[[int], None]
"""A function that is called with the number of steps done."""

SEED = 0
"""The seed of every random choice of COLMAP: the same photographs make the same map."""

LEAST_VARIANCE = 0.01
"""The smallest variance of a pixel coordinate (px^2); smaller measured ones are implausible."""

ROOM = 64 << 20
"""Free disk space required before a step (bytes), because COLMAP ends the process on a full disk.
A chunk of pairs with its journal takes less."""


def _take_back_sigterm() -> None:
    """Restore Python's handler of SIGTERM.

    Importing pycolmap installs a handler of its logger, which prints a native stack and ends the
    process at once, without any clean-up.
    """
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGTERM)
        if handler is not None:  # None means a handler not installed from Python
            signal.signal(signal.SIGTERM, handler)


_take_back_sigterm()


def native_camera(camera: Camera, camera_id: int = 1) -> pycolmap.Camera:
    """Convert a camera of known calibration to pycolmap."""
    return pycolmap.Camera(
        model=camera.model,
        width=camera.width,
        height=camera.height,
        params=list(camera.params),
        camera_id=camera_id,
        # Verification then estimates an essential matrix, a stronger test than a fundamental one.
        has_prior_focal_length=True,
    )


def pose_from_native(native: pycolmap.Rigid3d) -> Pose:
    """Convert a pose of pycolmap."""
    return Pose.from_matrix(np.vstack([native.matrix(), [0, 0, 0, 1]]))


def native_pose(cam_from_world: NDArray[np.float64]) -> pycolmap.Rigid3d:
    """Convert ``cam_from_world`` (4, 4) to pycolmap, by the matrix: its quaternions are x y z w."""
    return pycolmap.Rigid3d(np.ascontiguousarray(cam_from_world[:3]))
