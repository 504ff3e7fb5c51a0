"""A sparse map as plain arrays, independent of the program that built it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.nearest import NearestNeighbours
from objconnect.scene.storage.digests import sha256

if TYPE_CHECKING:
    from objconnect.scene.geometry.pose import Pose

# Number of nearest points whose median height is taken as the height of the ground.
_GROUND_POINTS = 50


@dataclass(frozen=True)
class MapImage:
    """One registered photograph of a map.

    Attributes:
        name: path relative to the map's image folder.
        camera: calibrated camera.
        cam_from_world: (4, 4) float64.
        xy: keypoints, (K, 2) float64 COLMAP pixels.
        point_rows: row in ``SparseMap.xyz`` of the point that each keypoint observes, (K,); -1 for
            none.
    """

    name: str
    camera: Camera
    cam_from_world: NDArray[np.float64]
    xy: NDArray[np.float64]
    point_rows: NDArray[np.int64]

    @property
    def pose(self) -> Pose:
        """Return ``cam_from_world`` as a pose."""
        from objconnect.scene.geometry.pose import Pose

        return Pose.from_matrix(self.cam_from_world)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Return the camera centre, (3,) world metres."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])


@dataclass(frozen=True)
class SparseMap:
    """Posed photographs and the 3D points observed in them.

    Attributes:
        images: photographs by name.
        xyz: points, (M, 3) float64 world metres.
        rgb: colours of the points, (M, 3) uint8.
        error: mean reprojection error of each point, (M,) pixels.
        track_length: number of photographs that observe each point, (M,).
        features: file of the features that the map was built from, or None.
    """

    images: Mapping[str, MapImage]
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    error: NDArray[np.float64]
    track_length: NDArray[np.int64]
    features: Path | None = field(default=None, compare=False)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the sorted image names; per-image arrays are in this order."""
        return tuple(sorted(self.images))

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Return the camera centres in the order of ``names``, (N, 3) world metres."""
        return np.array([self.images[n].centre for n in self.names]).reshape(-1, 3)

    def height_above(self, position: NDArray[np.float64]) -> float:
        """Return the height (m) of a position (3,) above the map's points below it.

        It uses the median of the horizontally nearest points, so points on roofs and walls have no
        effect unless they are the majority.
        """
        nearest = self._nearest_points(position[:2], _GROUND_POINTS)
        return float(position[2] - np.median(self.xyz[nearest, 2]))

    def drop_points(self, removed: NDArray[np.bool_]) -> SparseMap:
        """Return the map without the points of a mask (M,).

        Keypoints that observed a removed point stay and observe none.
        """
        row = np.where(removed, -1, np.cumsum(~removed) - 1)
        images = {
            name: replace(
                image, point_rows=np.where(image.point_rows < 0, -1, row[image.point_rows])
            )
            for name, image in self.images.items()
        }
        remaining = ~removed
        return SparseMap(
            images,
            self.xyz[remaining],
            self.rgb[remaining],
            self.error[remaining],
            self.track_length[remaining],
        )

    def transform(self, similarity: NDArray[np.float64]) -> SparseMap:
        """Return the map under a similarity transform (3, 4): scale times rotation, translation."""
        linear = similarity[:, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        images = {}
        for name, image in self.images.items():
            pose = np.eye(4)
            pose[:3, :3] = image.cam_from_world[:3, :3] @ linear.T / scale
            pose[:3, 3] = -pose[:3, :3] @ (linear @ image.centre + similarity[:, 3])
            images[name] = replace(image, cam_from_world=pose)
        return replace(self, images=images, xyz=self.xyz @ linear.T + similarity[:, 3])

    @cached_property
    def _nearest_points(self) -> NearestNeighbours:
        return NearestNeighbours(self.xyz[:, :2])

    @cached_property
    def sha256(self) -> str:
        """Return a digest of what localizers read: cameras, poses, observations and points.

        Colours and reprojection errors are not part of it.
        """
        pieces: list[str | NDArray[Any]] = []
        for name in self.names:
            image = self.images[name]
            pieces.append(json.dumps([name, str(image.camera), len(image.xy)]))
            pieces += [image.cam_from_world, image.xy, image.point_rows]
        return sha256(*pieces, self.xyz, self.track_length)

    def reprojection_error(self) -> float:
        """Return the mean distance (px) between keypoints and projected points; NaN without any."""
        residuals = [self.residuals(name) for name in self.names]
        stacked = np.concatenate(residuals) if residuals else np.zeros((0, 2))
        return float(np.linalg.norm(stacked, axis=1).mean()) if len(stacked) else float("nan")

    def residuals(self, name: str) -> NDArray[np.float64]:
        """Return observed minus projected pixels of one image's points, (K', 2).

        Points that do not project into the image's camera are left out.
        """
        import torch

        image = self.images[name]
        seen = image.point_rows >= 0
        points = torch.from_numpy(self.xyz[image.point_rows[seen]])
        projected = image.camera.project(image.pose.transform(points))
        error = image.xy[seen] - projected.xy.numpy()
        return np.asarray(error[projected.valid.numpy()])
