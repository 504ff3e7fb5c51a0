"""What PixLoc is trained by, against sums by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional

import baselines.pixloc.training
from baselines.pixloc.training import PixlocTraining
from objconnect.learning.training.config import TrainConfig
from objconnect.localization.align.aligner import align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.featuremetric.training import (
    alignment_levels,
    contrastive_and_confidence_loss,
    unroll_alignment,
)
from tests.objconnect.learning.training.made_pairs import pairs
from tests.objconnect.learning.training.slopes import watch_functions

TINY = TrainConfig(width=0.05, warm_up=0.5)
STRIDES = (16, 4)
SIZE = 96


def maps(grad: bool = False) -> list[tuple[Tensor, Tensor]]:
    """Features, smooth, and confidences of two pairs of pictures, at random."""
    torch.manual_seed(0)
    made = []
    for stride in STRIDES:
        cells = SIZE // stride
        features = functional.interpolate(torch.randn(4, 8, 3, 3), size=cells, mode="bicubic")
        confidence = torch.rand(4, 1, cells, cells)
        made.append((features.requires_grad_(grad), confidence.requires_grad_(grad)))
    return made


def pose_term(figures: dict[str, float], strides: tuple[int, ...]) -> float:
    """The pose's part of the loss of one pair, from its errors in pixels after each level.

    A pseudo-Huber function of two pixels, at most 50, its mean over the levels; beyond three cells
    of a level the finer ones count for nothing.
    """
    total, counts = 0.0, True
    for stride in strides:
        error = 2 * (math.sqrt(figures[f"pixels/{stride}"] ** 2 / 4 + 1) - 1)
        total += min(error, 50) / len(strides) if counts else 0
        counts = counts and error < 3 * stride
    return total


@pytest.mark.parametrize("progress", [0.49, 0.5])
def test_the_loss_is_the_sum_of_its_parts(progress: float) -> None:
    """Confidence and pose count three tenths of the contrast, the pose after the warm-up."""
    training, batch = PixlocTraining(TINY), pairs(1)
    loss, figures = training.loss(batch, progress)
    contrast = sum(figures[f"contrastive/{stride}"] for stride in (16, 4, 2)) / 3
    expected = contrast + 0.3 * figures["confidence"]
    if progress == 0.5:
        pose = pose_term(figures, (16, 4, 2))
        assert pose > 0.1
        expected += 0.3 * pose
    else:
        assert not any(name.startswith("pixels") for name in figures)
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-4)


def test_every_part_of_the_loss_teaches(monkeypatch: pytest.MonkeyPatch) -> None:
    shares = {"contrastive_and_confidence_loss": 1, "pose_loss": 0.3}
    parts = watch_functions(monkeypatch, baselines.pixloc.training, shares)
    loss, _ = PixlocTraining(TINY).loss(pairs(1), 1.0)
    loss.backward()
    slopes = {name: float(part.grad) for name, part in parts.items() if part.grad is not None}
    assert slopes == pytest.approx(shares)


def test_confidence_learns_where_places_are_found_again() -> None:
    """Half of the features of picture b are those of a, the others have nothing to do with them.

    Picture b shows everything twelve cells further to the left than a.
    """
    stride, cells, moved = 4, SIZE // 4, 12
    torch.manual_seed(0)
    a = torch.randn(1, 32, cells, cells)
    upper = torch.arange(cells)[:, None] < cells // 2
    b = torch.where(upper, a.roll(-moved, 3), torch.randn_like(a))
    # Points that a shows in its right half and b in its left.
    xy = torch.rand(1, 256, 2) * torch.tensor([SIZE - 8.0 - 48, SIZE - 8]) + 4
    batch = pairs(1, SIZE, 256)
    batch = batch._replace(xy_a=xy + torch.tensor([4.0 * moved, 0]), xy_b=xy)
    said = torch.zeros(2, 1, cells, cells, requires_grad=True)
    optimizer = torch.optim.Adam([said], 0.3)
    for _ in range(40):
        loss, _ = contrastive_and_confidence_loss(
            [(torch.cat([a, b]), said.sigmoid())], [stride], batch
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    confidence = said.detach().sigmoid()[:, 0]
    for half, columns in zip(confidence, (slice(14, 22), slice(2, 10)), strict=True):
        found, lost = half[2:10, columns], half[14:22, columns]
        assert found.median() > 0.7 > 0.3 > lost.median()
    # Where no point was, nothing was learned.
    assert confidence[0, :, :10].eq(0.5).all() and confidence[1, :, 14:].eq(0.5).all()


def test_confidence_does_not_bend_features() -> None:
    """What it is taught says nothing of how features should be."""
    batch, slopes = pairs(2), []
    for said in (0.1, 0.9):
        found = [(features, torch.full_like(trust, said)) for features, trust in maps(grad=True)]
        torch.manual_seed(1)
        loss, _ = contrastive_and_confidence_loss(found, STRIDES, batch)
        slopes.append(torch.autograd.grad(loss, [features for features, _ in found]))
    for low, high in zip(*slopes, strict=True):
        torch.testing.assert_close(low, high)
        assert low.any()


def test_alignment_sees_directions_of_features_alone() -> None:
    batch, plain = pairs(2), maps()
    longer = [(7 * features, trust) for features, trust in plain]
    for one, other in zip(
        alignment_levels(plain, STRIDES, batch),
        alignment_levels(longer, STRIDES, batch),
        strict=True,
    ):
        torch.testing.assert_close(one.features, other.features)
        torch.testing.assert_close(one.reference, other.reference)
        lengths = one.features.norm(dim=1), one.reference.norm(dim=-1)
        for length in lengths:
            torch.testing.assert_close(length, torch.ones_like(length))


def test_the_pose_teaches_features_confidence_and_damping() -> None:
    """Of both pictures, on every level."""
    batch, found = pairs(2), maps(grad=True)
    damping = PixlocTraining(TINY).network.damping[: len(STRIDES)]
    poses = unroll_alignment(alignment_levels(found, STRIDES, batch), batch, damping)
    moved = sum((pose.translation.square().sum() for pose in poses), torch.zeros(()))
    thetas = list(damping.parameters())
    slopes = torch.autograd.grad(moved, [*(each for pair in found for each in pair), *thetas])
    for slope in slopes[: 2 * len(STRIDES)]:
        assert slope.isfinite().all()
        assert all(half.any() for half in slope.chunk(2))
    assert all(slope.any() for slope in slopes[2 * len(STRIDES) :])


def test_poses_are_those_of_eight_plain_steps_on_the_points_that_count() -> None:
    """All taken, good or not: a step that is tried and left teaches nothing."""
    batch, levels = pairs(2), alignment_levels(maps(), STRIDES, pairs(2))
    damping = PixlocTraining(TINY).network.damping[: len(STRIDES)]
    some = torch.arange(64).expand(2, 64) < 40
    found = unroll_alignment(levels, batch._replace(valid=some), damping)
    fewer = [
        replace(
            level,
            reference=level.reference[:, :40],
            reference_confidence=level.reference_confidence[:, :40],
        )
        for level in levels
        if level.reference_confidence is not None
    ]
    pose = batch.start
    for level, factors, ended in zip(fewer, damping, found, strict=True):
        for _ in range(8):
            step = Options(iterations=1, adaptive_damping=False)
            place = batch.points[:, :40], batch.intrinsics_b, pose
            pose = align(Problem([level], *place, [factors()], step)).pose
        torch.testing.assert_close(ended.translation, pose.translation, atol=1e-3, rtol=1e-3)
        torch.testing.assert_close(ended.rotation, pose.rotation, atol=1e-4, rtol=1e-3)


def test_damping_learns_thirty_times_faster_than_filters() -> None:
    training = PixlocTraining(TINY)
    filters, damping = training.groups(1e-3)
    assert (filters["lr"], damping["lr"]) == (pytest.approx(1e-3), pytest.approx(3e-2))
    assert len(damping["params"]) == 3
    assert damping["weight_decay"] == 0  # which would draw the factors to what is untrained
    everything = {id(p) for p in training.network.parameters()}
    assert {id(p) for group in (filters, damping) for p in group["params"]} == everything
