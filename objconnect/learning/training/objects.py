"""The true objects that the images of a training pair show."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

GROUND: Final = -1
"""The label of pixels that show no object."""
UNKNOWN: Final = -2
"""The label of pixels that count in no loss: beyond the photograph, or of what has no centre."""


class PairObjects(NamedTuple):
    """The objects that one image of a pair shows, n of them.

    Attributes:
        labels: (S, S) int32 row of the object that each pixel shows, ``GROUND`` or ``UNKNOWN``.
        ids: (n,) int64, equal for one object in all images of a scene.
        centres: (n, 2) where the middle of its box projects, pixels; also outside the image.
        sides: (n,) side of a square of the area of its box from above, pixels.
        rises: (n,) height of the middle of its box above its foot, pixels as seen there.
        pixels: (n,) number of its pixels.
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
        """Return objects of an image as tensors."""
        return ImageObjects(*(torch.from_numpy(each) for each in objects))
