from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from baselines.training.contrastive import contrastive, mean_over, sample


def cells(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return 2 + 20 * torch.rand(1, count, 2, generator=generator)


def test_lookup_is_exact_at_centres_and_linear_between() -> None:
    rows, columns = torch.meshgrid(torch.arange(6.0), torch.arange(8.0), indexing="ij")
    maps = torch.stack([columns + 0.5, rows + 0.5])[None]
    where = torch.tensor([[[0.5, 0.5], [3.25, 2.75], [7.5, 5.5]]])
    assert torch.allclose(sample(maps, where), where, atol=1e-6)


def test_features_that_tell_places_apart_cost_less() -> None:
    torch.manual_seed(0)
    smooth = functional.interpolate(torch.randn(1, 32, 8, 8), size=24, mode="bicubic")
    xy, valid = cells(50), torch.ones(1, 50, dtype=torch.bool)
    right = mean_over(valid, contrastive(smooth, smooth, xy, xy, valid))
    wrong = mean_over(valid, contrastive(smooth, smooth, xy, xy.flip(1), valid))
    flat = torch.ones(1, 32, 24, 24)
    plain = mean_over(valid, contrastive(flat, flat, xy, xy, valid))
    assert right < plain < wrong


def test_points_that_are_not_valid_do_not_count() -> None:
    torch.manual_seed(0)
    a, b = torch.randn(2, 1, 16, 24, 24).unbind()
    xy, valid = cells(50), torch.arange(50)[None] < 30
    spoiled = torch.where(valid[..., None], xy, torch.nan)
    torch.manual_seed(1)
    first = mean_over(valid, contrastive(a, b, xy, spoiled, valid))
    torch.manual_seed(1)
    moved = torch.where(valid[..., None], xy, 5.0)
    second = mean_over(valid, contrastive(a, b, xy, moved, valid))
    assert torch.allclose(first, second, rtol=1e-3)
