"""Equations (1) to (3) and the centres against loops over cells."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from objconnect.network.objects import Attention, Occupancy, affinity, centres, occupancy
from objconnect.network.segmentation import NOTHING

N, C, HEIGHT, WIDTH = 5, 6, 4, 7


@pytest.fixture
def labels() -> Tensor:
    made = torch.randint(NOTHING, N - 1, (2, HEIGHT, WIDTH), generator=torch.manual_seed(1))
    made[0, 0, :3] = torch.tensor([N, N + 7, NOTHING])  # no object, all three
    return made  # object N - 1 is nowhere


@pytest.fixture
def rows() -> Tensor:
    return torch.randn(2, HEIGHT * WIDTH, C, generator=torch.manual_seed(2))


def dense(labels: Tensor) -> Tensor:
    """F_D written out, (B, N, h w)."""
    made = torch.zeros(len(labels), N, HEIGHT * WIDTH)
    for b, picture in enumerate(labels.flatten(1).tolist()):
        for cell, label in enumerate(picture):
            if 0 <= label < N:
                made[b, label, cell] = 1
    return made


def paint(objects: Occupancy, vectors: Tensor, labels: Tensor) -> None:
    expected = dense(labels).transpose(1, 2) @ vectors
    torch.testing.assert_close(objects.paint(vectors), expected)


def test_occupancy_is_one_hot_and_paints_back(labels: Tensor) -> None:
    objects = occupancy(labels, N)
    torch.testing.assert_close(objects.area, dense(labels).sum(2))
    assert not objects.present[:, N - 1].any()
    paint(objects, torch.randn(2, N, C), labels)


def test_affinity_is_the_mean_of_each_channel(labels: Tensor, rows: Tensor) -> None:
    found = affinity(occupancy(labels, N), rows)
    for b in range(2):
        for n in range(N):
            own = [rows[b, k] for k in range(HEIGHT * WIDTH) if dense(labels)[b, n, k]]
            expected = torch.stack(own).mean(0) if own else torch.zeros(C)
            torch.testing.assert_close(found[b, n], expected)


def test_affinity_of_half_precision_is_summed_in_single() -> None:
    rows = torch.full((1, 4096, 1), 1.0, dtype=torch.bfloat16)
    objects = occupancy(torch.zeros(1, 64, 64, dtype=torch.int64), 1)
    assert affinity(objects, rows).item() == 1.0


def test_centres_are_first_moments(labels: Tensor) -> None:
    found = centres(occupancy(labels, N))
    for b in range(2):
        for n in range(N):
            inside = [
                (x + 0.5, y + 0.5)
                for y in range(HEIGHT)
                for x in range(WIDTH)
                if labels[b, y, x] == n
            ]
            expected = torch.tensor(inside).mean(0) if inside else torch.zeros(2)
            torch.testing.assert_close(found[b, n], expected)


def test_attention_is_equation_3(labels: Tensor, rows: Tensor) -> None:
    torch.manual_seed(0)
    block = Attention(C)
    found = block(rows, occupancy(labels, N))
    F_D = dense(labels)
    F_A = F_D @ rows / F_D.sum(2, keepdim=True).clamp(min=1)
    for b in range(2):
        for cell in range(HEIGHT * WIDTH):
            back = sum((F_A[b, n] for n in range(N) if F_D[b, n, cell]), torch.zeros(C))
            both = torch.cat([back, rows[b, cell]])
            hidden = (block.join.weight @ both + block.join.bias).clamp(min=0)
            expected = rows[b, cell] + block.out.weight @ hidden
            torch.testing.assert_close(found[b, cell], expected)


def test_an_untrained_block_changes_little(labels: Tensor) -> None:
    torch.manual_seed(0)
    rows = torch.randn(2, HEIGHT * WIDTH, 64)
    change = Attention(64)(rows, occupancy(labels, N)) - rows
    assert 0 < change.std() < 0.1 * rows.std()
