"""What every module of this package shares: pycolmap set up, cameras and poses converted.

Written for pycolmap 4.2.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable

import numpy as np
import pycolmap
from numpy.typing import NDArray

from scene.geometry.camera import Camera
from scene.geometry.pose import Pose

# COLMAP logs every step; a person reads our progress bar and our one line instead. What would be
# logged goes to standard error, for it leaves log files in the system's folder otherwise.
pycolmap.logging.minloglevel = pycolmap.logging.FATAL
pycolmap.logging.logtostderr = True

VERSION: str = pycolmap.__version__
Progress = Callable[[int], None]


# Every random choice of COLMAP is seeded: the same photographs make the same map.
SEED = 0


# Matches whose residuals say nothing, or too little to be true, are taken to be this exact (px^2).
LEAST_VARIANCE = 0.01


# COLMAP's refinement has a Cauchy loss, which at this scale (in standard deviations of the noise)
# loses 5 % against least squares where there are no outliers.
CAUCHY = 2.385


# COLMAP ends the process when the disk is full: a chunk of pairs with its journal takes less (B).
ROOM = 64 << 20


def _take_back_sigterm() -> None:
    """Importing pycolmap puts a handler of its logger in the place of Python's, which prints a
    native stack and ends the process at once: nothing would be cleaned up."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGTERM)
        if handler is not None:  # None: not installed from Python
            signal.signal(signal.SIGTERM, handler)


_take_back_sigterm()


def native_camera(camera: Camera, camera_id: int = 1) -> pycolmap.Camera:
    """A camera of known calibration as pycolmap has it."""
    return pycolmap.Camera(
        model=camera.model,
        width=camera.width,
        height=camera.height,
        params=list(camera.params),
        camera_id=camera_id,
        # Verification then finds an essential matrix, which forgives far less than a fundamental.
        has_prior_focal_length=True,
    )


def pose_from_native(native: pycolmap.Rigid3d) -> Pose:
    """A pose of pycolmap's as ours."""
    return Pose.from_matrix(np.vstack([native.matrix(), [0, 0, 0, 1]]))


def native_pose(cam_from_world: NDArray[np.float64]) -> pycolmap.Rigid3d:
    """pycolmap holds quaternions x y z w; going through the matrix needs no order at all."""
    return pycolmap.Rigid3d(np.ascontiguousarray(cam_from_world[:3]))
