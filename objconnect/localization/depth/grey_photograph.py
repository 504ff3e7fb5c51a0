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
        grey: (H, W) float32 grey levels, 0 to 255.
        camera: camera of the downscaled photograph.
        pose: ``cam_from_world``.
        in_photograph: maps pixels (N, 2) of the downscaled photograph to those of the original.
    """

    grey: Tensor
    camera: Camera
    pose: Pose
    in_photograph: Callable[[NDArray[np.float64]], NDArray[np.float64]]

    def downscale(self, factor: int) -> GreyPhotograph:
        """Return the photograph downscaled by a factor.

        It is cropped at the right and lower edge to a multiple of the factor. ``in_photograph`` is
        not updated, so it must not be used on the result.
        """
        height, width = (side // factor * factor for side in self.grey.shape)
        size = (width // factor, height // factor)
        small = cv2.resize(self.grey.numpy()[:height, :width], size, interpolation=cv2.INTER_AREA)
        camera = replace(self.camera, width=width, height=height).resize(*size)
        return replace(self, grey=torch.from_numpy(small), camera=camera)

    @property
    def nbytes(self) -> int:
        """Return the bytes of the grey levels."""
        return self.grey.nbytes
