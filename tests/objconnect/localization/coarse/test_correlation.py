"""Compiled sums over cells are those of torch, and those of plain loops."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from objconnect.localization.coarse import correlation
from objconnect.localization.coarse.correlation import MosaicSampler, sum_shifted
from objconnect.localization.coarse.grid import GroundGrid
from objconnect.localization.coarse.mosaic import Mosaic

ROWS, COLUMNS, CELLS, CHANNELS = 7, 9, 5, 3


@pytest.fixture(params=[True, False], ids=["compiled", "torch"])
def is_compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Each test runs with compiled loops, and with torch."""
    monkeypatch.setattr(correlation, "supports_loops", lambda _: request.param)
    return bool(request.param)


def test_shifted_planes_are_added_up(is_compiled: bool) -> None:
    rng = np.random.default_rng(3)
    planes = rng.normal(size=(CELLS, ROWS, COLUMNS)).astype(np.float32)
    known = (rng.uniform(size=(ROWS, COLUMNS)) < 0.7).astype(np.float32)
    # Some of the planes are shifted out of sight.
    shifts = rng.integers(-12, 13, (4, CELLS, 2)).astype(np.int32)
    weights = rng.uniform(size=(4, CELLS)).astype(np.float32)
    weights[1, 2] = 0
    expected, overlap = np.zeros((2, 4, ROWS, COLUMNS))
    for t, n, y, x in np.ndindex(4, CELLS, ROWS, COLUMNS):
        column, row = shifts[t, n]
        if 0 <= y + row < ROWS and 0 <= x + column < COLUMNS:
            expected[t, y, x] += weights[t, n] * planes[n, y + row, x + column]
            if n % 2 == 0:
                overlap[t, y, x] += weights[t, n] * known[y + row, x + column]
    sums, overlaps = sum_shifted(*map(torch.from_numpy, (planes, known, shifts, weights)), every=2)
    np.testing.assert_allclose(sums.numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(overlaps.numpy(), overlap, atol=1e-5)


@pytest.fixture
def mosaic() -> Mosaic:
    generator = torch.Generator().manual_seed(5)
    features = torch.randn((CHANNELS, ROWS, COLUMNS), generator=generator)
    known = torch.ones(ROWS, COLUMNS)
    known[2:4, 3:] = 0
    unit = torch.nn.functional.normalize(features, dim=0) * known
    grid = GroundGrid(np.zeros(2), 1.0, np.zeros((ROWS, COLUMNS)))
    return Mosaic(grid, unit, known, torch.zeros(CHANNELS), torch.eye(CHANNELS))


def test_features_equal_those_at_centres_of_cells(is_compiled: bool, mosaic: Mosaic) -> None:
    at = torch.tensor([[0.0, 0.0], [8.0, 6.0], [4.0, 1.0]])
    features = torch.stack([mosaic.features[:, int(y), int(x)] for x, y in at])
    sums, known = MosaicSampler(mosaic).compare(features, at[None], torch.tensor([[1.0, 2.0, 3.0]]))
    assert sums.tolist() == pytest.approx([6.0]) and known.tolist() == pytest.approx([6.0])


def test_unknown_ground_and_ground_beyond_count_nothing(is_compiled: bool, mosaic: Mosaic) -> None:
    at = torch.tensor([[[5.0, 2.5], [-1.0, 3.0], [40.0, 3.0], [0.0, 3.0], [0.0, 6.5]]])
    features = mosaic.features[:, 0, 0].expand(5, -1)
    sums, known = MosaicSampler(mosaic).compare(features, at, torch.ones(1, 5))
    # Half of the last position lies beyond the grid.
    assert known.tolist() == pytest.approx([1.5])
    assert abs(float(sums)) <= 1.5


def test_loops_compare_as_torch_between_cells(
    mosaic: Mosaic, monkeypatch: pytest.MonkeyPatch
) -> None:
    generator = torch.Generator().manual_seed(7)
    at = 12 * torch.rand((6, CELLS, 2), generator=generator) - 2
    weights = torch.rand((6, CELLS), generator=generator)
    features = torch.nn.functional.normalize(torch.randn((CELLS, CHANNELS), generator=generator))
    compiled = MosaicSampler(mosaic).compare(features, at, weights)
    monkeypatch.setattr(correlation, "supports_loops", lambda _: False)
    by_torch = MosaicSampler(mosaic).compare(features, at, weights)
    for one, other in zip(compiled, by_torch, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-4)
