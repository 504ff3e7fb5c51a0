"""A sparse map as plain arrays, whatever program built it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scene.geometry.camera import Camera
from scene.geometry.nearest import Nearest
from scene.geometry.pose import Pose

# So many points say how high the ground is.
_AROUND = 50


@dataclass(frozen=True)
class MapImage:
    """One registered photograph of a map.

    Attributes:
        name: path relative to the map's image folder.
        camera: calibrated.
        cam_from_world: (4, 4) float64.
        xy: (K, 2) float64 observed keypoints, COLMAP pixels.
        point_rows: (K,) row of the observed point in ``SparseMap.xyz``, -1 where there is none.
    """

    name: str
    camera: Camera
    cam_from_world: NDArray[np.float64]
    xy: NDArray[np.float64]
    point_rows: NDArray[np.int64]

    @property
    def pose(self) -> Pose:
        """``cam_from_world`` as a pose."""
        return Pose.from_matrix(self.cam_from_world)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Camera centre in world metres, (3,)."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])


@dataclass(frozen=True)
class SparseMap:
    """Posed photographs and the points seen in them.

    Attributes:
        images: by name.
        xyz: (M, 3) float64 points, world metres.
        rgb: (M, 3) uint8 colours.
        error: (M,) mean reprojection error, pixels.
        track_length: (M,) number of photographs that observe each point.
    """

    images: Mapping[str, MapImage]
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    error: NDArray[np.float64]
    track_length: NDArray[np.int64]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Image names, sorted: the order of every per-image array of the project."""
        return tuple(sorted(self.images))

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Camera centres in the order of ``names``, (N, 3) world metres."""
        return np.array([self.images[n].centre for n in self.names]).reshape(-1, 3)

    def height_above(self, position: NDArray[np.float64]) -> float:
        """Height (m) of a position (3,) over the points around the foot of its plumb line.

        Their median: points on roofs and walls are outnumbered, unless one stands among them.
        """
        nearest = self._nearest_points(position[:2], _AROUND)
        return float(position[2] - np.median(self.xyz[nearest, 2]))

    def without(self, gone: NDArray[np.bool_]) -> SparseMap:
        """The map less some of its points (M,); keypoints stay, and observe nothing."""
        row = np.where(gone, -1, np.cumsum(~gone) - 1)
        images = {
            name: replace(
                image, point_rows=np.where(image.point_rows < 0, -1, row[image.point_rows])
            )
            for name, image in self.images.items()
        }
        left = ~gone
        return SparseMap(
            images, self.xyz[left], self.rgb[left], self.error[left], self.track_length[left]
        )

    @cached_property
    def _nearest_points(self) -> Nearest:
        return Nearest(self.xyz[:, :2])

    @cached_property
    def sha256(self) -> str:
        """Digest of cameras, poses, observations and points, of all that localizers read; colours
        and errors are left out."""
        digest = hashlib.sha256()
        for name in self.names:
            image = self.images[name]
            digest.update(json.dumps([name, str(image.camera), len(image.xy)]).encode())
            for array in (image.cam_from_world, image.xy, image.point_rows):
                digest.update(np.ascontiguousarray(array).tobytes())
        for array in (self.xyz, self.track_length):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def reprojection_error(self) -> float:
        """Mean distance (px) between observed keypoints and projected points; NaN when none."""
        residuals = [self.residuals(name) for name in self.names]
        stacked = np.concatenate(residuals) if residuals else np.zeros((0, 2))
        return float(np.linalg.norm(stacked, axis=1).mean()) if len(stacked) else float("nan")

    def residuals(self, name: str) -> NDArray[np.float64]:
        """Observed minus projected pixels of one image's points, (K', 2)."""
        import torch

        image = self.images[name]
        seen = image.point_rows >= 0
        points = torch.from_numpy(self.xyz[image.point_rows[seen]])
        projected = image.camera.project(image.pose.transform(points))
        error = image.xy[seen] - projected.xy.numpy()
        return np.asarray(error[projected.valid.numpy()])
