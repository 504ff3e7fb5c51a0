"""Training losses: equations (6) to (8), and the contrastive loss that they need beside them.

Equation (6) is the sum of (7), the distance of features, and (8), the distance of projections.
Equation (7) alone is smallest when all features are equal. Features are therefore normalised, and
the contrastive loss of ``baselines.training.contrastive`` is added, whose negatives are other
places.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from baselines.align.residuals import Level
from baselines.pixloc.loss import Seen, pose_loss
from baselines.training.contrastive import sample
from baselines.training.options import LOSSES, LossOptions
from baselines.training.pairs import PairBatch
from scene.geometry.pose import Pose


def feature_distance(levels: Sequence[Level], batch: PairBatch) -> Tensor:
    """Equation (7), L_2d-f: mean over levels and points of |F_2(project(X)) - F_1(X)|.

    Taken at the true pose of image 2. The predicted one, of the paper, is the same at the end of
    training; at its beginning it would teach that wrong places look alike.

    Args:
        levels: features of unit length.
        batch: with ``xy_b``, the projections by the true pose.
    """
    count = batch.valid.sum().clamp(min=1)
    distances = []
    for level in levels:
        assert not isinstance(level.stride, tuple)
        features_b = functional.normalize(sample(level.features, batch.xy_b / level.stride), dim=-1)
        # The root has no slope at zero.
        squared = (features_b - level.reference).square().sum(-1)
        distances.append(((squared + 1e-8).sqrt() * batch.valid).sum() / count)
    return torch.stack(distances).mean()


def pose_distance(
    by_level: Sequence[Pose],
    strides: Sequence[int],
    batch: PairBatch,
    options: LossOptions = LOSSES,
) -> tuple[Tensor, list[Tensor]]:
    """Equation (8), L_3d-d: mean over levels of the Huber distance of projections by two poses.

    The smooth Huber function, up to a limit, and of a finer level only where the coarser one came
    near: as PixLoc is trained, so that the two differ in their features alone.

    Args:
        by_level: predicted poses after each level, coarse to fine.
        strides: of the levels.
        batch: with the true pose.
        options: the limits, see ``pose_loss``.

    Returns:
        The loss, and the distance (B,) in pixels after each level.
    """
    seen = Seen(batch.points, batch.intrinsics_b, batch.valid)
    return pose_loss(by_level, strides, batch.b_from_a, seen, options)


def total(
    contrast: Tensor, features: Tensor, poses: Tensor | None, options: LossOptions = LOSSES
) -> Tensor:
    """Equation (6): the weighted sum of (7) and (8), and the contrastive loss beside it.

    Both losses are about one once features have begun to tell places apart.

    Args:
        contrast: the contrastive loss.
        features: L_2d-f.
        poses: L_3d-d; None in the warm-up.
        options: the weights.
    """
    loss = contrast + options.feature_share * features
    return loss if poses is None else loss + options.pose_share * poses


def kept_together(
    labels_a: Tensor,
    labels_b: Tensor,
    valid: Tensor,
    count: int,
    min_points: int = LOSSES.min_object_points,
) -> tuple[Tensor, Tensor]:
    """Measure how well each object of image a is one object of image b too.

    This is the target of the confidence: the intersection over union of the points of an object
    with those of the object of image b that shares most of them.

    Args:
        labels_a: (B, P) the object of each point in image a, negative for none.
        labels_b: likewise in b.
        valid: (B, P) points that are there.
        count: N.
        min_points: objects with fewer do not have enough points.

    Returns:
        The measure (B, N) in 0..1, and (B, N) which objects have enough points for it.
    """
    batch = len(labels_a)
    used = valid & (labels_a >= 0) & (labels_b >= 0)
    pair = (labels_a * count + labels_b).clamp(min=0)
    shared = torch.zeros(batch, count * count, device=pair.device)
    shared = shared.scatter_add(1, pair, used.float()).view(batch, count, count)
    in_a, in_b = shared.sum(2), shared.sum(1)
    either = (in_a[:, :, None] + in_b[:, None] - shared).clamp(min=1)
    return (shared / either).amax(2), in_a >= min_points


def trust_loss(confidence: Tensor, kept: Tensor, counts: Tensor) -> Tensor:
    """Cross entropy of the objects' confidence (B, N) against ``kept_together``."""
    # Not in half precision: one minus a small number would be one.
    p = confidence.float().clamp(1e-4, 1 - 1e-4)
    entropy = -(kept * p.log() + (1 - kept) * (1 - p).log())
    return (entropy * counts).sum() / counts.sum().clamp(min=1)
