"""How far off the poses of an alignment put the points: what PixLoc is trained by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from baselines.training.options import LOSSES, LossOptions
from scene.geometry.pose import Pose
from scene.geometry.projection import Intrinsics


class Seen(NamedTuple):
    """Points as a camera sees them, batched (B).

    Attributes:
        points: (B, N, 3) world.
        intrinsics: of the camera.
        valid: (B, N) points to use.
    """

    points: Tensor
    intrinsics: Intrinsics
    valid: Tensor


def reprojection_error(
    pose: Pose, truth: Pose, points: Tensor, intrinsics: Intrinsics, valid: Tensor
) -> Tensor:
    """Mean pseudo-Huber distance of the points' projections by two poses, (B,); see ``in_pixels``.

    Args:
        pose: ``camera_from_world``, batched (B).
        truth: likewise.
        points: (B, N, 3) world.
        intrinsics: batched (B).
        valid: (B, N) points to use; those behind a camera are left out too.
    """
    ours, true = (
        intrinsics.project(each.to(dtype=points.dtype).transform(points)) for each in (pose, truth)
    )
    used = valid & ours.valid & true.valid
    squared = torch.where(used[..., None], ours.xy - true.xy, 0).square().sum(-1)
    # Barron's general loss (CVPR 2019) at shape 1 and scale 2, over 4: quadratic, then linear.
    robust = 2 * (torch.sqrt(squared / 4 + 1) - 1)
    return torch.as_tensor(robust.sum(-1) / used.sum(-1).clamp(min=1))


def in_pixels(error: Tensor) -> Tensor:
    """The distance in pixels whose pseudo-Huber function is ``error``."""
    return 2 * ((error / 2 + 1).square() - 1).sqrt()


def pose_loss(
    by_level: Sequence[Pose],
    strides: Sequence[int],
    truth: Pose,
    seen: Seen,
    options: LossOptions = LOSSES,
) -> tuple[Tensor, list[Tensor]]:
    """The loss of a batch, and the error (B,) after each level.

    Each level counts equally, up to ``pose_clamp_px``, and only where the coarser one ended within
    ``near_cells``: finer features cannot mend what lies beyond their reach. A pair with fewer than
    ``min_points`` counts for nothing.

    Args:
        by_level: poses after each level, coarse to fine; no gradient between them.
        strides: of the levels.
        truth: as of ``reprojection_error``.
        seen: the points.
        options: the limits named above.
    """
    errors = [reprojection_error(pose, truth, *seen) for pose in by_level]
    enough = seen.valid.sum(-1) >= options.min_points
    counts = enough
    total = torch.zeros_like(errors[0])
    for error, stride in zip(errors, strides, strict=True):
        total = total + torch.where(counts, error.clamp(max=options.pose_clamp_px), 0) / len(errors)
        counts = enough & (error < options.near_cells * stride)
    return total.mean(), [error.detach() for error in errors]
