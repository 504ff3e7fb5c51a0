"""Slanted planes of PatchMatch, parametrised by the inverse depth at a pixel and its slope.

On a plane the inverse depth is linear in the pixel, 1/z(x, y) = w + gx dx + gy dy. A plane is
therefore three numbers (w in 1/m, gx and gy in 1/m per pixel). Moving it to another pixel takes
two products, and the projection of a pixel into another view is linear in the three numbers before
the division. Any such plane with w > 0 faces the camera.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from objconnect.scene.geometry.camera import Camera

# Number of nearest seeds through which an initial plane is fitted.
_NEIGHBOURS = 8
# Regularisation of the slope, for seeds that lie on a line.
_RIDGE = 1e-2


def move(planes: Tensor, dx: Tensor | float, dy: Tensor | float) -> Tensor:
    """Return planes (3, ...) moved by ``dx``, ``dy`` pixels."""
    w, gx, gy = planes
    return torch.stack([w + gx * dx + gy * dy, gx, gy])


def resize(planes: Tensor, height: int, width: int) -> Tensor:
    """Return planes (3, H, W) for the picture at another size, (3, height, width)."""
    sy, sx = planes.shape[1] / height, planes.shape[2] / width
    y = (torch.arange(height, device=planes.device) + 0.5) * sy
    x = (torch.arange(width, device=planes.device) + 0.5) * sx
    row, column = y.long(), x.long()
    parents = planes[:, row][:, :, column]
    w, gx, gy = move(parents, x - column - 0.5, (y - row - 0.5)[:, None])
    return torch.stack([w, gx * sx, gy * sy])


def normals_of(planes: Tensor, camera: Camera) -> Tensor:
    """Return the unit normals of planes, (3, H, W), in the camera's frame and towards it."""
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    x, y = camera.pixel_grid(planes.dtype).to(planes.device).unbind(-1)
    ahead, gx, gy = move(planes, cx - x, cy - y)
    return -torch.nn.functional.normalize(torch.stack([gx * fx, gy * fy, ahead]), dim=0)


def planes_of(depth: Tensor, normals: Tensor, camera: Camera) -> Tensor:
    """Return planes from depths (H, W) > 0 and normals (3, H, W) as ``normals_of`` gives."""
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    x, y = camera.pixel_grid(depth.dtype).to(depth.device).unbind(-1)
    nx, ny, nz = normals
    along = nx * (x - cx) / fx + ny * (y - cy) / fy + nz
    return torch.stack([torch.ones_like(depth), nx / (fx * along), ny / (fy * along)]) / depth


def planes_at_nearest(seeds: NDArray[np.float64], height: int, width: int) -> Tensor:
    """Return fronto-parallel planes; each pixel has the inverse depth of the nearest seed.

    Args:
        seeds: (M, 3) x, y (pixels) and inverse depth (1/m) of M >= 1 points.
        height: height of the picture.
        width: width of the picture.

    Returns:
        planes: (3, height, width) float32.
    """
    column = seeds[:, 0].astype(int).clip(0, width - 1)
    row = seeds[:, 1].astype(int).clip(0, height - 1)
    free = np.ones((height, width), np.uint8)
    free[row, column] = 0
    _, label = cv2.distanceTransformWithLabels(
        free, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    inverse = np.zeros(label.max() + 1, np.float32)
    inverse[label[row, column]] = seeds[:, 2]
    planes = torch.zeros(3, height, width)
    planes[0] = torch.from_numpy(inverse[label])
    return planes


def planes_through(seeds: NDArray[np.float64], height: int, width: int) -> Tensor:
    """Fit a plane at every pixel to the nearest seeds.

    Arguments and result are those of ``planes_at_nearest``.
    """
    points = torch.from_numpy(seeds)
    y, x = torch.meshgrid(
        torch.arange(height, dtype=points.dtype) + 0.5,
        torch.arange(width, dtype=points.dtype) + 0.5,
        indexing="ij",
    )
    pixels = torch.stack([x, y], -1).reshape(-1, 2)
    count = min(_NEIGHBOURS, len(points))
    # With a list of ranks, the result has an axis of neighbours even if there is a single one.
    neighbours = KDTree(seeds[:, :2]).query(pixels.numpy(), list(range(1, count + 1)))
    distance, which = (torch.from_numpy(each) for each in neighbours)
    near = points[which]
    offset = near[..., :2] - pixels[:, None]
    scale = distance.mean(1)[:, None, None] + 1e-9
    design = torch.cat([torch.ones_like(offset[..., :1]), offset / scale], -1)
    weight = torch.exp(-((distance[..., None] / scale) ** 2))
    normal = design.mT @ (weight * design)
    normal[:, 1, 1] += _RIDGE
    normal[:, 2, 2] += _RIDGE
    solved = torch.linalg.solve(normal, design.mT @ (weight * near[..., 2:]))[..., 0]
    planes = torch.cat([solved[:, :1], solved[:, 1:] / scale[:, 0]], -1)
    return planes.T.reshape(3, height, width).float()
