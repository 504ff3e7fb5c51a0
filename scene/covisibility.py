"""Which frames see the same ground."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from scene.camera import Camera


def surface_points(
    camera: Camera,
    cam_from_world: NDArray[np.float64],
    depth: NDArray[np.float32],
    per_side: int = 8,
) -> NDArray[np.float64]:
    """World points seen on a coarse grid of a picture, (per_side^2, 3); NaN at the sky.

    Args:
        camera: of the picture.
        cam_from_world: (4, 4).
        depth: (H, W) planar metres, 0 where there is no surface.
        per_side: grid points per side.
    """
    steps = (np.arange(per_side) + 0.5) / per_side
    rows, columns = (steps * camera.height).astype(int), (steps * camera.width).astype(int)
    xy = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1).reshape(-1, 2)
    z = depth[np.ix_(rows, columns)].reshape(-1).astype(np.float64)
    rays, _ = camera.unproject(torch.from_numpy(xy))
    local = rays.numpy() * np.where(z > 0, z, np.nan)[:, None]
    return np.asarray((local - cam_from_world[:3, 3]) @ cam_from_world[:3, :3])


def overlap_matrix(
    cameras: Sequence[Camera],
    cam_from_world: NDArray[np.float64],
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Share of each frame's surface that each other frame has in view, occlusion left out.

    Args:
        cameras: N of them.
        cam_from_world: (N, 4, 4).
        points: (N, S, 3) of ``surface_points``.

    Returns:
        (N, N) in 0..1, symmetric (the smaller share of the two), zero on the diagonal.
    """
    world = torch.from_numpy(points)
    seen = torch.isfinite(world).all(-1)
    shares = np.zeros((len(cameras), len(cameras)))
    for j, camera in enumerate(cameras):
        pose = torch.from_numpy(cam_from_world[j])
        projected = camera.project(world @ pose[:3, :3].T + pose[:3, 3])
        inside = projected.valid & camera.contains(projected.xy) & seen
        shares[:, j] = (inside.sum(-1) / seen.sum(-1).clamp_min(1)).numpy()
    shares = np.minimum(shares, shares.T)
    np.fill_diagonal(shares, 0)
    return shares
