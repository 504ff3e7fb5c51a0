from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from objconnect.scene.maps.matching import match


def directions(*degrees: float) -> Tensor:
    """Return unit vectors in the plane."""
    angles = torch.tensor([math.radians(d) for d in degrees])
    return torch.stack([angles.cos(), angles.sin()], -1)


def test_nearest_pairs_are_found_in_any_order() -> None:
    a, b = directions(0, 90, 200), directions(201, 2, 88)
    assert match(a, b, 0.8).tolist() == [[0, 1], [1, 2], [2, 0]]


def test_only_mutual_neighbours_match() -> None:
    """Both 0 and 10 degrees have 6 as nearest neighbour, which is nearer to 10."""
    a, b = directions(0, 10), directions(6, 180)
    assert match(a, b, 1.0).tolist() == [[1, 0]]


def test_ratio_refuses_what_has_a_second_like_it() -> None:
    a, b = directions(0, 180), directions(8, -10)
    assert match(a, b, 0.7).tolist() == []
    assert match(a, b, 0.9).tolist() == [[0, 0]]


def test_ratio_holds_in_both_directions() -> None:
    """A match that passes the ratio test in one direction only is refused."""
    a, b = directions(0, 90), directions(8, -10)
    assert match(a, b, 0.7).tolist() == []
    assert match(b, a, 0.7).tolist() == []


def test_twins_match_nothing() -> None:
    a = directions(0, 120)
    assert match(a, directions(0, 0, 240), 0.8).tolist() == []


def test_swapping_the_sides_swaps_the_pairs() -> None:
    rng = torch.Generator().manual_seed(0)
    a = torch.nn.functional.normalize(torch.randn(60, 8, generator=rng), dim=-1)
    noise = 0.2 * torch.randn(60, 8, generator=rng)
    b = torch.nn.functional.normalize(a.flip(0) + noise, dim=-1)
    forward = match(a, b, 0.9)
    backward = match(b, a, 0.9)
    assert len(forward) > 20
    assert sorted(forward.tolist()) == sorted(backward[:, ::-1].tolist())
    assert (forward.sum(1) == 59).mean() > 0.9


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 5), (5, 0), (1, 5), (5, 1)])
def test_too_few_descriptors_for_a_ratio_match_nothing(n: int, m: int) -> None:
    pairs = match(directions(*range(n)).reshape(n, 2), directions(*range(m)).reshape(m, 2), 0.8)
    assert pairs.shape == (0, 2)
