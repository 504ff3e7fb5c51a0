"""Blobs that stand out from what is around them: where a photograph may show a small object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from mapping.supplement.association import Detections
from objconnect.network import ObjConnectNet
from objconnect.segmentation import NOTHING, Labels, at_pixels, segment

# Radii of blobs (px), and how much wider what they are held against is.
SIGMAS: Final = (0.8, 1.3, 2.1)
_WIDER: Final = 2.5
_COLOUR_SIGMA: Final = 0.7
# Difference from around (units of CIE L*a*b*), and how many of a photograph at most.
_STRONG: Final = 5.0
_MOST: Final = 12000
_BORDER: Final = 8


@dataclass(frozen=True)
class Blobs:
    """Of one photograph, N of them.

    Attributes:
        detections: their pixels, confidence, and descriptors: of a network, or their looks.
        look: (N, 9) difference from around (L*, a*, b*) at each radius.
        radius: (N,) at which of the radii it was found.
        strength: (N,) length of that difference.
        colour: (N, 3) L*, a*, b*.
    """

    detections: Detections
    look: NDArray[np.float64]
    radius: NDArray[np.int64]
    strength: NDArray[np.float64]
    colour: NDArray[np.float64]

    @property
    def xy(self) -> NDArray[np.float64]:
        """(N, 2) COLMAP pixels."""
        return self.detections.xy


def in_lab(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """CIE L*a*b* of a photograph (H, W, 3)."""
    scaled = rgb.astype(np.float32) / 255
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), np.float32)


@torch.inference_mode()
def find(
    rgb: NDArray[np.uint8], network: ObjConnectNet | None = None, masks: Labels | None = None
) -> Blobs:
    """Blobs of a photograph (H, W, 3): local maxima of the difference of Gaussians of its colours
    (Lowe, IJCV 2004, at a few small radii and without orientation).

    Args:
        rgb: the photograph.
        network: whose centres of objects are looked at too; it says how confident a blob is and
            describes it. Without, all are equally confident.
        masks: labels (H, W) of objects; blobs outside them are left out.
    """
    lab = in_lab(rgb)
    contrast = np.stack(
        [cv2.GaussianBlur(lab, (0, 0), s) - cv2.GaussianBlur(lab, (0, 0), s * _WIDER)
         for s in SIGMAS]
    )  # fmt: skip
    strength = np.linalg.norm(contrast, axis=-1)
    found = [_peaks(s) for s in strength]
    xy = np.concatenate(found)
    radius = np.repeat(np.arange(len(SIGMAS)), [len(each) for each in found])
    image = torch.from_numpy(rgb.astype(np.float32) / 255).permute(2, 0, 1)[None]
    labels = None if masks is None else torch.from_numpy(masks)[None]
    if network is not None:
        own = segment(image, network.config) if labels is None else labels
        objects = network.objects(image, own)
        there = objects.present[0]
        centres = objects.centres[0, there].double().numpy()
        row, column = _pixel(centres, rgb.shape)
        xy = np.concatenate([xy, centres])
        radius = np.concatenate([radius, strength[:, row, column].argmax(0)])
    row, column = _pixel(xy, rgb.shape)
    far = np.array([rgb.shape[1], rgb.shape[0]]) - _BORDER
    kept = ((xy >= _BORDER) & (xy <= far)).all(1)
    if labels is not None:
        inside = at_pixels(labels, image, torch.from_numpy(xy)[None])[0] != NOTHING
        kept &= inside.numpy()
    kept = np.flatnonzero(kept)
    best = np.argsort(-strength[radius, row, column][kept], kind="stable")[:_MOST]
    kept = np.sort(kept[best])
    xy, radius, row, column = xy[kept], radius[kept], row[kept], column[kept]
    look = contrast[:, row, column].transpose(1, 0, 2).reshape(len(xy), -1).astype(np.float64)
    if network is None:
        length = np.linalg.norm(look, axis=1, keepdims=True)
        descriptors, confidence = look / length.clip(1e-6), np.ones(len(xy))
    else:
        index = at_pixels(own, image, torch.from_numpy(xy)[None])[0]
        index = torch.where(index < len(there), index, NOTHING)
        known = (index != NOTHING).numpy()
        # Blobs in none of its segments have no confidence.
        confidence = np.where(known, objects.confidence[0, index].double().numpy(), 0)
        vectors = torch.nn.functional.normalize(objects.vectors[0, index], dim=-1)
        descriptors = np.where(known[:, None], vectors.double().numpy(), 0)
    smooth = cv2.GaussianBlur(lab, (0, 0), _COLOUR_SIGMA)
    return Blobs(
        Detections(xy, descriptors.astype(np.float32), confidence),
        look,
        radius,
        strength[radius, row, column].astype(np.float64),
        smooth[row, column].astype(np.float64),
    )


def _pixel(
    xy: NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of places in a picture of a shape."""
    column, row = np.floor(xy).astype(np.int64).T
    return row.clip(0, shape[0] - 1), column.clip(0, shape[1] - 1)


def _peaks(strength: NDArray[np.float32]) -> NDArray[np.float64]:
    """Local maxima (N, 2) of a picture (H, W), each at the top of the parabola around it."""
    top = (strength >= cv2.dilate(strength, np.ones((3, 3)))) & (strength > _STRONG)
    top[[0, -1]] = top[:, [0, -1]] = False
    row, column = np.nonzero(top)
    at = strength[row, column]

    def offset(before: NDArray[np.float32], after: NDArray[np.float32]) -> NDArray[np.float32]:
        curve = np.minimum(before - 2 * at + after, -1e-6)
        return np.asarray(np.clip(0.5 * (before - after) / curve, -0.5, 0.5))

    x = column + 0.5 + offset(strength[row, column - 1], strength[row, column + 1])
    y = row + 0.5 + offset(strength[row - 1, column], strength[row + 1, column])
    return np.asarray(np.stack([x, y], -1), np.float64)
