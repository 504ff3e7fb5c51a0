"""Photographs that a map is built from: with a known pose, or without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scene.geometry.camera import Camera


@dataclass(frozen=True)
class PosedImage:
    """A photograph with a known pose: what triangulation starts from."""

    name: str
    camera: Camera
    cam_from_world: NDArray[np.float64]


@dataclass(frozen=True)
class Photograph:
    """A photograph whose pose nobody knows: what structure from motion of a flight starts from.

    Attributes:
        name: path relative to the folder of all images.
        camera: its calibration, or a first guess of it.
        lens: photographs of one lens share one camera, and it is refined from all of them.
        calibrated: the camera is right, and stays as it is.
        focal_known: the guess of the focal length was measured, as EXIF says it.
    """

    name: str
    camera: Camera
    lens: str
    calibrated: bool = False
    focal_known: bool = False
