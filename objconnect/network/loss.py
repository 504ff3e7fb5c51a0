"""Training losses: equations (6) to (8) of the object-connect paper, and a contrastive loss.

Equation (6) is the sum of (7), the distance of features, and (8), the distance of projections.
Equation (7) alone is smallest if all features are equal. Features are therefore normalised, and
the contrastive loss of ``learning.training.contrastive`` is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from objconnect.learning.training.contrastive import sample
from objconnect.learning.training.options import LOSSES, LossOptions
from objconnect.learning.training.pairs import PairBatch
from objconnect.learning.training.pose_loss import VisiblePoints, pose_loss
from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.pose import Pose

# Objects with fewer points in image a are left out of the loss of the confidence.
_MIN_POINTS: Final = 4


def feature_distance(levels: Sequence[Level], batch: PairBatch) -> Tensor:
    """Equation (7), L_2d-f: mean over levels and points of |F_2(project(X)) - F_1(X)|.

    It is computed at the true pose of image 2. The paper uses the predicted pose. At the end of
    training the two are nearly equal; at the beginning, the predicted pose would make features of
    different points similar.

    Args:
        levels: features of unit length.
        batch: pairs, whose ``xy_b`` are the projections by the true pose.
    """
    count = batch.valid.sum().clamp(min=1)
    distances = []
    for level in levels:
        assert not isinstance(level.stride, tuple)
        features_b = functional.normalize(sample(level.features, batch.xy_b / level.stride), dim=-1)
        # 1e-8 is added because the square root has no derivative at zero.
        squared = (features_b - level.reference).square().sum(-1)
        distances.append(((squared + 1e-8).sqrt() * batch.valid).sum() / count)
    return torch.stack(distances).mean()


def pose_distance(
    level_poses: Sequence[Pose],
    strides: Sequence[int],
    batch: PairBatch,
) -> tuple[Tensor, list[Tensor]]:
    """Equation (8), L_3d-d: mean over levels of the Huber distance of projections by two poses.

    It is the pseudo-Huber function up to 50 pixels, and a finer level is used only if the coarser
    one ended near the truth. PixLoc is trained in the same way, so the two methods differ in their
    features alone.

    Args:
        level_poses: predicted poses after each level, coarse to fine.
        strides: strides of the levels.
        batch: pairs with the true poses.

    Returns:
        The loss, and the mean pseudo-Huber distance (B,) after each level (``pose_loss``).
    """
    visible = VisiblePoints(batch.points, batch.intrinsics_b, batch.valid)
    return pose_loss(level_poses, strides, batch.b_from_a, visible)


def total(
    contrast: Tensor, features: Tensor, poses: Tensor | None, options: LossOptions = LOSSES
) -> Tensor:
    """Return the loss of equation (6), the weighted sum of (7) and (8), plus the contrastive loss.

    (7) and (8) are both about one when features begin to be distinctive.

    Args:
        contrast: the contrastive loss.
        features: L_2d-f.
        poses: L_3d-d; None in the warm-up.
        options: weights of the losses.
    """
    loss = contrast + options.feature_share * features
    return loss if poses is None else loss + options.pose_share * poses


def measure_correspondence(
    labels_a: Tensor,
    labels_b: Tensor,
    valid: Tensor,
    count: int,
) -> tuple[Tensor, Tensor]:
    """Measure how well each object of image a corresponds to an object of image b.

    The measure is the target of the objects' confidence. It is the intersection over union of the
    points of the object and the points of an object of image b, the largest over all objects of
    image b.

    Args:
        labels_a: object (B, P) of each point in image a, negative for none.
        labels_b: object (B, P) of each point in image b, negative for none.
        valid: (B, P) bool, which points are valid.
        count: number N of objects.

    Returns:
        The measure (B, N) in 0..1, and whether each object has enough points to measure it,
        (B, N) bool.
    """
    batch = len(labels_a)
    used = valid & (labels_a >= 0) & (labels_b >= 0)
    pair = (labels_a * count + labels_b).clamp(min=0)
    shared = torch.zeros(batch, count * count, device=pair.device)
    shared = shared.scatter_add(1, pair, used.float()).view(batch, count, count)
    in_a, in_b = shared.sum(2), shared.sum(1)
    union = (in_a[:, :, None] + in_b[:, None] - shared).clamp(min=1)
    return (shared / union).amax(2), in_a >= _MIN_POINTS


def object_confidence_loss(confidence: Tensor, target: Tensor, has_target: Tensor) -> Tensor:
    """Return the cross entropy between the objects' confidence and its target.

    Args:
        confidence: (B, N) confidences of the objects.
        target: (B, N) from ``measure_correspondence``.
        has_target: (B, N) bool, whether an object is used.
    """
    # The loss is computed in single precision, because in half precision one minus a small number
    # would be one.
    p = confidence.float().clamp(1e-4, 1 - 1e-4)
    entropy = -(target * p.log() + (1 - target) * (1 - p).log())
    return (entropy * has_target).sum() / has_target.sum().clamp(min=1)
