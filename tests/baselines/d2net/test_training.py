from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

import baselines.d2net.training
from baselines.d2net.loss import ImagePoints, TripletLoss, triplet_loss
from baselines.d2net.network import D2Net, D2NetNetConfig, soft_scores
from baselines.d2net.training import D2NetTraining, start_from
from objconnect.learning.checkpoint import write_weights
from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.pairs import Pair, PairBatch, Pinhole, collate
from objconnect.learning.vgg import encode
from tests.objconnect.learning.training.slopes import watch_functions

SMALL = TrainConfig(width=0.125, warm_up=0.25)


def smooth(size: int, seed: int, count: int = 1) -> Tensor:
    """Images of soft blobs, (count, 3, size, size)."""
    torch.manual_seed(seed)
    coarse = torch.rand(count, 3, size // 8, size // 8)
    return functional.interpolate(coarse, size=size, mode="bicubic").clamp(0, 1)


def shift_pairs(count: int = 2) -> PairBatch:
    """The second image is the first, 16 pixels to the left."""
    camera = Pinhole(np.full(2, 128.0), np.full(2, 64.0))
    xy = 8.0 * np.stack(np.meshgrid(np.arange(2, 16), np.arange(16)), -1).reshape(-1, 2) + 4
    points = camera.lift(xy, np.full(len(xy), 8.0))
    moved = np.eye(4)
    moved[0, 3] = -1.0
    seen = camera.project(points + moved[:3, 3])
    pairs = []
    for scene in smooth(160, 0, count).permute(0, 2, 3, 1).mul(255).byte().numpy():
        a, b = scene[:128, :128], scene[:128, 16:144]
        valid = np.ones(len(xy), bool)
        pairs.append(Pair(a, b, camera, camera, moved, moved, points, xy, seen, valid))
    return collate(pairs)


def test_the_loss_is_the_papers_formula_summed_by_hand() -> None:
    torch.manual_seed(1)
    features = [torch.randn(8, 12, 14), torch.randn(8, 13, 11)]
    scores = [torch.rand(12, 14), torch.rand(13, 11)]
    columns = torch.arange(9)
    cells = [torch.stack([columns, columns + 2], -1), torch.stack([columns + 1, columns], -1)]
    described = [
        ImagePoints(f, s, c + 0.5) for f, s, c in zip(features, scores, cells, strict=True)
    ]
    result = triplet_loss(*described)

    unit = [(f / f.norm(dim=0)).double().numpy() for f in features]
    total = weights = 0.0
    for (xa, ya), (xb, yb) in zip(cells[0].tolist(), cells[1].tolist(), strict=True):
        a, b = unit[0][:, ya, xa], unit[1][:, yb, xb]
        hardest = math.inf
        for mine, others, x, y in ((a, unit[1], xb, yb), (b, unit[0], xa, ya)):
            _, h, w = others.shape
            for row in range(h):
                for column in range(w):
                    if max(abs(row - y), abs(column - x)) > 4:
                        distance = float(((mine - others[:, row, column]) ** 2).sum())
                        hardest = min(hardest, distance)
        weight = float(scores[0][ya, xa] * scores[1][yb, xb])
        total += weight * max(0.0, 1 + float(((a - b) ** 2).sum()) - hardest)
        weights += weight
    assert float(result.loss) == pytest.approx(total / weights, rel=1e-5)


def test_training_learns_to_tell_places_apart() -> None:
    torch.manual_seed(0)
    batch, training = shift_pairs(1), D2NetTraining(SMALL)
    optimizer = torch.optim.Adam(training.network.parameters(), 1e-3)
    losses = []
    for _ in range(8):
        loss, figures = training.loss(batch, 0.5)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(figures["loss"])
        assert figures["pairs"] == 1
    assert losses[-1] < 0.8 * losses[0]


@pytest.mark.parametrize("progress", [0.24, 0.25])
def test_the_loss_is_the_sum_of_its_parts(progress: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The contrast, and with it the triplets after the warm-up."""
    parts = watch_functions(monkeypatch, baselines.d2net.training, ["mean_over", "triplet_loss"])
    loss, figures = D2NetTraining(SMALL).loss(shift_pairs(1), progress)
    expected = {"contrastive"} | ({*TripletLoss._fields, "pairs"} if progress == 0.25 else set())
    assert set(figures) == expected
    total = figures["contrastive"] + figures.get("loss", 0.0)
    assert float(loss.detach()) == pytest.approx(total, rel=1e-5)
    loss.backward()
    slopes = {name: float(part.grad) for name, part in parts.items() if part.grad is not None}
    assert slopes == {"mean_over": 1} | ({"triplet_loss": 1} if progress == 0.25 else {})


@torch.no_grad()
def test_pixlocs_encoder_sees_the_same_in_other_units(tmp_path: Path) -> None:
    """Its colours are red, green, blue in 0..1, D2-Net's blue, green, red in 0..255."""
    torch.manual_seed(0)
    theirs = PixlocNet(PixlocNetConfig(width=0.125)).eval()
    path = tmp_path / "pixloc.safetensors"
    write_weights(path, theirs, theirs.config.model_dump())
    image = smooth(96, 1) * torch.tensor([1.0, 0.6, 0.2]).view(3, 1, 1)
    ours, expected = functional.relu(start_from(path)(image)), encode(theirs.encoder, image)[3]
    # The means that are taken off differ in the third digit.
    assert (ours - expected).norm() < 0.05 * expected.norm()


def test_pairs_with_too_few_correspondences_are_left_out() -> None:
    batch = shift_pairs()
    batch.valid[1, 100:] = False
    _, figures = D2NetTraining(SMALL).loss(batch, 0.5)
    assert figures["pairs"] == 1
    _, same = D2NetTraining(SMALL).loss(shift_pairs(1), 0.5)
    assert figures["loss"] == pytest.approx(same["loss"], rel=1e-4)


def test_a_batch_without_pairs_teaches_nothing_and_breaks_nothing() -> None:
    batch, training = shift_pairs(), D2NetTraining(SMALL)
    nowhere = batch._replace(xy_b=torch.full_like(batch.xy_b, math.nan))
    loss, figures = training.loss(nowhere, 0.5)
    loss.backward()
    assert loss.item() == 0
    assert figures["pairs"] == 0
    assert all(not p.grad.any() for p in training.network.parameters() if p.grad is not None)


@pytest.mark.parametrize("value", [0.0, 0.5])
def test_scores_of_an_image_without_contrast_are_finite(value: float) -> None:
    network = D2Net(D2NetNetConfig(width=0.125))
    with torch.no_grad():
        for features in (network(torch.full((1, 3, 64, 64), value)), torch.zeros(1, 8, 8, 8)):
            assert torch.isfinite(soft_scores(features)).all()


def test_gradients_are_finite_where_no_channel_fires() -> None:
    """The authors' code divides zero by zero here."""
    features = torch.randn(1, 8, 16, 16)
    features[..., :8] = -1.0
    features.requires_grad_()
    soft_scores(features)[0, 3, 12].backward()
    assert features.grad is not None
    assert np.isfinite(features.grad.numpy()).all()
    assert features.grad.any()
