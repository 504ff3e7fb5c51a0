"""Compiled costs are those of torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from objconnect.mapping.dense import patchmatch
from objconnect.mapping.dense.compiled_cost import CompiledPhotometry
from objconnect.mapping.dense.patchmatch import first_estimate
from objconnect.mapping.dense.photometry import WORST_COST, Photometry
from objconnect.mapping.dense.warp import StereoView
from tests.objconnect.mapping.dense.made_views import (
    REFERENCE,
    SOURCES,
    inverse_depth_at,
    photograph,
)

TRUE = inverse_depth_at(REFERENCE).float()
ROWS, COLUMNS = (each.flatten() for each in torch.meshgrid(
    torch.arange(80), torch.arange(96), indexing="ij"
))  # fmt: skip


def narrow(view: StereoView) -> StereoView:
    """Cut the left half out."""
    camera = view.camera
    half = type(camera)("PINHOLE", camera.width // 2, camera.height, camera.params)
    return StereoView(view.grey[:, : half.width].contiguous(), half, view.cam_from_world)


# The last two photographs see a part of the reference; one of them has another size.
VIEWS = [*SOURCES, photograph(14.0, 2.0), narrow(photograph(-3.0, 1.0))]
_HOLES = torch.Generator().manual_seed(0)
MAPS = [
    torch.where(torch.rand(v.grey.shape, generator=_HOLES) < 0.2, 0.0, inverse_depth_at(v).float())
    for v in VIEWS
]


def some_planes(seed: int) -> torch.Tensor:
    """Planes near the true ones, and far ones that leave the sources' pictures."""
    generator = torch.Generator().manual_seed(seed)
    shares = 1 + 0.05 * torch.randn(len(ROWS), generator=generator)
    shares[::7] = 30.0
    shares[::11] = -1.0
    slopes = 1e-3 * torch.randn(2, len(ROWS), generator=generator)
    return torch.cat([(TRUE[ROWS, COLUMNS] * shares)[None], slopes])


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("maps", [None, MAPS], ids=["alone", "with-maps"])
def test_costs_are_those_of_torch(maps: list[torch.Tensor] | None, threads: int) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        costs = []
        for kind in (Photometry, CompiledPhotometry):
            photometry = kind(REFERENCE, VIEWS, TRUE, maps)
            window = photometry.window(ROWS, COLUMNS)
            costs.append(photometry.cost(window, some_planes(1)))
    finally:
        torch.set_num_threads(before)
    # Where a point lies between two pixels of a map, rounding decides which is read.
    assert ((costs[1] - costs[0]).abs() < 2e-4).double().mean() > 0.999
    assert (costs[0] < 0.1).any() and (costs[0] >= WORST_COST).any()


def test_what_is_not_below_a_bound_may_be_left_out() -> None:
    photometry = CompiledPhotometry(REFERENCE, VIEWS, TRUE)
    window = photometry.window(ROWS, COLUMNS)
    true = photometry.cost(window, some_planes(1))
    bound = photometry.cost(window, some_planes(2))
    bounded = photometry.cost(window, some_planes(1), bound)
    better = true < bound
    assert 0.1 < better.double().mean() < 0.9
    torch.testing.assert_close(bounded[better], true[better], atol=0, rtol=0)
    assert (bounded[~better] >= bound[~better]).all()
    assert (bounded != true).any()


def test_planes_that_are_no_numbers_cost_most() -> None:
    photometry = CompiledPhotometry(REFERENCE, SOURCES, TRUE)
    window = photometry.window(ROWS, COLUMNS)
    planes = some_planes(1)
    planes[0, ::3], planes[1, 1::3] = torch.nan, torch.inf
    cost = photometry.cost(window, planes)
    assert (cost[::3] == WORST_COST).all()


def test_without_numba_torch_computes_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = np.array([[20.5, 20.5, float(TRUE[20, 20])], [70.5, 60.5, float(TRUE[60, 70])]])

    def planes() -> torch.Tensor:
        generator = torch.Generator().manual_seed(1)
        return first_estimate(REFERENCE, SOURCES, seeds, generator).planes

    compiled = planes()
    monkeypatch.setattr(patchmatch, "supports_loops", lambda device: False)
    assert patchmatch._photometry(torch.device("cpu")) is Photometry
    assert ((planes()[0] / compiled[0] - 1).abs() < 1e-3).double().mean() > 0.9
