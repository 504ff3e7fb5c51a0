"""Does a sparse map agree with itself, and do reference poses belong to it?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scene.camera import Camera
from scene.conventions import OURS, PIXEL_READINGS, POSE_READINGS, Reading, shifted
from scene.report import Check
from scene.sparse_map import SparseMap

# A map whose points miss their observations by more than this (median, px) is not adjusted.
_MAX_RESIDUAL_PX = 2.0
# Another reading explains a map when its residual is this much smaller than ours.
_EXPLAINS = 0.5


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


def check_reference_poses(
    sparse_map: SparseMap, cameras: Sequence[Camera], cam_from_world: NDArray[np.float64]
) -> Check:
    """Queries must have been taken near the map's cameras, looking the way those look.

    Args:
        sparse_map: the map.
        cameras: of the queries, N of them.
        cam_from_world: (N, 4, 4) reference poses as written.
    """
    name = "reference poses belong to the map"
    for camera in dict.fromkeys(cameras):
        for image in sparse_map.images.values():
            other = image.camera
            if (camera.width, camera.height) != (other.width, other.height):
                continue
            offset = np.subtract(camera.principal, other.principal)
            for reading in PIXEL_READINGS:
                if np.abs(offset + reading.principal_shift).max() < 0.01:
                    return Check(name, False, f"{reading.fault} (the map's cameras differ)")
    ours = _strangeness(sparse_map, cam_from_world)
    others = [(_strangeness(sparse_map, r.poses(cam_from_world)), r) for r in POSE_READINGS]
    best, reading = min(others, key=lambda item: item[0])
    figures = {"strangeness": ours}
    # A query may well be flown beside the map; only a reading that fits far better is a finding.
    if ours > 1 and best < _EXPLAINS * ours:
        return Check(name, False, reading.fault, figures)
    return Check(name, True, f"{len(cameras)} poses lie among the map's cameras", figures)


def _strangeness(sparse_map: SparseMap, cam_from_world: NDArray[np.float64]) -> float:
    """How unlike the nearest map camera a typical query is: its distance in units of the map's
    extent, and the angle between the optical axes in units of 45 degrees."""
    centres = sparse_map.centres
    axes = np.stack([sparse_map.images[n].cam_from_world[2, :3] for n in sparse_map.names])
    extent = float(np.linalg.norm(np.ptp(centres, axis=0))) or 1.0
    rotation, translation = cam_from_world[:, :3, :3], cam_from_world[:, :3, 3]
    query_centres = -np.einsum("nji,nj->ni", rotation, translation)
    distance = np.linalg.norm(query_centres[:, None] - centres[None], axis=2)
    nearest = distance.argmin(1)
    cosine = (rotation[:, 2] * axes[nearest]).sum(1).clip(-1, 1)
    angle = np.degrees(np.arccos(cosine)) / 45
    return float(np.median(distance.min(1) / (0.1 * extent) + angle))
