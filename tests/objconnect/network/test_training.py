"""Equations (6) to (8), what teaches confidence, and a few steps of training."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import objconnect.network.training
from objconnect.learning.training.config import TrainConfig
from objconnect.localization.featuremetric.training import (
    alignment_levels,
    contrastive_and_confidence_loss,
    stack_images,
)
from objconnect.methods import TRAINABLE, trainable
from objconnect.network.loss import (
    feature_distance,
    measure_correspondence,
    object_confidence_loss,
    pose_distance,
    total,
)
from objconnect.network.segmentation import segment
from objconnect.network.training import ObjConnectTraining
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from tests.baselines.pixloc.test_training import pose_term
from tests.objconnect.learning.training.made_pairs import pairs
from tests.objconnect.learning.training.slopes import watch_functions

TINY = TrainConfig(width=0.05, warm_up=0.5, network={"segment_side": 16, "pyramid": 16})


def make(**values: Any) -> ObjConnectTraining:
    return ObjConnectTraining(TINY.model_copy(update={"network": {**TINY.network, **values}}))


def test_feature_distance_is_equation_6() -> None:
    batch = pairs()
    training = make()
    strides = training.network_config.strides
    with torch.no_grad():
        levels = alignment_levels(training.network.eval()(stack_images(batch)), strides, batch)
    by_hand = []
    for level, stride in zip(levels, strides, strict=True):
        for b in range(2):
            for p in range(batch.xy_b.shape[1]):
                x, y = (batch.xy_b[b, p] / stride - 0.5).tolist()
                height, width = level.features.shape[-2:]
                x, y = min(max(x, 0), width - 1), min(max(y, 0), height - 1)
                column, row = min(int(x), width - 2), min(int(y), height - 2)
                a, c = x - column, y - row
                corner = level.features[b, :, row : row + 2, column : column + 2]
                value = (1 - c) * ((1 - a) * corner[:, 0, 0] + a * corner[:, 0, 1])
                value = value + c * ((1 - a) * corner[:, 1, 0] + a * corner[:, 1, 1])
                by_hand.append((value / value.norm() - level.reference[b, p]).norm())
    expected = torch.stack(by_hand).mean()
    torch.testing.assert_close(feature_distance(levels, batch), expected, atol=1e-3, rtol=0)


def test_pose_distance_is_equation_7_and_total_is_8() -> None:
    batch = pairs()
    nothing, errors = pose_distance([batch.b_from_a] * 2, (16, 4), batch)
    assert float(nothing) < 1e-4 and len(errors) == 2
    moved = Pose(batch.b_from_a.rotation, batch.b_from_a.translation + torch.tensor([0.5, 0, 0]))
    # 0.5 m at 48 m and 96 pixels of focal length is one pixel.
    huber = 2 * ((1 / 4 + 1) ** 0.5 - 1)
    loss, _ = pose_distance([moved, batch.b_from_a], (16, 4), batch)
    assert float(loss) == pytest.approx(huber / 2, rel=1e-3)
    parts = [torch.tensor(v) for v in (1.0, 2.0, 3.0)]
    assert float(total(*parts)) == pytest.approx(1 + 0.1 * 2 + 0.3 * 3)
    assert float(total(*parts[:2], None)) == pytest.approx(1 + 0.1 * 2)


@pytest.mark.parametrize(
    ("progress", "segmentation"), [(0.49, "slic"), (0.5, "slic"), (0.5, "none")]
)
def test_the_loss_is_the_sum_of_its_parts(progress: float, segmentation: str) -> None:
    """A tenth of the distance of features, three tenths of the pose's after the warm-up and of the
    confidence's, the objects' confidence as it is."""
    off = dict.fromkeys(("attention", "object_graph", "scene_graph"), segmentation != "none")
    loss, figures = make(segmentation=segmentation, **off).loss(pairs(1), progress)
    contrast = sum(figures[f"contrastive/{stride}"] for stride in (16, 4, 2)) / 3
    expected = contrast + 0.3 * figures["confidence"] + 0.1 * figures["features"]
    assert figures["features"] > 0.1
    if progress == 0.5:
        pose = pose_term(figures, (16, 4, 2))
        assert pose > 0.1
        expected += 0.3 * pose
    else:
        assert not any(name.startswith("pixels") for name in figures)
    if segmentation == "none":
        assert "trust" not in figures
    else:
        assert figures["trust"] > 0.1
        expected += figures["trust"]
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-4)


def test_every_part_of_the_loss_teaches(monkeypatch: pytest.MonkeyPatch) -> None:
    """By its share: nothing is only logged."""
    shares = {
        "contrastive_and_confidence_loss": 1,
        "feature_distance": 0.1,
        "pose_distance": 0.3,
        "object_confidence_loss": 1,
    }
    parts = watch_functions(monkeypatch, objconnect.network.training, shares)
    loss, _ = make().loss(pairs(1), 1.0)
    loss.backward()  # type: ignore[no-untyped-call]
    slopes = {name: float(part.grad) for name, part in parts.items() if part.grad is not None}
    assert slopes == pytest.approx(shares)


def test_equation_6_teaches_the_features_of_both_pictures_on_every_level() -> None:
    batch, levels, leaves = pairs(), [], []
    torch.manual_seed(0)
    for stride in (16, 4):
        features = torch.randn(4, 8, 96 // stride, 96 // stride, requires_grad=True)
        levels.append((features, torch.ones(4, 1, 96 // stride, 96 // stride)))
        leaves.append(features)
    loss = feature_distance(alignment_levels(levels, (16, 4), batch), batch)
    for slope in torch.autograd.grad(loss, leaves):
        assert all(half.any() for half in slope.chunk(2))


def test_points_that_are_not_valid_do_not_count_in_equation_6() -> None:
    batch = pairs()
    torch.manual_seed(0)
    levels = alignment_levels([(torch.randn(4, 8, 24, 24), torch.ones(4, 1, 24, 24))], [4], batch)
    some = batch._replace(valid=torch.arange(64).expand(2, 64) < 40)
    fewer = batch._replace(xy_b=batch.xy_b[:, :40], valid=some.valid[:, :40])
    cut = [replace(level, reference=level.reference[:, :40]) for level in levels]
    torch.testing.assert_close(feature_distance(levels, some), feature_distance(cut, fewer))


def test_each_picture_is_cut_into_its_own_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    """An object's confidence learns from where its points lie among the other picture's objects.

    The pictures have nothing in common, so that their segments differ.
    """
    training = make()
    config, batch = training.network_config, pairs(2, 96, 400)
    batch = batch._replace(image_b=batch.image_a.flip(0), xy_b=batch.xy_a)
    seen = []
    describe = training.network.describe

    def spy(images: Tensor, labels: Tensor) -> Any:
        seen.append((images, labels, describe(images, labels)))
        return seen[-1][2]

    monkeypatch.setattr(training.network, "describe", spy)
    _, figures = training.loss(batch, 0.0)
    ((images, labels, (_, objects)),) = seen
    assert torch.equal(images, torch.cat([batch.image_a, batch.image_b]))
    cut = torch.cat([segment(batch.image_a, config), segment(batch.image_b, config)])
    assert torch.equal(labels, cut)

    entropies = []
    # Pictures of the batch are a0, a1, b0, b1.
    for number, partner in ((0, 2), (1, 3), (2, 0), (3, 1)):
        column, row = (batch.xy_a[number % 2] * 48 / 96).long().T
        own, other = (labels[which][row, column].tolist() for which in (number, partner))
        for item in set(own):
            here = {k for k, label in enumerate(own) if label == item}
            if len(here) < 4:
                continue
            there = [{k for k, label in enumerate(other) if label == its} for its in set(other)]
            kept = max(len(here & points) / len(here | points) for points in there)
            p = float(objects.confidence[number, item].detach())
            entropies.append(-kept * math.log(p) - (1 - kept) * math.log(1 - p))
    assert figures["trust"] == pytest.approx(sum(entropies) / len(entropies), rel=1e-3)


def test_equal_features_satisfy_equation_6_but_not_the_contrast() -> None:
    batch = pairs()
    maps = [(torch.ones(4, 8, 24, 24), torch.ones(4, 1, 24, 24))]
    assert float(feature_distance(alignment_levels(maps, [4], batch), batch)) < 1e-3
    assert float(contrastive_and_confidence_loss(maps, [4], batch)[0]) > 5


def test_objects_that_are_kept_together() -> None:
    a = torch.tensor([[0, 0, 0, 0, 1, 1, 1, 1, 2, -1, 0]])
    b = torch.tensor([[5, 5, 5, 5, 3, 3, 4, 4, 4, 4, 5]])
    valid = torch.tensor([[True] * 10 + [False]])
    kept, counts = measure_correspondence(a, b, valid, 6)
    assert counts[0].tolist() == [True, True, False, False, False, False]
    # Of object 1, two points lie in 3 alone, and two in 4 with another.
    assert kept[0, :2].tolist() == [1.0, 0.5]
    sure = object_confidence_loss(torch.tensor([[0.999, 0.5, 0.1, 0, 0, 0]]), kept, counts)
    unsure = object_confidence_loss(torch.tensor([[0.5, 0.5, 0.9, 0, 0, 0]]), kept, counts)
    assert sure < unsure


@pytest.mark.parametrize(
    ("segmentation", "steps", "share"),
    [
        ("slic", 4, 1.0),
        *(
            pytest.param(segmentation, 12, 0.8, marks=pytest.mark.thorough)
            for segmentation in ("slic", "grid", "none")
        ),
    ],
)
def test_some_steps_lower_the_loss(segmentation: str, steps: int, share: float) -> None:
    off = dict.fromkeys(("attention", "object_graph", "scene_graph"), segmentation != "none")
    training = make(segmentation=segmentation, **off)
    batch = pairs()
    optimizer = torch.optim.AdamW(training.groups(3e-3))
    losses = []
    for _ in range(steps):
        torch.manual_seed(0)
        loss, figures = training.loss(batch, 0.0)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss.detach()))
    assert losses[-1] < share * losses[0]
    assert ("trust" in figures) == (segmentation != "none")
    added = {name: share for name, share in figures.items() if name.startswith("residual ")}
    assert len(added) == (0 if segmentation == "none" else 6)
    assert all(0 < share < 1 for share in added.values())
    loss, figures = training.loss(batch, 1.0)
    loss.backward()  # type: ignore[no-untyped-call]
    assert {"pixels/start", "pixels/16", "pixels/4", "pixels/2", "features"} <= set(figures)
    assert all(
        p.grad is not None and p.grad.isfinite().all() for p in training.network.parameters()
    )


def test_registry_and_settings(tmp_path: Path) -> None:
    assert trainable("objconnect") is ObjConnectTraining
    assert TRAINABLE[-2:] == ("objconnect", "objects")
    with pytest.raises(InputError, match="those that can: .*objconnect"):
        trainable("sift")
    assert make(attention=False).network_config.attention is False
    for method in TRAINABLE:
        with pytest.raises(InputError, match="unknown key 'depth'"):
            trainable(method)(TINY.model_copy(update={"network": {"depth": 3}}))
    with pytest.raises(InputError, match="have no label maps"):
        make(segmentation="given")
