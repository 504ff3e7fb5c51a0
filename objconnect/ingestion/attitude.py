"""Gimbal attitudes in EXIF: their errors, and photographs that were rotated afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.ingestion.georegister import Georegistration
from objconnect.ingestion.photographs import FlightImage
from objconnect.scene.geometry.gimbal import gimbal_angles as gimbal_angles
from objconnect.scene.geometry.gimbal import gimbal_pose as gimbal_pose
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import SparseMap

# A photograph contradicts its gimbal if their attitudes differ by more than this. Errors of gimbals
# are usually a few degrees; errors of compasses are larger.
_MAX_ERROR_DEG: Final = 30.0
# Lower bound of the standard deviation, because gimbals write tenths of a degree.
_MIN_SIGMA_DEG: Final = 0.1
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def find_upside_down(
    model: SparseMap,
    georegistration: Georegistration,
    images: Sequence[FlightImage],
    upright_count: int = 0,
) -> set[str]:
    """Return the names of photographs that were rotated by 180 degrees after they were taken.

    The attitude of such a photograph differs from that of its gimbal by 180 degrees, while more
    photographs agree with their gimbals. It has the same lens as the others, but its principal
    point is mirrored.

    Args:
        model: The model, in its own frame.
        georegistration: Position, rotation and scale of the model in the world.
        images: Photographs of the model; there may be others.
        upright_count: Number of other photographs that are known to agree with their gimbals.
    """
    linear = georegistration.world_from_model[:, :3]
    world_from_model = linear / np.cbrt(np.linalg.det(linear))
    rotated, upright = set(), upright_count
    for image in images:
        if image.exif.gimbal is None or image.name not in model.images:
            continue
        rotation = model.images[image.name].cam_from_world[:3, :3] @ world_from_model.T
        upright += _error_deg(image, rotation) < _MAX_ERROR_DEG
        if _error_deg(image, _HALF_TURN @ rotation) < _MAX_ERROR_DEG:
            rotated.add(image.name)
    return rotated if len(rotated) < upright else set()


def _error_deg(image: FlightImage, cam_from_world: NDArray[np.float64]) -> float:
    """Return the angle between the gimbal and a rotation (3, 3) of the camera."""
    assert image.exif.gimbal is not None
    gimbal = gimbal_pose(*image.exif.gimbal)
    return float(gimbal.error_to(Pose(torch.tensor(cam_from_world), gimbal.translation))[1])


def read_attitudes(
    images: Sequence[FlightImage],
    poses: NDArray[np.float64],
    queries: set[str],
) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, float]]:
    """Return the gimbal's attitudes, their standard deviations, and the errors of wrong ones.

    Args:
        images: The photographs.
        poses: Poses ``cam_from_world`` (N, 4, 4) of the photographs.
        queries: Names of the queries. The sigma is measured on the other photographs if one of
            them has an attitude, else on the queries.

    Returns:
        Quaternions (N, 4), w x y z, and their sigma (N,) in degrees per axis, both NaN for a
        photograph without a usable attitude; and the error in degrees of each attitude that
        contradicts its photograph, by file.
    """
    quaternions = np.full((len(images), 4), np.nan)
    errors = np.full(len(images), np.nan)
    for k, image in enumerate(images):
        if image.exif.gimbal is not None:
            quaternions[k] = gimbal_pose(*image.exif.gimbal).quaternion().numpy()
            errors[k] = _error_deg(image, poses[k, :3, :3])
    wrong = errors > _MAX_ERROR_DEG
    blunders = {images[k].file: float(errors[k]) for k in np.flatnonzero(wrong)}
    quaternions[wrong] = errors[wrong] = np.nan
    known = np.isfinite(errors)
    measured = known & np.array([image.name not in queries for image in images])
    if not measured.any():
        measured = known
    sigma = np.sqrt((errors[measured] ** 2).mean() / 3) if known.any() else np.nan
    sigma = np.maximum(sigma, _MIN_SIGMA_DEG)
    return quaternions, np.where(known, sigma, np.nan), blunders
