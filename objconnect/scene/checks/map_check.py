"""Checks of a sparse map: reprojection errors, and the pixel convention of query cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from objconnect.scene.checks.conventions import (
    MAX_RESIDUAL_RATIO,
    OUR_CONVENTION,
    PIXEL_CONVENTIONS,
    POSE_CONVENTIONS,
    Convention,
    shift_principal_point,
)
from objconnect.scene.checks.report import Check
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import SparseMap

# Largest median reprojection error (px) of a bundle-adjusted map.
_MAX_RESIDUAL_PX = 2.0
# Tolerance of the offset between principal points (px).
_OFFSET_TOLERANCE_PX = 0.01


def check_map(sparse_map: SparseMap) -> Check:
    """Check that points project to their observations; if not, name the convention at fault."""
    name = "map points project to their observations"
    ours = _median_residual(sparse_map, OUR_CONVENTION)
    figures = {"median_px": ours, "points": float(len(sparse_map.xyz))}
    others = [
        (_median_residual(sparse_map, convention), convention)
        for convention in (*POSE_CONVENTIONS, *PIXEL_CONVENTIONS)
    ]
    best, convention = min(others, key=lambda item: item[0])
    if best < MAX_RESIDUAL_RATIO * ours:
        return Check(name, False, convention.fault, figures)
    if not ours < _MAX_RESIDUAL_PX:
        detail = (
            f"median {ours:.2f} px, expected under {_MAX_RESIDUAL_PX} px: the map needs "
            "bundle adjustment"
        )
        return Check(name, False, detail, figures)
    return Check(name, True, f"median {ours:.3f} px over {len(sparse_map.xyz)} points", figures)


def _median_residual(sparse_map: SparseMap, convention: Convention) -> float:
    """Return the median reprojection error (px), with infinite errors behind a camera."""
    poses = convention.poses(np.stack([i.cam_from_world for i in sparse_map.images.values()]))
    converted = replace(
        sparse_map,
        images={
            image.name: replace(
                image,
                cam_from_world=pose,
                camera=shift_principal_point(image.camera, convention.principal_shift),
            )
            for image, pose in zip(sparse_map.images.values(), poses, strict=True)
        },
    )
    distances = [np.linalg.norm(converted.residuals(name), axis=1) for name in converted.names]
    observed = sum(int((image.point_rows >= 0).sum()) for image in converted.images.values())
    in_front = np.concatenate(distances)
    padded = np.concatenate([in_front, np.full(observed - len(in_front), np.inf)])
    return float(np.median(padded)) if len(padded) else float("inf")


def check_principal_points(sparse_map: SparseMap, cameras: Sequence[Camera]) -> Check:
    """Check that query cameras and map cameras of one size count pixels from the same origin."""
    name = "query cameras count pixels as the map's do"
    map_cameras = {image.camera for image in sparse_map.images.values()}
    for camera in dict.fromkeys(cameras):
        for other in map_cameras:
            if (camera.width, camera.height) != (other.width, other.height):
                continue
            offset = np.subtract(other.principal, camera.principal)
            for convention in PIXEL_CONVENTIONS:
                if np.abs(offset - convention.principal_shift).max() < _OFFSET_TOLERANCE_PX:
                    return Check(name, False, convention.fault)
    return Check(name, True, f"{len(set(cameras))} cameras")
