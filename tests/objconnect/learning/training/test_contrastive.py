from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from objconnect.learning.training.contrastive import contrastive_loss, mean_over, sample


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
    right = mean_over(valid, contrastive_loss(smooth, smooth, xy, xy, valid))
    wrong = mean_over(valid, contrastive_loss(smooth, smooth, xy, xy.flip(1), valid))
    flat = torch.ones(1, 32, 24, 24)
    plain = mean_over(valid, contrastive_loss(flat, flat, xy, xy, valid))
    assert right < plain < wrong


def test_points_that_are_not_valid_do_not_count() -> None:
    torch.manual_seed(0)
    a, b = torch.randn(2, 1, 16, 24, 24).unbind()
    xy, valid = cells(50), torch.arange(50)[None] < 30
    spoiled = torch.where(valid[..., None], xy, torch.nan)
    torch.manual_seed(1)
    first = mean_over(valid, contrastive_loss(a, b, xy, spoiled, valid))
    torch.manual_seed(1)
    moved = torch.where(valid[..., None], xy, 5.0)
    second = mean_over(valid, contrastive_loss(a, b, xy, moved, valid))
    assert torch.allclose(first, second, rtol=1e-3)


@pytest.mark.parametrize(("radius", "alike"), [(5, 5), (10, 7), (14, 8)])
def test_places_beside_the_true_one_are_told_from_it(radius: int, alike: int) -> None:
    """One place each at 1, 1.5, 2, 3, 4, 6, 8 and 12 cells: those that look as the true one does
    are as likely as it. Places elsewhere hardly ever hit the disc."""
    side = 600
    column, row = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="xy")
    disc = ((column - 300) ** 2 + (row - 300) ** 2).sqrt() < radius
    maps = torch.stack([disc, ~disc]).float()[None]
    xy, valid = torch.full((1, 20, 2), 300.5), torch.ones(1, 20, dtype=torch.bool)
    torch.manual_seed(0)
    odds = contrastive_loss(maps, maps, xy, xy, valid).exp()
    assert 1 + alike - 0.2 < odds.min() and odds.max() < 1 + alike + 2


def test_places_elsewhere_are_told_from_the_true_one() -> None:
    """Two halves of a picture look alike: what is asked of 512 places finds 256 that are not it."""
    side = 64
    halves = (torch.arange(side) < side // 2).float().expand(side, side)
    maps = torch.stack([halves, 1 - halves])[None]
    xy, valid = torch.full((1, 20, 2), 16.5), torch.ones(1, 20, dtype=torch.bool)
    torch.manual_seed(0)
    odds = contrastive_loss(maps, maps, xy, xy, valid).exp()
    assert odds.mean() == pytest.approx(1 + 8 + 256, rel=0.1)


def test_the_true_place_is_no_other_place() -> None:
    """No two cells are alike: nothing is left to confuse a place with but itself.

    Of 1600 cells 512 are drawn, so that about one place in four is drawn too.
    """
    torch.manual_seed(0)
    maps = torch.randn(1, 256, 40, 40)
    middle = torch.arange(13, 27) + 0.5  # as far from the rim as any place beside
    xy = torch.cartesian_prod(middle, middle)[None]
    assert contrastive_loss(maps, maps, xy, xy, xy[..., 0] > 0).max() < 0.01


def test_features_count_by_their_direction() -> None:
    torch.manual_seed(0)
    a, b = torch.randn(2, 1, 16, 24, 24).unbind()
    xy, valid = cells(50), torch.ones(1, 50, dtype=torch.bool)
    lost = []
    for longer in (1.0, 5.0):
        torch.manual_seed(1)
        lost.append(contrastive_loss(longer * a, longer * b, xy, xy, valid))
    torch.testing.assert_close(*lost)


def test_the_loss_of_orthogonal_and_equal_features() -> None:
    """At a temperature of 0.07, against 8 places beside and all 9 elsewhere but its own."""
    valid = torch.ones(1, 1, dtype=torch.bool)
    xy = torch.tensor([[[1.5, 1.5]]])
    a, b = torch.zeros(1, 2, 3, 3), torch.zeros(1, 2, 3, 3)
    a[:, 0], b[:, 1] = 1, 1
    angle = 0.3
    a[:, 0], a[:, 1] = math.cos(angle), math.sin(angle)
    b[:, :, 1, 1] = torch.tensor([1.0, 0.0])
    torch.manual_seed(0)
    lost = contrastive_loss(a, b, xy, xy, valid)
    own, other = math.cos(angle) / 0.07, math.sin(angle) / 0.07
    assert float(lost) == pytest.approx(math.log1p(17 * math.exp(other - own)), abs=1e-2)
