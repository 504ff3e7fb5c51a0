"""A downscaled greyscale photograph of a map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose


@dataclass(frozen=True)
class GreyPhotograph:
    """A downscaled greyscale photograph of a map.

    Attributes:
        grey: (H, W) float32.
        camera: camera of the downscaled photograph.
        pose: ``cam_from_world``.
        in_photograph: maps its pixels (N, 2) to those of the original.
    """

    grey: Tensor
    camera: Camera
    pose: Pose
    in_photograph: Callable[[NDArray[np.float64]], NDArray[np.float64]]

    def downscale(self, factor: int) -> GreyPhotograph:
        """Return the photograph downscaled by a factor, without updating ``in_photograph``.

        It is cropped at the right and lower edge to a multiple of the factor.
        """
        height, width = (side // factor * factor for side in self.grey.shape)
        size = (width // factor, height // factor)
        small = cv2.resize(self.grey.numpy()[:height, :width], size, interpolation=cv2.INTER_AREA)
        camera = replace(self.camera, width=width, height=height).resize(*size)
        return replace(self, grey=torch.from_numpy(small), camera=camera)

    @property
    def nbytes(self) -> int:
        """Return the bytes of its values."""
        return self.grey.nbytes
