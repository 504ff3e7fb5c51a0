"""Triangulate points from detections in several photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.supplement.association import Detections, Pairs, associate, directions
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar

# Maximum iterations of Gauss-Newton; two or three are enough from a linear solution.
_ROUNDS = 10
_CONVERGED_M = 1e-6
# Minimum number of rays of a point.
_MIN_RAYS = 2
# Number of proposals compared with the detections of a photograph at once.
_CHUNK = 4096


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


def associate_and_triangulate(
    sparse_map: SparseMap, detections: Mapping[str, Detections], config: SupplementConfig
) -> list[TriangulatedPoint]:
    """Associate detections across photographs and triangulate them with known poses.

    Every pair of detections proposes a point. Detections near its projection and similar to the
    pair support it. Points are accepted in descending order of support, and triangulated again from
    all their detections. Each detection is used once.

    Args:
        sparse_map: map with the poses, which are not changed.
        detections: detections by name of the photograph.
        config: thresholds.

    Returns:
        Points in the order in which they were accepted.
    """
    pairs = associate(sparse_map, detections, config)
    proposals = _propose(sparse_map, detections, pairs)
    members = _find_support(sparse_map, detections, pairs, proposals, config)
    order = np.argsort(-(members >= 0).sum(1), kind="stable")
    is_used = {name: np.zeros(len(detected.xy), bool) for name, detected in detections.items()}
    points = []
    for proposal in order.tolist():
        rows = {
            name: int(row)
            for name, row in zip(sparse_map.names, members[proposal], strict=True)
            if row >= 0 and not is_used[name][row]
        }
        point = triangulate(sparse_map, detections, rows, config)
        if point is not None:
            points.append(point)
            for name, row in point.rows.items():
                is_used[name][row] = True
    return points


def _propose(
    sparse_map: SparseMap, detections: Mapping[str, Detections], pairs: Pairs
) -> NDArray[np.float64]:
    """Triangulate each pair of detections, (E, 3)."""
    normalised, poses = np.zeros((len(pairs), 2, 2)), np.zeros((len(pairs), 2, 3, 4))
    for view, name in enumerate(sparse_map.names):
        is_in_view = pairs.views == view
        if is_in_view.any():
            image = sparse_map.images[name]
            all_of_view = _normalise(image, detections[name].xy)
            normalised[is_in_view] = all_of_view[pairs.rows[is_in_view]]
            poses[is_in_view] = image.cam_from_world[:3]
    return triangulate_linearly(normalised, poses)


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


def _find_support(
    sparse_map: SparseMap,
    detections: Mapping[str, Detections],
    pairs: Pairs,
    proposals: NDArray[np.float64],
    config: SupplementConfig,
) -> NDArray[np.int64]:
    """Return the detection at the projection of each proposal, -1 for none, (E, N)."""
    members = np.full((len(pairs), len(sparse_map.names)), -1)
    mean_descriptors = _mean_descriptors(sparse_map, detections, pairs)
    with progress_bar("support", len(sparse_map.names)) as advance:
        for view, name in enumerate(sparse_map.names):
            detected = detections.get(name)
            if detected is not None and len(detected.xy):
                image = sparse_map.images[name]
                local = image.pose.transform(torch.from_numpy(proposals))
                projected = image.camera.project(local)
                for start in range(0, len(pairs), _CHUNK):
                    part = slice(start, start + _CHUNK)
                    distance = torch.cdist(
                        projected.xy[part], torch.from_numpy(detected.xy)
                    ).numpy()
                    similarity = mean_descriptors[part] @ detected.descriptors.T
                    is_out = (similarity < config.similarity) | ~projected.valid[part].numpy()[
                        :, None
                    ]
                    distance[is_out] = np.inf
                    near = distance.min(1) < config.reprojection_px
                    members[part, view] = np.where(near, distance.argmin(1), -1)
            advance(view + 1)
    return members


def _mean_descriptors(
    sparse_map: SparseMap, detections: Mapping[str, Detections], pairs: Pairs
) -> NDArray[np.float32]:
    """Return the mean descriptor (E, D) of each pair, of unit length."""
    width = max((detected.descriptors.shape[1] for detected in detections.values()), default=0)
    total = np.zeros((len(pairs), width), np.float32)
    for view, name in enumerate(sparse_map.names):
        for side in range(2):
            is_in_view = pairs.views[:, side] == view
            if is_in_view.any():
                total[is_in_view] += detections[name].descriptors[pairs.rows[is_in_view, side]]
    length = np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12)
    return np.asarray(total / length, np.float32)


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
        residuals, derivatives = _residuals(images, xy, xyz)
        known = np.isfinite(residuals).all(1)
        if known.sum() < _MIN_RAYS:
            break
        jacobian = derivatives[known].reshape(-1, 3)
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
    residuals, derivatives = np.full(xy.shape, np.inf), np.zeros((len(xy), 2, 3))
    poses = np.stack([image.cam_from_world for image in images])
    local = poses[:, :3, :3] @ xyz + poses[:, :3, 3]
    for camera in dict.fromkeys(image.camera for image in images):
        has_camera = np.array([image.camera == camera for image in images])
        projected = camera.project(torch.from_numpy(local[has_camera]), jacobian=True)
        assert projected.jacobian is not None
        valid = projected.valid.numpy()[:, None]
        residuals[has_camera] = np.where(valid, xy[has_camera] - projected.xy.numpy(), np.inf)
        derivatives[has_camera] = projected.jacobian.numpy() @ poses[has_camera, :3, :3]
    return residuals, derivatives


def _normalise(image: MapImage, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x/z and y/z of pixels (K, 2)."""
    return np.asarray(image.camera.unproject(torch.from_numpy(xy))[0][..., :2])
