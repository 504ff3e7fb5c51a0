"""Correlation of windows around pixels with other photographs at depths along their rays."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.depth.grey_photograph import GreyPhotograph

# Number of successive depths over which a window keeps its shape and moves along a parabola.
_BLOCK: Final = 16
# Number of pixels whose windows are sampled at once, so that they fit into the processor's cache.
_CHUNK: Final = 64
# Maximum number of rows that OpenCV's ``remap`` takes.
_MAX_ROWS: Final = 32000


class WindowSweep:
    """Correlates windows around pixels with another photograph, at depths along their rays.

    Windows are fronto-parallel and are compared by normalised correlation. The shape of a window in
    the other photograph and the path of its centre are computed once for a block of depths.

    Args:
        photograph: the reference photograph.
        xy: (N, 2) pixels of the reference photograph.
        window: (P, 2) offsets of a window's samples from its centre, pixels.
        border: width of the edge of other photographs that is not used, pixels.

    Attributes:
        rays: (N, 3) rays of the pixels at a depth of one.
        usable: (N,) bool, whether the rays are valid.
    """

    def __init__(
        self, photograph: GreyPhotograph, xy: Tensor, window: Tensor, border: float
    ) -> None:
        # Rays of the pixel and of the pixels to its right and below it, which give the window's
        # shape.
        three = xy[:, None] + xy.new_tensor([[0, 0], [1, 0], [0, 1]])
        rays, usable = photograph.camera.unproject(three.flatten(0, 1))
        self._triple_rays = rays.view(*three.shape[:2], 3).float()
        self.rays, self.usable = self._triple_rays[:, 0], usable.view(three.shape[:2]).all(1)
        self._pose, self._border = photograph.pose, border
        self._window = window.float()
        x, y = (xy[:, None] + window - 0.5).float().unbind(-1)
        windows = _interpolate(photograph.grey.numpy(), x.numpy(), y.numpy())
        windows -= windows.mean(-1, keepdims=True)
        length = np.linalg.norm(windows, axis=-1, keepdims=True)
        # Windows whose standard deviation is below one grey level have no texture.
        self._min_length = float(len(window)) ** 0.5
        windows = np.where(length > self._min_length, windows / np.maximum(length, 1e-6), 0)
        # One matrix product with another window then gives its correlation and its mean.
        self._windows = np.stack([windows, np.full_like(windows, 1 / len(window))], -1)

    def __call__(self, inverse_depths: Tensor, other: GreyPhotograph) -> NDArray[np.float32]:
        """Return the correlation (N, D) at inverse depths (N, D), evenly spaced, 1/metres.

        It is -1 where the other photograph does not show the window, and 0 where a window has no
        texture.
        """
        relative = (other.pose @ self._pose.inverse()).to(dtype=torch.float32)
        rotated = self._triple_rays @ relative.rotation.T
        blocks = [
            self._block(rotated, relative.translation, block, other)
            for block in torch.split(inverse_depths, _BLOCK, 1)
        ]
        return np.concatenate(blocks, 1)

    def _block(
        self, rotated: Tensor, shift: Tensor, inverse_depths: Tensor, other: GreyPhotograph
    ) -> NDArray[np.float32]:
        """Return the correlation (N, D) at the inverse depths (N, D) of one block.

        Args:
            rotated: (N, 3, 3) rays of the three pixels in the frame of the other camera.
            shift: (3,) position of the reference camera in that frame, metres.
            inverse_depths: 1/metres.
            other: the other photograph.
        """
        count = inverse_depths.shape[1]
        middle = inverse_depths[:, [0, -1]].mean(1)
        # The pixel at the first, middle and last depth, then its neighbours at the middle depth.
        nodes = torch.stack(
            [inverse_depths[:, 0], middle, inverse_depths[:, -1], middle, middle], 1
        )
        pixel = torch.tensor([0, 0, 0, 1, 2])
        in_camera = rotated[:, pixel] / nodes[..., None] + shift
        projected = other.camera.project(in_camera.flatten(0, 1))
        xy = projected.xy.view(*nodes.shape, 2)
        valid = projected.valid.view(nodes.shape).all(1)
        first, at, last, right, below = xy.unbind(1)
        # The parabola through three points of the path of the window's centre.
        t = torch.linspace(-1, 1, count)[:, None] if count > 1 else torch.zeros(1, 1)
        bend = 0.5 * (first + last) - at
        path = at[:, None] + 0.5 * (last - first)[:, None] * t + bend[:, None] * t * t
        axes = torch.stack([right - at, below - at], 1)
        steps = torch.cat([torch.zeros_like(axes[:, :1]), axes], 1)
        corners = path[:, :, None] + steps[:, None]
        inside = other.camera.contains(corners, self._border).all(-1) & valid[:, None]
        offsets = axes.transpose(1, 2) @ self._window.T
        found = self._correlate((path - 0.5).numpy(), offsets.numpy(), other.grey.numpy())
        return np.where(inside.numpy(), found, np.float32(-1))

    def _correlate(
        self, path: NDArray[np.float32], offsets: NDArray[np.float32], grey: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the correlation (N, D) with windows of a photograph.

        Args:
            path: (N, D, 2) centres of the windows, OpenCV's pixels.
            offsets: (N, 2, P) offsets of their samples, pixels.
            grey: (H, W) the photograph.
        """
        found = np.empty(path.shape[:2], np.float32)
        for begin in range(0, len(path), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            # x and y are added separately; adding pairs would take ten times as long.
            x, y = (path[part, :, axis, None] + offsets[part, None, axis] for axis in (0, 1))
            windows = _interpolate(grey, x, y)
            products, mean = np.moveaxis(windows @ self._windows[part], -1, 0)
            squares = np.einsum("ndp,ndp->nd", windows, windows)
            length = np.sqrt(np.maximum(squares - windows.shape[-1] * mean * mean, 0))
            found[part] = np.where(
                length > self._min_length, products / np.maximum(length, 1e-6), 0
            )
        return found


def _interpolate(
    grey: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Interpolate a picture (H, W) at x and y, (..., P) each, in OpenCV's pixels."""
    columns, rows = (each.reshape(-1, each.shape[-1]) for each in (x, y))
    parts = [
        cv2.remap(grey, columns[part], rows[part], cv2.INTER_LINEAR)
        for part in (slice(at, at + _MAX_ROWS) for at in range(0, len(rows), _MAX_ROWS))
    ]
    found = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return np.asarray(found, np.float32).reshape(x.shape)
