"""Cross-frame reprojection, which checks depth and poses of a scene against each other.

A pixel is lifted into the world by its depth and pose, projected into another frame, lifted by that
frame's depth and projected back. If both frames see the same surface, it returns to its start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.covisibility import mutual_overlap, surface_points
from objconnect.scene.checks.conventions import (
    CONVENTIONS,
    MAX_RESIDUAL_RATIO,
    OUR_CONVENTION,
    Convention,
    shift_principal_point,
)
from objconnect.scene.checks.report import Check
from objconnect.scene.geometry.camera import Camera

TOLERANCE_PX = 0.05
"""Largest median cross-frame reprojection error (px) of a valid scene."""

_MAX_PAIRS = 60
_PIXELS_PER_PAIR = 600
_MIN_OVERLAP = 0.15
# A pixel that returns within this distance saw the same surface in both frames.
_AGREEMENT_PX = 1.0


@dataclass(frozen=True)
class DepthFrames:
    """N frames with depth.

    Attributes:
        cameras: one camera per frame.
        cam_from_world: (N, 4, 4).
        depth: planar depth per frame, (H, W) metres; 0 where there is no surface.
        instance: object identifiers per frame, (H, W); surfaces are compared within one object
            only.
    """

    cameras: Sequence[Camera]
    cam_from_world: NDArray[np.float64]
    depth: Sequence[NDArray[np.float32]]
    instance: Sequence[NDArray[np.uint16]]


@dataclass(frozen=True)
class Agreement:
    """The result of a cross-frame reprojection.

    Attributes:
        residuals: distances (px) between start and return of the pixels that fall on the same
            object in the other frame.
        compared_share: share of these pixels among all sampled pixels with depth.
    """

    residuals: NDArray[np.float64]
    compared_share: float

    @property
    def median(self) -> float:
        """Return the median residual, infinite if there is none."""
        return float(np.median(self.residuals)) if len(self.residuals) else float("inf")

    @property
    def inlier_mean(self) -> float:
        """Return the mean residual under one pixel; larger ones come from other surfaces."""
        close = self.residuals[self.residuals < _AGREEMENT_PX]
        return float(close.mean()) if len(close) else float("inf")

    @property
    def agreeing_share(self) -> float:
        """Return the share of all sampled pixels with depth that return within one pixel."""
        if not len(self.residuals):
            return 0.0
        return self.compared_share * float((self.residuals < _AGREEMENT_PX).mean())


def check_depth(name: str, frames: DepthFrames) -> Check:
    """Check the cross-frame reprojection; if it fails, name the convention at fault."""
    if len(frames.cameras) < 2:
        return Check(name, True, "not checked: there is only one frame")
    ours = measure(frames, OUR_CONVENTION)
    others = [(measure(frames, convention), convention) for convention in CONVENTIONS]
    most_agreeing, convention = max(others, key=lambda item: item[0].agreeing_share)
    if MAX_RESIDUAL_RATIO * most_agreeing.agreeing_share > ours.agreeing_share:
        return Check(name, False, convention.fault, _figures(ours))
    if not len(ours.residuals):
        return Check(
            name,
            False,
            "no two frames see the same surface: they do not overlap, or poses or depths are wrong",
        )
    # A convention that fits only a few pixels explains nothing.
    candidates = [item for item in others if item[0].agreeing_share > 0.9 * ours.agreeing_share]
    closest, convention = min(
        candidates, key=lambda item: item[0].inlier_mean, default=(ours, OUR_CONVENTION)
    )
    if closest.inlier_mean < MAX_RESIDUAL_RATIO * ours.inlier_mean:
        return Check(name, False, convention.fault, _figures(ours))
    close = ours.residuals[ours.residuals < _AGREEMENT_PX]
    if not len(close):
        detail = f"none of {len(ours.residuals)} pixels returns to within {_AGREEMENT_PX:g} px"
        return Check(name, False, f"{detail}: poses or depths are wrong", _figures(ours))
    detail = (
        f"median {ours.median:.4f} px, 95 % of agreeing pixels under "
        f"{np.percentile(close, 95):.3f} px, {len(ours.residuals)} pixels"
    )
    if ours.median >= TOLERANCE_PX:
        detail += f"; expected under {TOLERANCE_PX} px: poses, depths or intrinsics are inexact"
        return Check(name, False, detail, _figures(ours))
    return Check(name, True, detail, _figures(ours))


def _figures(agreement: Agreement) -> dict[str, float]:
    pixels = float(len(agreement.residuals))
    if not pixels:
        return {"pixels": pixels}
    if not agreement.agreeing_share:
        return {"median_px": agreement.median, "agreeing_share": 0.0, "pixels": pixels}
    return {
        "median_px": agreement.median,
        "mean_px": agreement.inlier_mean,
        "agreeing_share": agreement.agreeing_share,
        "pixels": pixels,
    }


def measure(frames: DepthFrames, convention: Convention) -> Agreement:
    """Return the cross-frame reprojection in one convention, on a fixed random sample."""
    poses = convention.poses(frames.cam_from_world)
    cameras = [
        shift_principal_point(camera, convention.principal_shift) for camera in frames.cameras
    ]
    depth = [
        _planar(d, camera) if convention.radial_depth else d
        for d, camera in zip(frames.depth, cameras, strict=True)
    ]
    points = np.stack(
        [surface_points(c, p, d) for c, p, d in zip(cameras, poses, depth, strict=True)]
    )
    overlap = mutual_overlap(cameras, poses, points)
    pairs = np.argwhere(overlap > _MIN_OVERLAP)
    rng = np.random.default_rng(0)
    if len(pairs) > _MAX_PAIRS:
        pairs = pairs[rng.choice(len(pairs), _MAX_PAIRS, replace=False)]
    residuals, tried = [np.zeros(0)], 0
    for i, j in pairs.tolist():
        rows = rng.integers(0, depth[i].shape[0], _PIXELS_PER_PAIR)
        columns = rng.integers(0, depth[i].shape[1], _PIXELS_PER_PAIR)
        surface = depth[i][rows, columns] > 0
        rows, columns = rows[surface], columns[surface]
        tried += len(rows)
        start = np.stack([columns, rows], -1) + 0.5
        world = _lift(cameras[i], poses[i], start, depth[i][rows, columns])
        xy, visible = _project(cameras[j], poses[j], world)
        xy = xy[visible]
        z, same = _sample(depth[j], frames.instance[j], xy)
        same &= frames.instance[i][rows, columns][visible] == _nearest(frames.instance[j], xy)
        returned, _ = _project(cameras[i], poses[i], _lift(cameras[j], poses[j], xy[same], z[same]))
        residuals.append(np.linalg.norm(returned - start[visible][same], axis=1))
    all_residuals = np.concatenate(residuals)
    return Agreement(all_residuals, len(all_residuals) / max(tried, 1))


def _planar(distance: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Convert distances along the ray to planar depth."""
    return np.asarray(distance / _ray_lengths(camera), np.float32)


@lru_cache(maxsize=16)
def _ray_lengths(camera: Camera) -> NDArray[np.float32]:
    """Return the length of the ray with z = 1 through every pixel, (H, W)."""
    rays, _ = camera.unproject(camera.pixel_grid())
    return np.asarray(rays.norm(dim=-1).numpy(), np.float32)


def _lift(
    camera: Camera,
    pose: NDArray[np.float64],
    xy: NDArray[np.float64],
    depth: NDArray[np.float32] | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the world points (N, 3) of pixels (N, 2) with planar depth (N,), metres."""
    import torch

    rays, _ = camera.unproject(torch.from_numpy(xy))
    local = rays.numpy() * depth[:, None]
    return np.asarray((local - pose[:3, 3]) @ pose[:3, :3])


def _project(
    camera: Camera, pose: NDArray[np.float64], world: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the pixels (N, 2) of world points (N, 3), and which of them are visible, (N,)."""
    import torch

    projected = camera.project(torch.from_numpy(world @ pose[:3, :3].T + pose[:3, 3]))
    # Interpolation needs a border of one pixel.
    inside = projected.valid & camera.contains(projected.xy, border=1.0)
    return projected.xy.numpy(), inside.numpy()


def _nearest(image: NDArray[np.uint16], xy: NDArray[np.float64]) -> NDArray[np.uint16]:
    columns, rows = np.floor(xy).astype(int).T
    return np.asarray(image[rows, columns])


def _sample(
    depth: NDArray[np.float32], instance: NDArray[np.uint16], xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Interpolate depth at pixels; also return where all four neighbours are one object's surface.

    It interpolates inverse depth, which is linear over a plane, unlike depth.
    """
    x, y = (xy - 0.5).T
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    corners = [(top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)]
    fx, fy = x - left, y - top
    weights = [(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy]
    whole = np.ones(len(xy), bool)
    inverse = np.zeros(len(xy))
    for corner, weight in zip(corners, weights, strict=True):
        z = depth[corner].astype(np.float64)
        whole &= (z > 0) & (instance[corner] == instance[corners[0]])
        inverse += weight / np.where(z > 0, z, 1.0)
    return 1 / inverse, whole
