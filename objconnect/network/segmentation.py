"""Segmentation of images into objects. No gradient passes through it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import skimage  # imports its submodules when they are used
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from objconnect.network.config import ObjConnectNetConfig
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.tuning import worker_threads

NOTHING: Final = -1
"""The label of pixels that belong to no object."""
# Largest longer side (px) of the picture that is segmented. For an image of 512 pixels, the pixels
# of this picture are finer than the cells of the levels with objects. At 256, SLIC takes twice the
# time.
_LONG_SIDE: Final = 192
# SLIC converges within 5 iterations; 10 take twice the time.
_SLIC_ITERATIONS: Final = 5
# Weight of distances relative to colours in SLIC, the value of its authors.
_SLIC_COMPACTNESS: Final = 10.0
# Scale k of Felzenszwalb and Huttenlocher for colours in 0..1.
_FELZENSZWALB_SCALE: Final = 100.0
# Standard deviation of the blur before Felzenszwalb's segmentation, px of the reduced picture.
_FELZENSZWALB_BLUR: Final = 0.8

Labels = NDArray[np.int64]
"""Index (h, w) of the object of each pixel; negative for none."""
Picture = NDArray[np.float32]
"""(h, w, 3) RGB in 0..1."""


def segment(images: Tensor, config: ObjConnectNetConfig) -> Tensor:
    """Segment images; this is S of equation (1) of the object-connect paper.

    Args:
        images: images (B, 3, H, W), RGB in 0..1.
        config: configuration; ``segmentation``, ``segments`` and ``segment_side`` are used.

    Returns:
        Labels (B, h, w) int64 on the device of the images, 0 to N - 1 or ``NOTHING``. The label
        maps have at most 192 cells a side and cover the images.

    Raises:
        InputError: the configuration expects given or learned label maps, or has no objects.
    """
    if config.segmentation in ("learned", "given", "none"):
        raise InputError(
            f"segmentation is '{config.segmentation}': give label maps, or choose slic, "
            "felzenszwalb or grid"
        )
    height, width = images.shape[-2:]
    size = reduce_size(height, width)
    count = min(config.segments, max(1, round(height * width / config.segment_side**2)))
    if config.segmentation == "grid":
        return _squares(*size, count).to(images.device).expand(len(images), -1, -1)
    method = _slic if config.segmentation == "slic" else _felzenszwalb
    small = functional.interpolate(images.detach().float(), size, mode="area")
    pictures = small.permute(0, 2, 3, 1).cpu().numpy()

    def segment_one(picture: Picture) -> Labels:
        return keep_largest(method(picture, count), count)

    # A segmentation runs in one thread and releases the interpreter's lock most of the time.
    with worker_threads() as pool:
        labels = list(pool.map(segment_one, pictures))
    return torch.from_numpy(np.stack(labels)).to(images.device)


def reduce_size(height: int, width: int) -> tuple[int, int]:
    """Return the height and width of the picture that is segmented, at most half the image's."""
    factor = min(0.5, _LONG_SIDE / max(height, width))
    return max(1, round(height * factor)), max(1, round(width * factor))


def keep_largest(labels: Labels, count: int) -> Labels:
    """Renumber labels from 0 by decreasing area; beyond ``count`` they become ``NOTHING``.

    Args:
        labels: labels (h, w), negative where there is no object.
        count: number of objects to keep.
    """
    nothing = labels < 0
    areas = np.bincount(labels[~nothing], minlength=1)
    largest = np.argsort(-areas, kind="stable")[:count]
    number = np.full(len(areas), NOTHING, np.int64)
    number[largest] = np.arange(len(largest))
    kept = number.take(labels, mode="clip")
    kept[nothing] = NOTHING
    return kept


def sample_cells(labels: Tensor, image: Tensor, level: Tensor, stride: int) -> Tensor:
    """Return the label at the centre of each cell of a level, (B, h, w).

    Args:
        labels: label maps (B, _, _) of any size that cover the image.
        image: image (..., H, W).
        level: map (..., h, w) of the level, which may cover less than the image.
        stride: pixels per cell.
    """
    rows, columns = (
        ((torch.arange(cells, device=labels.device) + 0.5) * (stride * size / pixels)).long()
        for cells, size, pixels in zip(
            level.shape[-2:], labels.shape[1:], image.shape[-2:], strict=True
        )
    )
    return labels[:, rows[:, None], columns]


def sample_pixels(labels: Tensor, image: Tensor, xy: Tensor) -> Tensor:
    """Return the label at each pixel, (B, P).

    Args:
        labels: label maps (B, _, _) of any size that cover the image.
        image: image (..., H, W).
        xy: pixels (B, P, 2); those outside take the label at the border.
    """
    height, width = labels.shape[1:]
    column = (xy[..., 0] * (width / image.shape[-1])).long().clamp(0, width - 1)
    row = (xy[..., 1] * (height / image.shape[-2])).long().clamp(0, height - 1)
    return labels.flatten(1).gather(1, row * width + column)


def _slic(picture: Picture, count: int) -> Labels:
    """Segment by SLIC (Achanta et al., "SLIC superpixels", PAMI 2012)."""
    algorithm: Callable[..., Labels] = skimage.segmentation.slic
    return algorithm(
        picture,
        n_segments=count,
        compactness=_SLIC_COMPACTNESS,
        max_num_iter=_SLIC_ITERATIONS,
        start_label=0,
        channel_axis=-1,
    )


def _felzenszwalb(picture: Picture, count: int) -> Labels:
    """Segment by the graph-based method of Felzenszwalb and Huttenlocher (IJCV 2004)."""
    min_size = max(1, picture.shape[0] * picture.shape[1] // (2 * count))
    algorithm: Callable[..., Labels] = skimage.segmentation.felzenszwalb
    return algorithm(
        picture,
        scale=_FELZENSZWALB_SCALE,
        sigma=_FELZENSZWALB_BLUR,
        min_size=min_size,
        channel_axis=-1,
    )


def _squares(height: int, width: int, count: int) -> Tensor:
    """Return labels (1, height, width) of at most ``count`` rectangles, as square as possible."""
    rows = max(1, min(count, math.floor(math.sqrt(count * height / width))))
    columns = max(1, count // rows)
    row = torch.arange(height) * rows // height
    column = torch.arange(width) * columns // width
    return (row[:, None] * columns + column)[None]
