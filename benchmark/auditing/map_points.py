"""Check of the points of a map against its keypoints, with corrected poses and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.statements import StatedData
from objconnect.scene.checks.conventions import PIXEL_CONVENTIONS
from objconnect.scene.checks.map_check import check_map
from objconnect.scene.geometry.camera import Camera

CHECK = "points project to their keypoints"


def check_points(
    stated: StatedData,
    poses: NDArray[np.float64],
    cameras: Sequence[Camera | None],
    photographs_agree: bool,
) -> Finding:
    """Check the points of the data set's map.

    Args:
        stated: the data set, which has a map.
        poses: cam_from_world (N, 4, 4), in the convention that agrees with the photographs.
        cameras: cameras of the photographs, corrected by their matches.
        photographs_agree: whether poses and cameras agree with the photographs. If so, an offset of
            half a pixel is an error of the keypoints and not of the cameras.
    """
    sparse_map = stated.sparse_map
    assert sparse_map is not None
    images = dict(sparse_map.images)
    for name, pose, stated_camera, camera in zip(
        stated.names, poses, stated.cameras, cameras, strict=True
    ):
        if name in images:
            same_width = (
                camera is not None
                and stated_camera is not None
                and camera.width == stated_camera.width
            )
            used_camera = camera if same_width and camera is not None else images[name].camera
            images[name] = replace(images[name], cam_from_world=pose, camera=used_camera)
    if not any((image.point_rows >= 0).any() for image in images.values()):
        return unknown(CHECK, "the map has no observation")
    check = check_map(replace(sparse_map, images=images))
    if check.ok:
        return right(CHECK, check.detail, **check.figures)
    shift_px = {convention.fault: convention.principal_shift for convention in PIXEL_CONVENTIONS}
    if check.detail not in shift_px:
        return wrong(CHECK, "points-off", check.detail, **check.figures)
    if not photographs_agree:
        return wrong(CHECK, "half-pixel", check.detail, **check.figures)
    size = "large" if shift_px[check.detail] > 0 else "small"
    detail = f"keypoint coordinates are half a pixel too {size}; cameras and photographs agree"
    return wrong(CHECK, "half-pixel", detail, **check.figures)
