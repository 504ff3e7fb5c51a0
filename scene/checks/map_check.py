"""Does a sparse map agree with itself, and do the cameras of queries agree with it?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scene.checks.conventions import OURS, PIXEL_READINGS, POSE_READINGS, Reading, shifted
from scene.checks.report import Check
from scene.geometry.camera import Camera
from scene.maps.sparse_map import SparseMap

# A map whose points miss their observations by more than this (median, px) is not adjusted.
_MAX_RESIDUAL_PX = 2.0
# Another reading explains a map when its residual is this much smaller than ours.
_EXPLAINS = 0.5
# Principal points this close (px) come from one calibration.
_SAME_PX = 0.01


def check_map(sparse_map: SparseMap) -> Check:
    """Points must project to where they were observed; when not, name the convention at fault."""
    name = "map points project to their observations"
    ours = _median_residual(sparse_map, OURS)
    figures = {"median_px": ours, "points": float(len(sparse_map.xyz))}
    others = [
        (_median_residual(sparse_map, reading), reading)
        for reading in (*POSE_READINGS, *PIXEL_READINGS)
    ]
    best, reading = min(others, key=lambda item: item[0])
    if best < _EXPLAINS * ours:
        return Check(name, False, reading.fault, figures)
    if not ours < _MAX_RESIDUAL_PX:
        detail = f"median {ours:.2f} px, expected under {_MAX_RESIDUAL_PX} px: it is not adjusted"
        return Check(name, False, detail, figures)
    return Check(name, True, f"median {ours:.3f} px over {len(sparse_map.xyz)} points", figures)


def _median_residual(sparse_map: SparseMap, reading: Reading) -> float:
    """Median distance (px) of observations from projected points, infinite behind the camera."""
    poses = reading.poses(np.stack([i.cam_from_world for i in sparse_map.images.values()]))
    read = replace(
        sparse_map,
        images={
            image.name: replace(
                image,
                cam_from_world=pose,
                camera=shifted(image.camera, reading.principal_shift),
            )
            for image, pose in zip(sparse_map.images.values(), poses, strict=True)
        },
    )
    distances = [np.linalg.norm(read.residuals(name), axis=1) for name in read.names]
    observed = sum(int((image.point_rows >= 0).sum()) for image in read.images.values())
    found = np.concatenate(distances)
    padded = np.concatenate([found, np.full(observed - len(found), np.inf)])
    return float(np.median(padded)) if len(padded) else float("inf")


def check_principal_points(sparse_map: SparseMap, cameras: Sequence[Camera]) -> Check:
    """Query cameras and map cameras of one size must count pixels from the same origin."""
    name = "query cameras count pixels as the map's do"
    mapped = {image.camera for image in sparse_map.images.values()}
    for camera in dict.fromkeys(cameras):
        for other in mapped:
            if (camera.width, camera.height) != (other.width, other.height):
                continue
            offset = np.subtract(other.principal, camera.principal)
            for reading in PIXEL_READINGS:
                if np.abs(offset - reading.principal_shift).max() < _SAME_PX:
                    return Check(name, False, reading.fault)
    return Check(name, True, f"{len(set(cameras))} cameras")
