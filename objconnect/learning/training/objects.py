"""The true objects in the images of a training pair."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

GROUND: Final = -1
"""The label of pixels without an object."""
UNKNOWN: Final = -2
"""The label of pixels without a loss: outside the photograph, or of objects that are not detected,
such as fences."""


class PairObjects(NamedTuple):
    """The n objects in one image of a pair.

    Attributes:
        labels: (S, S) int32 row of the object of each pixel, ``GROUND`` or ``UNKNOWN``.
        ids: (n,) int64; an object has the same id in all images.
        centres: (n, 2) projected centres of the objects' boxes, pixels; they may be outside the
            image.
        sides: (n,) side of a square of the area of the box seen from above, pixels.
        rises: (n,) height of the box's centre above its foot, converted to pixels at its depth.
        pixels: (n,) number of visible pixels.
    """

    labels: NDArray[np.int32]
    ids: NDArray[np.int64]
    centres: NDArray[np.float32]
    sides: NDArray[np.float32]
    rises: NDArray[np.float32]
    pixels: NDArray[np.int64]


class ImageObjects(NamedTuple):
    """``PairObjects`` as tensors."""

    labels: Tensor
    ids: Tensor
    centres: Tensor
    sides: Tensor
    rises: Tensor
    pixels: Tensor

    def to(self, device: torch.device) -> ImageObjects:
        """Return the objects on another device."""
        return ImageObjects(*(each.to(device) for each in self))

    @staticmethod
    def of(objects: PairObjects) -> ImageObjects:
        """Return the objects of an image as tensors."""
        return ImageObjects(*(torch.from_numpy(each) for each in objects))
