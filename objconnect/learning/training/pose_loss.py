"""The loss of PixLoc: the reprojection error of the poses of an alignment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor

from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.projection import Intrinsics

# Upper bound of the ``reprojection_error`` of a level in the loss.
_MAX_ERROR: Final = 50.0
# A level adds to the loss only if the ``reprojection_error`` after the coarser level is less than
# this many strides of the coarser level.
_NEAR_STRIDES: Final = 3.0
# Least number of points of a pair that adds to the loss.
_MIN_POINTS: Final = 10


class VisiblePoints(NamedTuple):
    """Points in the view of a camera, batched (B).

    Attributes:
        points: points (B, N, 3), metres in the frame of the poses.
        intrinsics: intrinsics of the cameras, batch shape (B,).
        valid: points (B, N) to use, bool.
    """

    points: Tensor
    intrinsics: Intrinsics
    valid: Tensor


def reprojection_error(
    pose: Pose, truth: Pose, points: Tensor, intrinsics: Intrinsics, valid: Tensor
) -> Tensor:
    """Return the mean pseudo-Huber function (B,) of the distances between projections by two poses.

    ``convert_to_pixels`` converts it to pixels.

    Args:
        pose: estimated ``cam_from_world``, batch shape (B,).
        truth: true ``cam_from_world``, batch shape (B,).
        points: points (B, N, 3), world metres.
        intrinsics: intrinsics of the cameras, batch shape (B,).
        valid: (B, N) bool, points to use; points behind a camera are left out too.
    """
    estimated, true = (
        intrinsics.project(each.to(dtype=points.dtype).transform(points)) for each in (pose, truth)
    )
    used = valid & estimated.valid & true.valid
    squared = torch.where(used[..., None], estimated.xy - true.xy, 0).square().sum(-1)
    # It is quadratic below about 2 px and linear above (Barron's general loss, CVPR 2019, with
    # shape 1 and scale 2, up to a factor).
    robust = 2 * (torch.sqrt(squared / 4 + 1) - 1)
    return torch.as_tensor(robust.sum(-1) / used.sum(-1).clamp(min=1))


def convert_to_pixels(error: Tensor) -> Tensor:
    """Return the distance in pixels whose pseudo-Huber function is ``error``."""
    return 2 * ((error / 2 + 1).square() - 1).sqrt()


def pose_loss(
    level_poses: Sequence[Pose],
    strides: Sequence[int],
    truth: Pose,
    visible: VisiblePoints,
) -> tuple[Tensor, list[Tensor]]:
    """Return the loss of a batch, and the ``reprojection_error`` (B,) after each level.

    Each level has the same weight, and its ``reprojection_error`` is clamped to 50. A level is used
    only if that error after the coarser level is less than three times the stride of the coarser
    level, because finer features cannot correct larger errors. Pairs with fewer than ten points add
    zero to the mean.

    Args:
        level_poses: poses after each level, coarse to fine. No gradient flows between levels.
        strides: strides of the levels.
        truth: true poses, as for ``reprojection_error``.
        visible: the points in view.
    """
    errors = [reprojection_error(pose, truth, *visible) for pose in level_poses]
    enough = visible.valid.sum(-1) >= _MIN_POINTS
    used = enough
    total = torch.zeros_like(errors[0])
    for error, stride in zip(errors, strides, strict=True):
        total = total + torch.where(used, error.clamp(max=_MAX_ERROR), 0) / len(errors)
        used = enough & (error < _NEAR_STRIDES * stride)
    return total.mean(), [error.detach() for error in errors]
