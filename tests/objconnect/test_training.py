"""Equations (6) to (8), what teaches confidence, and a few steps of training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from baselines.pixloc.training import both, contrast_of, levels_of
from baselines.training.config import TrainConfig
from benchmark.registry import TRAINABLE, trainable
from objconnect.loss import (
    FEATURE_SHARE,
    POSE_SHARE,
    feature_distance,
    kept_together,
    pose_distance,
    total,
    trust_loss,
)
from objconnect.training import ObjConnectTraining
from scene.errors import InputError
from scene.pose import Pose
from tests.objconnect.made import pairs

TINY = TrainConfig(width=0.05, warm_up=0.5, network={"segment_side": 16, "pyramid": 16})


def made(**values: Any) -> ObjConnectTraining:
    return ObjConnectTraining(TINY.model_copy(update={"network": {**TINY.network, **values}}))


def test_feature_distance_is_equation_6() -> None:
    batch = pairs()
    training = made()
    strides = training.network_config.strides
    with torch.no_grad():
        levels = levels_of(training.network.eval()(both(batch)), strides, batch)
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
    assert float(total(*parts)) == pytest.approx(1 + 2 * FEATURE_SHARE + 3 * POSE_SHARE)
    assert float(total(*parts[:2], None)) == pytest.approx(1 + 2 * FEATURE_SHARE)


def test_equal_features_satisfy_equation_6_but_not_the_contrast() -> None:
    batch = pairs()
    maps = [(torch.ones(4, 8, 24, 24), torch.ones(4, 1, 24, 24))]
    assert float(feature_distance(levels_of(maps, [4], batch), batch)) < 1e-3
    assert float(contrast_of(maps, [4], batch)[0]) > 5


def test_objects_that_are_kept_together() -> None:
    a = torch.tensor([[0, 0, 0, 0, 1, 1, 1, 1, 2, -1, 0]])
    b = torch.tensor([[5, 5, 5, 5, 3, 3, 4, 4, 4, 4, 5]])
    valid = torch.tensor([[True] * 10 + [False]])
    kept, counts = kept_together(a, b, valid, 6)
    assert counts[0].tolist() == [True, True, False, False, False, False]
    # Of object 1, two points lie in 3 alone, and two in 4 with another.
    assert kept[0, :2].tolist() == [1.0, 0.5]
    sure = trust_loss(torch.tensor([[0.999, 0.5, 0.1, 0, 0, 0]]), kept, counts)
    unsure = trust_loss(torch.tensor([[0.5, 0.5, 0.9, 0, 0, 0]]), kept, counts)
    assert sure < unsure


@pytest.mark.parametrize("segmentation", ["slic", "grid", "none"])
def test_some_steps_lower_the_loss(segmentation: str) -> None:
    off = dict.fromkeys(("attention", "object_graph", "scene_graph"), segmentation != "none")
    training = made(segmentation=segmentation, **off)
    batch = pairs()
    optimizer = torch.optim.AdamW(training.groups(3e-3))
    losses = []
    for _ in range(12):
        torch.manual_seed(0)
        loss, figures = training.loss(batch, 0.0)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.8 * losses[0]
    assert ("trust" in figures) == (segmentation != "none")
    loss, figures = training.loss(batch, 1.0)
    loss.backward()  # type: ignore[no-untyped-call]
    assert {"pixels/start", "pixels/16", "pixels/4", "pixels/2", "features"} <= set(figures)
    assert all(
        p.grad is not None and p.grad.isfinite().all() for p in training.network.parameters()
    )


def test_registry_and_settings(tmp_path: Path) -> None:
    assert trainable("objconnect") is ObjConnectTraining
    assert TRAINABLE[-1] == "objconnect"
    with pytest.raises(InputError, match="those that can: .*objconnect"):
        trainable("sift")
    assert made(attention=False).network_config.attention is False
    for method in TRAINABLE:
        with pytest.raises(InputError, match="unknown key 'depth'"):
            trainable(method)(TINY.model_copy(update={"network": {"depth": 3}}))
    with pytest.raises(InputError, match="without masks"):
        made(segmentation="given")
