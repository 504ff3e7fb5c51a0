"""Correlation of windows around pixels with other photographs at depths along their rays."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.depth.grey_photograph import GreyPhotograph

# Number of successive depths for which a window keeps its shape and moves along a parabola.
_BLOCK: Final = 16
# Number of pixels whose windows are sampled at a time: they fit into the processor's cache.
_CHUNK: Final = 64
# Maximum number of rows of OpenCV's ``remap``.
_ROWS: Final = 32000


class WindowSweep:
    """Correlates windows around pixels with another photograph, at depths along their rays.

    Windows are fronto-parallel and are compared by normalised correlation. The shape of a window in
    the other photograph and the path of its centre are computed once for a block of depths.

    Args:
        photograph: the reference photograph.
        xy: (N, 2) its pixels.
        window: (P, 2) offsets of a window's samples from its centre, pixels.
        border: pixels at the edge of other photographs that are not used.

    Attributes:
        rays: (N, 3) rays of the pixels at a depth of one.
        usable: (N,) bool, whether the rays are valid.
    """

    def __init__(
        self, photograph: GreyPhotograph, xy: Tensor, window: Tensor, border: float
    ) -> None:
        # Rays of the pixel and of those to its right and below, which give the window's shape.
        three = xy[:, None] + xy.new_tensor([[0, 0], [1, 0], [0, 1]])
        rays, usable = photograph.camera.unproject(three.flatten(0, 1))
        self._three = rays.view(*three.shape[:2], 3).float()
        self.rays, self.usable = self._three[:, 0], usable.view(three.shape[:2]).all(1)
        self._pose, self._border = photograph.pose, border
        self._window = window.float()
        x, y = (xy[:, None] + window - 0.5).float().unbind(-1)
        own = _interpolate(photograph.grey.numpy(), x.numpy(), y.numpy())
        own -= own.mean(-1, keepdims=True)
        length = np.linalg.norm(own, axis=-1, keepdims=True)
        # Windows whose standard deviation is below one grey level have no texture.
        self._plain = float(len(window)) ** 0.5
        own = np.where(length > self._plain, own / np.maximum(length, 1e-6), 0)
        # One product gives the correlation and the mean.
        self._own = np.stack([own, np.full_like(own, 1 / len(window))], -1)

    def __call__(self, depths: Tensor, other: GreyPhotograph) -> NDArray[np.float32]:
        """Return the correlation (N, D) at inverse depths (N, D), evenly spaced, 1/metres.

        It is -1 where the other photograph does not show the window.
        """
        relative = (other.pose @ self._pose.inverse()).to(dtype=torch.float32)
        turned = self._three @ relative.rotation.T
        blocks = [
            self._block(turned, relative.translation, block, other)
            for block in torch.split(depths, _BLOCK, 1)
        ]
        return np.concatenate(blocks, 1)

    def _block(
        self, turned: Tensor, shift: Tensor, depths: Tensor, other: GreyPhotograph
    ) -> NDArray[np.float32]:
        """Return the correlation at a few inverse depths (N, D)."""
        count = depths.shape[1]
        middle = depths[:, [0, -1]].mean(1)
        nodes = torch.stack([depths[:, 0], middle, depths[:, -1], middle, middle], 1)
        which = torch.tensor([0, 0, 0, 1, 2])
        in_camera = turned[:, which] / nodes[..., None] + shift
        projected = other.camera.project(in_camera.flatten(0, 1))
        xy = projected.xy.view(*nodes.shape, 2)
        valid = projected.valid.view(nodes.shape).all(1)
        first, at, last, right, below = xy.unbind(1)
        # The parabola through three points of the path.
        t = torch.linspace(-1, 1, count)[:, None] if count > 1 else torch.zeros(1, 1)
        bend = 0.5 * (first + last) - at
        way = at[:, None] + 0.5 * (last - first)[:, None] * t + bend[:, None] * t * t
        across = torch.stack([right - at, below - at], 1)
        reach = torch.cat([torch.zeros_like(across[:, :1]), across], 1)
        corners = way[:, :, None] + reach[:, None]
        inside = other.camera.contains(corners, self._border).all(-1) & valid[:, None]
        offsets = across.transpose(1, 2) @ self._window.T
        found = self._correlate((way - 0.5).numpy(), offsets.numpy(), other.grey.numpy())
        return np.where(inside.numpy(), found, np.float32(-1))

    def _correlate(
        self, way: NDArray[np.float32], offsets: NDArray[np.float32], grey: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the correlation of windows with centres (N, D, 2) in OpenCV's pixels, and offsets
        (N, 2, P)."""
        found = np.empty(way.shape[:2], np.float32)
        for begin in range(0, len(way), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            # Separate coordinates: adding pairs would take ten times as long.
            x, y = (way[part, :, axis, None] + offsets[part, None, axis] for axis in (0, 1))
            theirs = _interpolate(grey, x, y)
            products, mean = np.moveaxis(theirs @ self._own[part], -1, 0)
            squares = np.einsum("ndp,ndp->nd", theirs, theirs)
            length = np.sqrt(np.maximum(squares - theirs.shape[-1] * mean * mean, 0))
            found[part] = np.where(length > self._plain, products / np.maximum(length, 1e-6), 0)
        return found


def _interpolate(
    grey: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Interpolate a picture (H, W) at x and y, (..., P) each, in OpenCV's pixels."""
    columns, rows = (each.reshape(-1, each.shape[-1]) for each in (x, y))
    parts = [
        cv2.remap(grey, columns[some], rows[some], cv2.INTER_LINEAR)
        for some in (slice(at, at + _ROWS) for at in range(0, len(rows), _ROWS))
    ]
    found = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return np.asarray(found, np.float32).reshape(x.shape)
