from __future__ import annotations

import numpy as np
import torch

from objconnect.mapping.dense.consistency import count_agreeing
from objconnect.mapping.dense.patchmatch import consistent_estimate, first_estimate
from objconnect.mapping.dense.photometry import Photometry
from tests.objconnect.mapping.dense.made_views import (
    CAMERA,
    REFERENCE,
    SOURCES,
    inverse_depth_at,
    thing_in,
    with_thing,
)

TRUE = inverse_depth_at(REFERENCE)


def some_seeds(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, 80, count), rng.integers(0, 96, count)
    return np.column_stack([columns + 0.5, rows + 0.5, TRUE[rows, columns].numpy()])


def right(planes: torch.Tensor) -> float:
    """Share of pixels within half a percent of the truth."""
    return float(((planes[0] / TRUE - 1).abs() < 0.005).double().mean())


def test_the_true_plane_costs_least() -> None:
    photometry = Photometry(REFERENCE, SOURCES, TRUE.float())
    rows, columns = torch.arange(15, 65), torch.arange(20, 70)
    window = photometry.window(rows, columns)
    w = TRUE.float()
    planes = torch.stack([w, (w[0, 1] - w[0, 0]).expand_as(w), (w[1, 0] - w[0, 0]).expand_as(w)])
    planes = planes[:, rows, columns]
    true = photometry.cost(window, planes)
    assert true.median() < 0.02
    for off in (0.95, 1.05):
        assert (photometry.cost(window, planes * torch.tensor([[off], [1.0], [1.0]])) > true).all()


def test_first_estimate_finds_the_plane() -> None:
    estimate = first_estimate(REFERENCE, SOURCES, some_seeds(12), torch.Generator().manual_seed(1))
    assert right(estimate.planes) > 0.85


def test_without_good_seeds_chance_finds_it() -> None:
    """Two seeds that only say the range: the planes come from random guesses and neighbours."""
    seeds = np.array([[1.0, 1.0, float(TRUE.min())], [95.0, 79.0, float(TRUE.max())]])
    estimate = first_estimate(REFERENCE, SOURCES, seeds, torch.Generator().manual_seed(1))
    assert right(estimate.planes) > 0.7


def test_the_same_seed_gives_the_same_planes() -> None:
    runs = [
        first_estimate(REFERENCE, SOURCES, some_seeds(12), torch.Generator().manual_seed(seed))
        for seed in (1, 1, 2)
    ]
    assert torch.equal(runs[0].planes, runs[1].planes)
    assert not torch.equal(runs[0].planes, runs[2].planes)


def test_maps_of_the_sources_pull_and_confirm() -> None:
    """A tenth of the planes is thrown off; the sources' true maps bring them back."""
    w = TRUE.float()
    slopes = [(w[0, 1] - w[0, 0]).expand_as(w), (w[1, 0] - w[0, 0]).expand_as(w)]
    generator = torch.Generator().manual_seed(3)
    off = torch.rand(w.shape, generator=generator) < 0.1
    start = torch.stack([torch.where(off, 1.3 * w, w), *slopes])
    maps = [inverse_depth_at(source).float() for source in SOURCES]
    before = count_agreeing(REFERENCE, SOURCES, start[0], maps)
    assert before[off].max() == 0
    estimate = consistent_estimate(REFERENCE, SOURCES, start, maps, generator)
    assert right(estimate.planes) > 0.95
    after = count_agreeing(REFERENCE, SOURCES, estimate.planes[0], maps)
    assert (after >= 2).double().mean() > 0.9


def test_a_thing_of_a_few_pixels_is_found_where_a_point_of_the_map_lies_on_it() -> None:
    """At the smallest size it is two pixels wide: there the ground around it takes it."""
    camera = CAMERA.resize(2 * CAMERA.width, 2 * CAMERA.height)
    reference, *sources = [with_thing(view, camera) for view in (REFERENCE, *SOURCES)]
    truth, thing = thing_in(reference)
    rows, columns = torch.nonzero(thing, as_tuple=True)
    assert thing.sum() == 25
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.integers(0, 160, 12), rng.integers(0, 192, 12)])
    middle = [[int(rows.double().mean()), int(columns.double().mean())]]

    def right_of_thing(pixels: np.ndarray) -> float:
        row, column = pixels.T
        seeds = np.column_stack([column + 0.5, row + 0.5, truth[row, column].numpy()])
        found = first_estimate(reference, sources, seeds, torch.Generator().manual_seed(1))
        return float(((found.planes[0] / truth - 1).abs() < 0.005)[thing].double().mean())

    assert right_of_thing(np.concatenate([ground, middle])) > 0.5
    assert right_of_thing(ground) < 0.2
