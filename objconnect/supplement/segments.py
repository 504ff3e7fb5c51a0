"""Where the segments of a photograph may hold an object: at their middles and at their corners."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.config import ObjConnectNetConfig
from objconnect.network import ObjConnectNet
from objconnect.segmentation import NOTHING, Labels, at_pixels, segment
from objconnect.supplement.association import Detections

# Segments as fine as they come: a car's roof has several, a bench one.
_SEGMENTS: Final = ObjConnectNetConfig(segments=1024, segment_side=12)
# Shi and Tomasi's corners: how far apart (px), how strong, and how many of a segment.
_APART: Final = 3.0
_QUALITY: Final = 1e-3
_BLUR_PX: Final = 0.7
_OF_EACH: Final = 3
_MOST: Final = 6000
_BORDER: Final = 8.0
# Side of the patch of pixels that describes a place where no network does.
_PATCH: Final = 8


@torch.inference_mode()
def find(
    rgb: NDArray[np.uint8], network: ObjConnectNet | None = None, masks: Labels | None = None
) -> Detections:
    """Places in a photograph (H, W, 3) that may be on an object.

    Args:
        rgb: the photograph.
        network: whose centres are looked at too; it says how confident a place is and what it
            looks like. Without, all are equally confident, and their pixels describe them.
        masks: labels (H, W) of objects; places outside them are left out. Without, segments are
            found in the photograph.
    """
    image = torch.from_numpy(rgb.astype(np.float32) / 255).permute(2, 0, 1)[None]
    labels = segment(image, _SEGMENTS) if masks is None else torch.from_numpy(masks)[None]
    grey = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY)
    xy = np.concatenate([_middles(labels[0].numpy(), grey.shape), _corners(grey, image, labels)])
    if network is None:
        confidence, descriptors = np.ones(len(xy)), _patches(grey, xy)
    else:
        own = segment(image, network.config) if masks is None else labels
        objects = network.objects(image, own)
        there = objects.present[0]
        xy = np.concatenate([xy, objects.centres[0, there].double().numpy()])
        # Places in none of its segments have no confidence.
        index = at_pixels(own, image, torch.from_numpy(xy)[None])[0]
        index = torch.where(index < len(there), index, NOTHING)
        inside = (index != NOTHING).numpy()
        confidence = np.where(inside, objects.confidence[0, index].double().numpy(), 0)
        vectors = torch.nn.functional.normalize(objects.vectors[0, index], dim=-1)
        descriptors = np.where(inside[:, None], vectors.numpy(), 0)
    size = np.array(grey.shape[::-1])
    within = ((xy >= _BORDER) & (xy <= size - _BORDER)).all(1)
    return Detections(
        xy[within], descriptors[within].astype(np.float32), np.asarray(confidence[within])
    )


def _middles(labels: Labels, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Of the segments, pixels (N, 2) of a photograph of a shape."""
    row, column = np.nonzero(labels != NOTHING)
    _, index, area = np.unique(labels[row, column], return_inverse=True, return_counts=True)
    scale = np.array([shape[1] / labels.shape[1], shape[0] / labels.shape[0]])
    sums = np.stack([np.bincount(index, column + 0.5), np.bincount(index, row + 0.5)], -1)
    return np.asarray(sums / area[:, None] * scale)


def _corners(grey: NDArray[np.uint8], image: Tensor, labels: Tensor) -> NDArray[np.float64]:
    """The strongest of each segment, (N, 2) pixels."""
    smooth = cv2.GaussianBlur(grey, (0, 0), _BLUR_PX)
    found = cv2.goodFeaturesToTrack(smooth, _MOST, _QUALITY, _APART)
    if found is None:
        return np.empty((0, 2))
    # The strongest come first; OpenCV counts from the first pixel's centre.
    xy = found[:, 0].astype(np.float64) + 0.5
    label = at_pixels(labels, image, torch.from_numpy(xy)[None])[0].numpy()
    order = np.argsort(label, kind="stable")
    first = np.searchsorted(label[order], label[order])
    rank = np.empty(len(xy), np.int64)
    rank[order] = np.arange(len(xy)) - first
    return np.asarray(xy[(rank < _OF_EACH) & (label != NOTHING)])


def _patches(grey: NDArray[np.uint8], xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Pixels around places, of mean zero and length one, (N, P)."""
    offset = np.arange(_PATCH) - _PATCH // 2
    column, row = np.floor(xy).astype(int).T
    rows = (row[:, None] + offset).clip(0, grey.shape[0] - 1)
    columns = (column[:, None] + offset).clip(0, grey.shape[1] - 1)
    values = grey[rows[:, :, None], columns[:, None, :]].reshape(len(xy), -1).astype(np.float32)
    values -= values.mean(1, keepdims=True)
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True).clip(1e-6))
