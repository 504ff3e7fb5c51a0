"""Triangulate points from detections in several photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

# Maximum iterations of Gauss-Newton; two or three are enough from a linear solution.
_ROUNDS = 10
_CONVERGED_M = 1e-6
# Minimum number of rays of a point.
_MIN_RAYS = 2


@dataclass(frozen=True)
class Detections:
    """Detected centres of objects in one photograph.

    Attributes:
        xy: positions (K, 2), COLMAP pixels.
        descriptors: descriptors (K, D) of unit length.
        confidence: confidence (K,), 0 to 1.
    """

    xy: NDArray[np.float64]
    descriptors: NDArray[np.float32]
    confidence: NDArray[np.float64]


@dataclass(frozen=True)
class TriangulatedPoint:
    """A triangulated centre of an object.

    Attributes:
        xyz: position (3,), world metres.
        rows: row of the detection, by name of the photograph.
        error_px: mean reprojection error.
        angle_deg: largest angle between two rays.
        confidence: mean confidence of the detections.
    """

    xyz: NDArray[np.float64]
    rows: Mapping[str, int]
    error_px: float
    angle_deg: float
    confidence: float


def triangulate_linearly(
    normalised: NDArray[np.float64], cam_from_world: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Triangulate points (T, 3) by the direct linear transform.

    Source: Hartley and Zisserman, Multiple View Geometry, 12.2.

    Args:
        normalised: observations x/z, y/z (T, V, 2).
        cam_from_world: poses (T, V, 3, 4).

    Returns:
        The points; those at infinity are not finite.
    """
    x, y = normalised[..., :1], normalised[..., 1:]
    first, second, third = (cam_from_world[..., k, :] for k in range(3))
    system = np.concatenate([x * third - first, y * third - second], -2)
    solution = np.linalg.svd(system)[2][..., -1, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(solution[..., :3] / solution[..., 3:])


def triangulate(
    sparse_map: SparseMap,
    detections: Mapping[str, Detections],
    rows: Mapping[str, int],
    config: SupplementConfig,
) -> TriangulatedPoint | None:
    """Triangulate a point from detections, and drop outliers.

    Args:
        sparse_map: map with the poses.
        detections: detections by photograph.
        rows: row of the detection, by name of the photograph.
        config: thresholds.

    Returns:
        The point, or None where too few detections remain or their rays are nearly parallel.
    """
    while len(rows) >= config.views:
        images = [sparse_map.images[name] for name in rows]
        xy = np.array([detections[name].xy[row] for name, row in rows.items()])
        xyz = _intersect_rays(images, xy)
        residuals, _ = _residuals(images, xy, xyz)
        error = np.linalg.norm(residuals, axis=1)
        good = error < config.reprojection_px
        if good.all():
            rays = np.concatenate([directions(i, p[None]) for i, p in zip(images, xy, strict=True)])
            angle = float(np.degrees(np.arccos((rays @ rays.T).clip(-1, 1).min())))
            if angle < config.angle_deg:
                return None
            confidences = [detections[name].confidence[row] for name, row in rows.items()]
            return TriangulatedPoint(
                xyz, rows, float(error.mean()), angle, float(np.mean(confidences))
            )
        rows = {name: row for (name, row), kept in zip(rows.items(), good, strict=True) if kept}
    return None


def _intersect_rays(images: Sequence[MapImage], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the point (3,) of least reprojection error, by Gauss-Newton from a linear solution."""
    normalised = np.concatenate([_normalise(i, p[None]) for i, p in zip(images, xy, strict=True)])
    poses = np.stack([image.cam_from_world[:3] for image in images])
    xyz: NDArray[np.float64] = triangulate_linearly(normalised[None], poses[None])[0]
    for _ in range(_ROUNDS):
        residuals, slope = _residuals(images, xy, xyz)
        known = np.isfinite(residuals).all(1)
        if known.sum() < _MIN_RAYS:
            break
        jacobian = slope[known].reshape(-1, 3)
        step = np.linalg.lstsq(jacobian, residuals[known].ravel(), rcond=None)[0]
        xyz = xyz + step
        if np.linalg.norm(step) < _CONVERGED_M:
            break
    return xyz


def _residuals(
    images: Sequence[MapImage], xy: NDArray[np.float64], xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return detections minus projections of a point, (V, 2), and their derivatives (V, 2, 3).

    Residuals are infinite behind a camera. The derivatives are those of the projections.
    """
    residuals, slope = np.full(xy.shape, np.inf), np.zeros((len(xy), 2, 3))
    poses = np.stack([image.cam_from_world for image in images])
    local = poses[:, :3, :3] @ xyz + poses[:, :3, 3]
    for camera in dict.fromkeys(image.camera for image in images):
        has_camera = np.array([image.camera == camera for image in images])
        projected = camera.project(torch.from_numpy(local[has_camera]), jacobian=True)
        assert projected.jacobian is not None
        valid = projected.valid.numpy()[:, None]
        residuals[has_camera] = np.where(valid, xy[has_camera] - projected.xy.numpy(), np.inf)
        slope[has_camera] = projected.jacobian.numpy() @ poses[has_camera, :3, :3]
    return residuals, slope


def _normalise(image: MapImage, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x/z and y/z of pixels (K, 2)."""
    return np.asarray(image.camera.unproject(torch.from_numpy(xy))[0][..., :2])


def directions(image: MapImage, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rays (K, 3) of pixels (K, 2), unit vectors in the world; NaN without a ray."""
    rays, valid = image.camera.unproject(torch.from_numpy(xy))
    world = torch.nn.functional.normalize(rays, dim=-1).numpy() @ image.cam_from_world[:3, :3]
    return np.where(valid.numpy()[:, None], world, np.nan)
