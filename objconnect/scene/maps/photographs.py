"""Photographs that a map is built from, with or without a known pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera


@dataclass(frozen=True)
class PosedImage:
    """A photograph with a known pose, as triangulation needs it.

    Attributes:
        name: path relative to the folder of all images.
        camera: calibrated camera.
        cam_from_world: (4, 4) float64.
    """

    name: str
    camera: Camera
    cam_from_world: NDArray[np.float64]


@dataclass(frozen=True)
class Photograph:
    """A photograph without a known pose, as structure from motion takes it.

    Attributes:
        name: path relative to the folder of all images.
        camera: calibration, or a first guess of it.
        lens: name of the lens; photographs of one lens share one camera.
        calibrated: whether ``camera`` is exact and must not be refined.
        focal_known: whether the focal length of ``camera`` is known, for example from EXIF.
        focal_doubt: what is unreliable or contradictory in the focal length of EXIF and XMP; empty
            if it is known or if no field states it.
    """

    name: str
    camera: Camera
    lens: str
    calibrated: bool = False
    focal_known: bool = False
    focal_doubt: str = ""
