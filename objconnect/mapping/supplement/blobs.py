"""Detect blobs that differ from their surroundings and may be small objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.mapping.supplement.association import Detections
from objconnect.network.network import ObjConnectNet
from objconnect.network.objects import Objects
from objconnect.network.segmentation import NOTHING, Labels, sample_pixels

SIGMAS: Final = (0.8, 1.3, 2.1)
"""Radii of blobs (px). The classifier takes the appearance at each of them."""

# Radius of the surroundings of a blob, in blob radii. The classifier was trained with this value.
_SURROUND_RATIO: Final = 2.5
# Minimum difference from the surroundings (CIE L*a*b*), above the noise of photographs.
_MIN_CONTRAST: Final = 5.0
# Maximum number of blobs per photograph, the strongest, which bounds the run time.
_MAX_COUNT: Final = 12000
# Blobs closer to the border (px) are dropped, because the picture cuts their surroundings.
_BORDER_PX: Final = 8
# Blur (px) before the colour of a blob is read.
_COLOUR_SIGMA_PX: Final = 0.7


@dataclass(frozen=True)
class Blobs:
    """The N blobs of one photograph.

    Attributes:
        detections: pixels, confidences and descriptors, from a network or from the appearance.
        appearance: appearance (N, 9), the difference from the surroundings (L*, a*, b*) at each
            radius.
        radius_index: index (N,) into ``SIGMAS`` of the radius at which each blob was detected.
        strength: norm (N,) of the difference from the surroundings at that radius.
        colour: colour (N, 3), L*, a*, b*.
    """

    detections: Detections
    appearance: NDArray[np.float64]
    radius_index: NDArray[np.int64]
    strength: NDArray[np.float64]
    colour: NDArray[np.float64]

    @property
    def xy(self) -> NDArray[np.float64]:
        """Return the positions (N, 2), COLMAP pixels."""
        return self.detections.xy


def to_lab(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Convert a photograph (H, W, 3) to CIE L*a*b*."""
    scaled = rgb.astype(np.float32) / 255
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), np.float32)


@torch.inference_mode()
def find_blobs(
    rgb: NDArray[np.uint8],
    network: ObjConnectNet | None = None,
    masks: Labels | None = None,
) -> Blobs:
    """Detect blobs as local maxima of the difference of Gaussians (Lowe, IJCV 2004) of colours.

    Only a few small radii are used, and no orientation.

    Args:
        rgb: the photograph (H, W, 3).
        network: network whose object centres are added to the blobs. A network with a segmentation
            also gives each blob the confidence and the descriptor of its object. A network with a
            detector but no segmentation adds the centres of its detections only: as without a
            network, blobs have confidence 1 and are described by their appearance.
        masks: label map (H, W) of objects; blobs outside all objects are dropped.
    """
    lab = to_lab(rgb)
    contrast = np.stack([_contrast(lab, sigma) for sigma in SIGMAS])
    strength = np.linalg.norm(contrast, axis=-1)
    peaks = [_peaks(each) for each in strength]
    xy = np.concatenate(peaks)
    radius_index = np.repeat(np.arange(len(SIGMAS)), [len(each) for each in peaks])
    image = torch.from_numpy(rgb.astype(np.float32) / 255).permute(2, 0, 1)[None]
    labels = None if masks is None else torch.from_numpy(masks)[None]
    segments: Tensor | None = None
    objects: Objects | None = None
    if network is not None:
        if network.detector is not None and network.config.segmentation == "none":
            centres = network.detect_objects(image)[0].xy.double().numpy()
        else:
            segments = network.segments(image) if labels is None else labels
            objects = network.objects(image, segments)
            centres = objects.centres[0, objects.present[0]].double().numpy()
        row, column = _pixel(centres, rgb.shape)
        xy = np.concatenate([xy, centres])
        radius_index = np.concatenate([radius_index, strength[:, row, column].argmax(0)])
    row, column = _pixel(xy, rgb.shape)
    end = np.array([rgb.shape[1], rgb.shape[0]]) - _BORDER_PX
    inside = ((xy >= _BORDER_PX) & (xy <= end)).all(1)
    if labels is not None:
        labelled = sample_pixels(labels, image, torch.from_numpy(xy)[None])[0] != NOTHING
        inside &= labelled.numpy()
    kept = np.flatnonzero(inside)
    order = np.argsort(-strength[radius_index, row, column][kept], kind="stable")
    kept = np.sort(kept[order[:_MAX_COUNT]])
    xy, radius_index, row, column = xy[kept], radius_index[kept], row[kept], column[kept]
    appearance = contrast[:, row, column].transpose(1, 0, 2).reshape(len(xy), -1).astype(np.float64)
    if objects is None or segments is None:
        length = np.linalg.norm(appearance, axis=1, keepdims=True)
        descriptors, confidence = appearance / length.clip(1e-6), np.ones(len(xy))
    else:
        index = sample_pixels(segments, image, torch.from_numpy(xy)[None])[0]
        descriptors, confidence = _describe(objects, index)
    smooth = cv2.GaussianBlur(lab, (0, 0), _COLOUR_SIGMA_PX)
    return Blobs(
        Detections(xy, descriptors.astype(np.float32), confidence),
        appearance,
        radius_index,
        strength[radius_index, row, column].astype(np.float64),
        smooth[row, column].astype(np.float64),
    )


def _contrast(lab: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return the difference of Gaussians (H, W, 3) of a picture at a radius."""
    wide = cv2.GaussianBlur(lab, (0, 0), sigma * _SURROUND_RATIO)
    return np.asarray(cv2.GaussianBlur(lab, (0, 0), sigma) - wide, np.float32)


def _describe(objects: Objects, index: Tensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return descriptors (N, C) and confidences (N,) of blobs by the objects they lie in.

    Blobs outside all objects have zeros.

    Args:
        objects: objects of the picture.
        index: object (N,) of each blob.
    """
    index = torch.where(index < objects.present.shape[1], index, NOTHING)
    known = (index != NOTHING).numpy()
    confidence = np.where(known, objects.confidence[0, index].double().numpy(), 0)
    vectors = torch.nn.functional.normalize(objects.vectors[0, index], dim=-1)
    return np.where(known[:, None], vectors.double().numpy(), 0), confidence


def _pixel(
    xy: NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of positions (N, 2), limited to a picture of this shape."""
    column, row = np.floor(xy).astype(np.int64).T
    return row.clip(0, shape[0] - 1), column.clip(0, shape[1] - 1)


def _peaks(strength: NDArray[np.float32]) -> NDArray[np.float64]:
    """Find local maxima (N, 2) of a picture (H, W), refined by a parabola along each axis."""
    top = (strength >= cv2.dilate(strength, np.ones((3, 3)))) & (strength > _MIN_CONTRAST)
    top[[0, -1]] = top[:, [0, -1]] = False
    row, column = np.nonzero(top)
    peak = strength[row, column]

    def offset(before: NDArray[np.float32], after: NDArray[np.float32]) -> NDArray[np.float32]:
        curve = np.minimum(before - 2 * peak + after, -1e-6)
        return np.asarray(np.clip(0.5 * (before - after) / curve, -0.5, 0.5))

    x = column + 0.5 + offset(strength[row, column - 1], strength[row, column + 1])
    y = row + 0.5 + offset(strength[row - 1, column], strength[row + 1, column])
    return np.asarray(np.stack([x, y], -1), np.float64)
