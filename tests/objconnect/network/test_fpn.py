"""The feature pyramid against Lin et al., cell by cell."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from objconnect.learning.vgg import channels
from objconnect.network.fpn import FeaturePyramid

WIDTH, SIZE, STRIDES = 0.05, 5, (16, 4, 2)
CELLS = {1: (32, 48), 2: (16, 24), 4: (8, 12), 8: (4, 6), 16: (2, 3)}


@pytest.fixture
def pyramid() -> FeaturePyramid:
    torch.manual_seed(0)
    return FeaturePyramid(WIDTH, SIZE, STRIDES).eval()


@pytest.fixture
def blocks() -> list[Tensor]:
    """What an encoder would make of a picture of 48 x 32, fine to coarse."""
    torch.manual_seed(1)
    sizes = zip(channels(WIDTH), CELLS.values(), strict=True)
    return [torch.randn(1, depth, *cells) for depth, cells in sizes]


@torch.no_grad()
def levels(pyramid: FeaturePyramid, blocks: list[Tensor]) -> dict[int, Tensor]:
    """(C, h, w) by stride."""
    return {stride: maps[0] for stride, maps in zip(STRIDES, pyramid(blocks), strict=True)}


def between(maps: Tensor, row: float, column: float) -> Tensor:
    """Linear between the centres of cells, and constant beyond the outermost."""
    _, height, width = maps.shape
    row, column = min(max(row, 0.0), height - 1), min(max(column, 0.0), width - 1)
    y, x = min(int(row), height - 2), min(int(column), width - 2)
    b, a = row - y, column - x
    upper = (1 - a) * maps[:, y, x] + a * maps[:, y, x + 1]
    lower = (1 - a) * maps[:, y + 1, x] + a * maps[:, y + 1, x + 1]
    return (1 - b) * upper + b * lower


@torch.no_grad()
def test_levels_are_laterals_plus_the_coarser_step_smoothed(
    pyramid: FeaturePyramid, blocks: list[Tensor]
) -> None:
    steps: dict[int, Tensor] = {}
    for number, stride in enumerate((16, 8, 4, 2)):
        lateral = pyramid.lateral[number]
        block, weight = blocks[-1 - number][0], lateral.weight[..., 0, 0]
        step = torch.einsum("oc,chw->ohw", weight, block) + lateral.bias[:, None, None]
        if number:
            coarser, (height, width) = steps[2 * stride], CELLS[stride]
            for row in range(height):
                for column in range(width):
                    # The centre of a fine cell, in coarse cells.
                    above, left = (row + 0.5) / 2 - 0.5, (column + 0.5) / 2 - 0.5
                    step[:, row, column] += between(coarser, above, left)
        steps[stride] = step
    found = levels(pyramid, blocks)
    for smooth, stride in zip(pyramid.smooth, STRIDES, strict=True):
        step, kernel = steps[stride], smooth[0].weight
        _, height, width = step.shape
        framed = torch.zeros(SIZE, height + 2, width + 2)
        framed[:, 1:-1, 1:-1] = step
        expected = torch.empty_like(step)
        for row in range(height):
            for column in range(width):
                window = framed[:, row : row + 3, column : column + 3]
                expected[:, row, column] = (kernel * window).sum((1, 2, 3))
        # Batch normalisation that has seen nothing yet takes the variance for one.
        expected = (expected / (1 + 1e-5) ** 0.5).clamp(min=0)
        torch.testing.assert_close(found[stride], expected, atol=1e-5, rtol=1e-4)


def change(before: Tensor, after: Tensor) -> set[tuple[int, int]]:
    """Rows and columns of the cells that differ."""
    return {(int(row), int(column)) for row, column in (before != after).any(0).nonzero()}


def test_fine_levels_see_what_only_the_coarsest_block_shows(
    pyramid: FeaturePyramid, blocks: list[Tensor]
) -> None:
    before = levels(pyramid, blocks)
    blocks[-1][:, :, 0, 0] += 10
    after = levels(pyramid, blocks)
    for stride in STRIDES:
        cells = change(before[stride], after[stride])
        assert (0, 0) in cells
        # The coarse cell, a half more by interpolation on each of three steps, and smoothing.
        reach = 16 * 2 + 3 * stride
        assert all(max(row, column) * stride < reach for row, column in cells)


def test_a_block_shows_in_no_coarser_level(pyramid: FeaturePyramid, blocks: list[Tensor]) -> None:
    before = levels(pyramid, blocks)
    blocks[2] += 10
    after = levels(pyramid, blocks)
    assert torch.equal(before[16], after[16])
    assert not torch.equal(before[4], after[4]) and not torch.equal(before[2], after[2])


def test_what_one_cell_shows_is_smoothed_over_its_neighbours(
    pyramid: FeaturePyramid, blocks: list[Tensor]
) -> None:
    before = levels(pyramid, blocks)
    blocks[1][:, :, 7, 9] += 10
    after = levels(pyramid, blocks)
    around = {(row, column) for row in (6, 7, 8) for column in (8, 9, 10)}
    assert change(before[2], after[2]) == around
