"""Detection of keypoints at the peaks of D2-Net's dense features, over an image pyramid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from baselines.d2net.network import DenseD2Net

# Numerical guard: minimum curvature of a peak, relative to its height.
_MIN_CURVATURE: Final = 1e-4
# Largest offset (cells) of a peak from the centre of its cell.
_MAX_OFFSET: Final = 0.5
# Minimum side of a pyramid level (px); a smaller one has no cell with neighbours on all sides.
_MIN_SIDE_PX: Final = 16

EDGE_RATIO: Final = 5.0
"""Maximum ratio of the two curvatures of a peak, as in SIFT. A larger ratio indicates an edge."""


class Keypoints(NamedTuple):
    """Keypoints of one image with their descriptors.

    Attributes:
        xy: positions (N, 2), COLMAP pixels.
        scale: (N,) size of a pixel of the keypoint's pyramid level, in pixels of the image.
        scores: (N,) largest channel of the feature at the keypoint, divided by the number of its
            level, which is 1 for the coarsest, because features of coarser levels are added.
        descriptors: descriptors (N, C) of unit length.
    """

    xy: Tensor
    scale: Tensor
    scores: Tensor
    descriptors: Tensor


def detect(network: DenseD2Net, image: Tensor, scales: Sequence[float]) -> Keypoints:
    """Detect and describe keypoints.

    The features of each level are added to those of the next level, which detects no keypoints
    where a coarser level did (section 3.4 of the paper).

    Args:
        network: the network.
        image: image (3, H, W) float RGB in 0..1.
        scales: scales of the levels, coarse to fine. Levels that are too small are left out.
    """
    height, width = image.shape[1:]
    coarser = detected = None
    levels = [_no_keypoints(network.channels, image)]
    for level, scale in enumerate(scales, 1):
        size = (int(height * scale), int(width * scale))
        if min(size) < _MIN_SIDE_PX:
            continue
        features = network(_resize(image[None], size))[0]
        cells = features.shape[1:]
        if coarser is not None:
            features = features + _resize(coarser[None], cells)[0]
        coarser = features
        peaks, offsets = find_peaks(features)
        if detected is not None:
            earlier = functional.interpolate(detected[None, None].float(), cells)[0, 0].bool()
            peaks &= ~earlier
            detected = peaks | earlier
        else:
            detected = peaks
        rows, columns = peaks.nonzero().T
        offset = offsets[:, rows, columns]
        exact = torch.stack([columns, rows]) + offset
        last = exact.new_tensor([cells[1] - 1, cells[0] - 1])[:, None]
        kept = (offset.abs() < _MAX_OFFSET).all(0) & ((exact >= 0) & (exact <= last)).all(0)
        exact = exact[:, kept]
        # The centres of the corner pixels coincide in all levels, at (0.5, 0.5) for the first. Cell
        # (x, y) lies (4x + 3.5, 4y + 3.5) pixels of the level from the centre of the first pixel.
        pixel_size = [(width - 1) / (size[1] - 1), (height - 1) / (size[0] - 1)]
        xy = (4 * exact.T + 3.5) * exact.new_tensor(pixel_size) + 0.5
        sampled = functional.grid_sample(
            features[None], (2 * exact / last - 1).T[None, None], align_corners=True
        )[0, :, 0]
        strongest = features.permute(1, 2, 0)[rows[kept], columns[kept]].amax(1)
        levels.append(
            Keypoints(
                xy,
                torch.full_like(strongest, 1 / scale),
                strongest / level,
                functional.normalize(sampled, dim=0).T,
            )
        )
    return Keypoints(*(torch.cat(parts) for parts in zip(*levels, strict=True)))


def find_peaks(features: Tensor) -> tuple[Tensor, Tensor]:
    """Find the peaks of each cell's strongest channel, and their exact positions.

    A peak is the largest of 3 x 3 cells, and its curvatures are similar in all directions. Its
    exact position is the top of the parabola through those cells (Brown and Lowe, BMVC 2002).

    Args:
        features: features (C, h, w), not negative.

    Returns:
        Whether each cell has a peak, (h, w) bool, and offsets (2, h, w) of columns and rows in
        cells, undefined outside peaks.
    """
    _, h, w = features.shape
    # The network's features are channels-last, so that a cell's channels are adjacent in memory.
    cells = features.permute(1, 2, 0)
    channel = cells.argmax(2, keepdim=True)
    padded = functional.pad(cells, (0, 0, 1, 1, 1, 1))
    around = torch.stack(
        [
            padded[row : row + h, column : column + w].gather(2, channel)[..., 0]
            for row in range(3)
            for column in range(3)
        ]
    )
    nw, n, ne, west, centre, east, sw, s, se = around
    dxx, dyy, dxy = west + east - 2 * centre, n + s - 2 * centre, (nw - ne - sw + se) / 4
    dx, dy = (east - west) / 2, (s - n) / 2
    determinant = dxx * dyy - dxy**2
    round_enough = (dxx + dyy) ** 2 <= (EDGE_RATIO + 1) ** 2 / EDGE_RATIO * determinant
    curved = (determinant > 0) & (dxx + dyy < -_MIN_CURVATURE * centre)
    peaks = (centre == around.amax(0)) & curved & round_enough
    steps = torch.stack([dxy * dy - dyy * dx, dxy * dx - dxx * dy])
    return peaks, steps / determinant


def _resize(values: Tensor, size: Sequence[int]) -> Tensor:
    """Resize values (B, C, H, W) so that the corner cells stay at the corners."""
    return functional.interpolate(values, tuple(size), mode="bilinear", align_corners=True)


def _no_keypoints(channels: int, like: Tensor) -> Keypoints:
    empty = like.new_zeros
    return Keypoints(empty(0, 2), empty(0), empty(0), empty(0, channels))
