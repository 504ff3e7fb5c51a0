"""Covisibility: which frames of a scene see the same surface, and how much of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.hdf5 import array
from objconnect.scene.storage.hdf5_writing import hdf5_file

if TYPE_CHECKING:
    import torch

MIN_SHARED_SURFACE = 0.1
"""Two frames are covisible if each sees at least this share of the other's surface."""

# A point is hidden if it is deeper than the depth image by more than this share of the depth. A
# smaller difference can come from the slope of the surface within the pixel.
_DEPTH_TOLERANCE = 0.01


@dataclass(frozen=True)
class Covisibility:
    """Pairwise covisibility of the N frames of a scene.

    Attributes:
        names: image names, in the order of the sessions (flights) and of their frames.
        overlap: (N, N) float64 in 0..1; ``overlap[i, j]`` is the share of the surface in frame i
            that frame j sees too. The diagonal is zero.
    """

    names: tuple[str, ...]
    overlap: NDArray[np.float64]

    @property
    def mutual(self) -> NDArray[np.float64]:
        """Return the smaller share of the two frames of each pair, (N, N), symmetric."""
        return np.minimum(self.overlap, self.overlap.T)

    def select(self, names: Sequence[str]) -> Covisibility:
        """Return the covisibility of the named frames, in that order.

        Raises:
            InputError: a frame is unknown.
        """
        row = {name: k for k, name in enumerate(self.names)}
        missing = [name for name in names if name not in row]
        if missing:
            raise InputError(f"the covisibility of the scene lacks frame {missing[0]}")
        rows = [row[name] for name in names]
        return Covisibility(tuple(names), self.overlap[np.ix_(rows, rows)])


def write_covisibility(path: Path, covisibility: Covisibility) -> None:
    """Write ``covisibility.h5``: names, overlap, and the covisible pairs with their mutual share.

    Raises:
        InputError: the file cannot be written.
    """
    mutual = covisibility.mutual
    pairs = np.argwhere(np.triu(mutual) >= MIN_SHARED_SURFACE)
    with hdf5_file(path) as file:
        file["names"] = np.array([name.encode() for name in covisibility.names], "S")
        file.create_dataset("overlap", data=covisibility.overlap, compression="gzip", shuffle=True)
        file["pairs"] = pairs.astype(np.uint32)
        file["share"] = mutual[pairs[:, 0], pairs[:, 1]]


def read_covisibility(path: Path) -> Covisibility:
    """Read ``covisibility.h5``.

    Raises:
        InputError: the file is missing or damaged.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist: simulate and ingest write it with the scene")
    try:
        with h5py.File(path, "r") as file:
            names = tuple(name.decode() for name in array(file, "names"))
            overlap = array(file, "overlap").astype(np.float64)
    except HDF5_DAMAGE:
        raise InputError(f"{path} is damaged or incomplete") from None
    if overlap.shape != (len(names), len(names)):
        raise InputError(f"{path}: the overlap of {len(names)} frames has shape {overlap.shape}")
    return Covisibility(names, overlap)


def surface_points(
    camera: Camera,
    cam_from_world: NDArray[np.float64],
    depth: NDArray[np.float32],
    per_side: int = 8,
) -> NDArray[np.float64]:
    """Return the surface points on a coarse grid of an image, (per_side^2, 3) world metres.

    Points of the sky are NaN.

    Args:
        camera: camera of the image.
        cam_from_world: (4, 4).
        depth: (H, W) planar depth, metres; 0 where there is no surface.
        per_side: number of grid points per side.
    """
    import torch

    steps = (np.arange(per_side) + 0.5) / per_side
    rows, columns = (steps * camera.height).astype(int), (steps * camera.width).astype(int)
    xy = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1).reshape(-1, 2)
    z = depth[np.ix_(rows, columns)].reshape(-1).astype(np.float64)
    rays, _ = camera.unproject(torch.from_numpy(xy))
    local = rays.numpy() * np.where(z > 0, z, np.nan)[:, None]
    return np.asarray((local - cam_from_world[:3, 3]) @ cam_from_world[:3, :3])


def visible_points(
    camera: Camera,
    cam_from_world: NDArray[np.float64],
    points: torch.Tensor,
    depth: NDArray[np.float32] | None = None,
) -> torch.Tensor:
    """Return which points a frame sees, (...,) bool; a point that is NaN is not seen.

    Args:
        camera: camera of the frame.
        cam_from_world: (4, 4).
        points: (..., 3) world metres, float64.
        depth: depth image (H, W) of the frame, metres; points behind the surface seen in it are
            hidden. None ignores occlusion.
    """
    import torch

    pose = torch.from_numpy(cam_from_world)
    local = points @ pose[:3, :3].T + pose[:3, 3]
    projected = camera.project(local)
    finite = torch.isfinite(points).all(-1)
    seen = projected.valid & camera.contains(projected.xy) & finite
    if depth is not None:
        image = torch.from_numpy(depth)
        # A point on the right or lower edge of the image belongs to the last pixel.
        column = projected.xy[..., 0][seen].long().clamp_max(camera.width - 1)
        row = projected.xy[..., 1][seen].long().clamp_max(camera.height - 1)
        limit = image[row, column].double() * (1 + _DEPTH_TOLERANCE)
        seen[seen.clone()] = local[..., 2][seen] <= limit
    return seen


def visible_share(
    cameras: Sequence[Camera],
    cam_from_world: NDArray[np.float64],
    points: NDArray[np.float64],
    depths: Iterable[NDArray[np.float32]] | None = None,
) -> NDArray[np.float64]:
    """Return the share of each frame's surface that each other frame sees.

    Args:
        cameras: N cameras.
        cam_from_world: (N, 4, 4).
        points: (N, S, 3) from ``surface_points``.
        depths: depth images (H, W) of the N frames, metres, consumed one at a time; points behind
            the surface seen in them are hidden. None ignores occlusion.

    Returns:
        (N, N) in 0..1: entry (i, j) is the share of frame i's surface that frame j sees; the
        diagonal is zero.
    """
    import torch

    world = torch.from_numpy(points)
    counts = torch.isfinite(world).all(-1).sum(-1).clamp_min(1)
    shares = np.zeros((len(cameras), len(cameras)))
    images = iter(depths) if depths is not None else None
    for j, (camera, pose) in enumerate(zip(cameras, cam_from_world, strict=True)):
        depth = next(images) if images is not None else None
        seen = visible_points(camera, pose, world, depth)
        shares[:, j] = (seen.sum(-1) / counts).numpy()
    np.fill_diagonal(shares, 0)
    return shares


def mutual_overlap(
    cameras: Sequence[Camera],
    cam_from_world: NDArray[np.float64],
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the mutual overlap of every two frames; it ignores occlusion.

    Args:
        cameras: N cameras.
        cam_from_world: (N, 4, 4).
        points: (N, S, 3) from ``surface_points``.

    Returns:
        (N, N) in 0..1, symmetric: each frame has a share of the other's surface in view; the entry
        is the smaller share of the two. The diagonal is zero.
    """
    shares = visible_share(cameras, cam_from_world, points)
    return np.minimum(shares, shares.T)
