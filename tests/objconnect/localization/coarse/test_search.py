"""The search finds a picture of made ground, whatever of its pose is not known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.localization.coarse.finder import ALTITUDE_RATIOS, hypotheses
from objconnect.localization.coarse.grid import GroundGrid, ground_grid
from objconnect.localization.coarse.headings import tilt_rotations
from objconnect.localization.coarse.mosaic import Mosaic, empty_mosaic
from objconnect.localization.coarse.search import (
    Candidate,
    Hypotheses,
    MosaicSearch,
    Peak,
    RoughPeaks,
    _divide_by_noise,
)
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.geometry.views import WarpedImage, warp_image
from objconnect.scene.localizer import Prior

CELL, CHANNELS = 2.0, 8
CAMERA = Camera("PINHOLE", 320, 320, (300.0, 300.0, 160.0, 160.0))
DOWN = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


@pytest.fixture
def mosaic() -> Mosaic:
    """Ground of 160 x 200 m, smooth over a few cells, 5 m high."""
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn((1, CHANNELS, 84, 104), generator=generator)
    smooth = torch.nn.functional.avg_pool2d(noise, 5, 1)[0]
    features = torch.nn.functional.normalize(smooth, dim=0)
    grid = GroundGrid(np.array([-80.0, -100.0]), CELL, np.full((80, 100), 5.0))
    known = torch.ones(grid.shape)
    return Mosaic(grid, features, known, torch.zeros(CHANNELS), torch.eye(CHANNELS))


def tilt_camera(degrees: float) -> torch.Tensor:
    """A camera that looks so far up from straight down, to the north."""
    about_x = torch.tensor([-math.radians(degrees), 0.0, 0.0], dtype=torch.float64)
    return so3_exp(about_x) @ DOWN


def render_view(mosaic: Mosaic, pose: Pose) -> tuple[WarpedImage, FeatureMap]:
    """What a perfect network sees from a pose: the ground's own features in each cell."""
    picture = warp_image(np.zeros((320, 320, 3), np.uint8), CAMERA)
    grid, stride = mosaic.grid, 16
    steps = (torch.arange(20, dtype=torch.float64) + 0.5) * stride
    xy = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), -1).reshape(-1, 2)
    rays, _ = CAMERA.unproject(xy)
    directions = rays @ pose.rotation
    centre = pose.centre()
    length = (5.0 - centre[2]) / directions[:, 2]
    ground = (centre + length[:, None] * directions).numpy()
    column, row = np.floor((ground[:, :2] - grid.origin) / CELL).astype(int).T
    inside = (length.numpy() > 0) & (row >= 0) & (row < 80) & (column >= 0) & (column < 100)
    features = torch.zeros(CHANNELS, 400)
    features[:, inside] = mosaic.features[:, row[inside], column[inside]]
    confidence = torch.from_numpy((length.numpy() > 0).astype(np.float32))
    return picture, FeatureMap(
        features.reshape(1, CHANNELS, 20, 20), confidence.reshape(1, 1, 20, 20), stride
    )


def search(
    mosaic: Mosaic, true: Pose, tried: Hypotheses, count: int, separation: float = 12.0
) -> list[Candidate]:
    """The candidates of a query taken at a pose.

    The network sees the same whatever it is asked from: turning the picture is its caller's.
    """
    find = MosaicSearch(mosaic, separation)
    return find(find.extract_views(lambda _: render_view(mosaic, true), tried), tried, count)


def make_pose(rotation: torch.Tensor, centre: tuple[float, float, float]) -> Pose:
    return Pose(rotation, -rotation @ torch.tensor(centre, dtype=torch.float64))


def off(found: Pose, true: Pose) -> tuple[float, float]:
    metres, degrees = found.error_to(true)
    return float(metres), float(degrees)


@pytest.mark.parametrize(("tilt", "height"), [(0.0, 60.0), (45.0, 40.0)])
def test_place_heading_and_altitude_are_found(mosaic: Mosaic, tilt: float, height: float) -> None:
    base = tilt_camera(tilt)
    true = make_pose(base @ so3_exp(math.radians(130) * UP), (12.0, -20.0, 5.0 + height))
    passes = [base @ so3_exp(math.radians(k * 10) * UP) for k in range(36)]
    hypotheses = Hypotheses(passes, [0.0], [0.7 * height, height, 1.3 * height])
    best, *others = search(mosaic, true, hypotheses, 3)
    metres, degrees = off(best.pose, true)
    assert metres < 3 * CELL and degrees < 6
    assert best.score > 16 and all(each.score < best.score for each in others)


def test_a_large_mosaic_is_searched_at_half_resolution(
    mosaic: Mosaic, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("objconnect.localization.coarse.search._MOST_CELLS", 2500)
    true = make_pose(DOWN @ so3_exp(math.radians(130) * UP), (12.0, -20.0, 65.0))
    passes = [DOWN @ so3_exp(math.radians(k * 10) * UP) for k in range(36)]
    best = search(mosaic, true, Hypotheses(passes, [0.0], [45.0, 60.0, 80.0]), 1)[0]
    metres, degrees = off(best.pose, true)
    assert metres < 3 * CELL and degrees < 6
    assert best.score > 16


def test_scores_are_divided_by_the_noise_of_all_views_at_their_tilt_and_altitude() -> None:
    low, high = (Peak(0.4, 0.0, 0.0, altitude, DOWN, 1.0) for altitude in (40.0, 80.0))
    first = [RoughPeaks([low], 3.0, 100), RoughPeaks([high], 0.5, 100)]
    second = [RoughPeaks([], 5.0, 100), RoughPeaks([high], 1.5, 100)]
    divided = _divide_by_noise([first, second])
    assert [[peak.noise for peak in view] for view in divided] == [
        pytest.approx([0.2, 0.1]),
        pytest.approx([0.1]),
    ]
    assert [peak.score for peak in divided[0]] == pytest.approx([2.0, 4.0])


def test_turns_between_passes_are_tried(mosaic: Mosaic) -> None:
    true = make_pose(DOWN @ so3_exp(math.radians(18) * UP), (0.0, 10.0, 65.0))
    turns = [math.radians(each) for each in (-18, 0, 18)]
    hypotheses = Hypotheses([DOWN], turns, [60.0])
    best = search(mosaic, true, hypotheses, 1)[0]
    metres, degrees = off(best.pose, true)
    assert metres < 3 * CELL and degrees < 1


def test_places_are_sought_where_the_prior_lets_them_be(mosaic: Mosaic) -> None:
    true = make_pose(DOWN, (12.0, -20.0, 65.0))
    elsewhere = Hypotheses([DOWN], [0.0], [60.0], region=(-40.0, 40.0, 15.0))
    for candidate in search(mosaic, true, elsewhere, 5):
        x, y, _ = candidate.pose.centre().tolist()
        assert math.hypot(x + 40, y - 40) <= 15
        assert candidate.score < 8
    there = Hypotheses([DOWN], [0.0], [60.0], region=(10.0, -15.0, 15.0))
    assert search(mosaic, true, there, 1)[0].score > 16


@pytest.mark.parametrize(("sigma", "radius"), [(5.0, 19.0), (2.0, 10.0)])
def test_an_unsure_position_bounds_the_search(mosaic: Mosaic, sigma: float, radius: float) -> None:
    """By three standard deviations and two cells, of 2 m each."""
    known = Prior(np.array([10.0, 20.0, 65.0]), np.array([sigma, sigma - 1, 1.0]))
    tried = hypotheses(known, mosaic.grid, 80.0)
    assert tried.region == (10.0, 20.0, radius)
    assert tried.altitudes == [60.0]
    unknown = hypotheses(None, mosaic.grid, 80.0)
    assert unknown.region is None
    assert unknown.altitudes == [80.0 * part for part in ALTITUDE_RATIOS]


def test_candidates_are_apart(mosaic: Mosaic) -> None:
    true = make_pose(DOWN, (12.0, -20.0, 65.0))
    passes = [DOWN @ so3_exp(math.radians(each) * UP) for each in (-5, 0, 5)]
    hypotheses = Hypotheses(passes, [0.0], [55.0, 60.0, 65.0])
    found = search(mosaic, true, hypotheses, 6, separation=12.0)
    centres = np.array([each.pose.centre().numpy() for each in found])
    between = np.linalg.norm(centres[:, None, :2] - centres[None, :, :2], axis=-1)
    assert len(found) == 6
    assert between[np.triu_indices(6, 1)].min() > 12.0


def test_a_query_that_shows_no_ground_has_no_place(mosaic: Mosaic) -> None:
    upwards = torch.eye(3, dtype=torch.float64)
    level = make_pose(DOWN, (0.0, 0.0, 65.0))
    assert search(mosaic, level, Hypotheses([upwards], [0.0], [60.0]), 3) == []


def test_a_mosaic_comes_back_from_its_arrays(mosaic: Mosaic) -> None:
    again = Mosaic.of(mosaic.arrays())
    np.testing.assert_array_equal(again.grid.heights, mosaic.grid.heights)
    assert again.grid.cell == CELL
    torch.testing.assert_close(again.features, mosaic.features, atol=1e-3, rtol=0)
    assert empty_mosaic(mosaic.grid).is_empty and not mosaic.is_empty


def test_cells_take_the_median_height_of_their_points() -> None:
    rng = np.random.default_rng(0)
    flat: NDArray[np.float64] = np.column_stack([rng.uniform(0, 40, (4000, 2)), np.zeros(4000)])
    flat[flat[:, 0] > 20, 2] = 7.0
    stray = np.array([[500.0, 500.0, 90.0]])
    grid = ground_grid(np.concatenate([flat, stray]), 4.0)
    assert grid.shape == (10, 10)
    assert (grid.height_at(5, 5), grid.height_at(35, 5), grid.height_at(900, 5)) == (0, 7, 7)
    hole = flat[(flat[:, 0] < 8) | (flat[:, 0] > 30)]
    assert np.isfinite(ground_grid(hole, 4.0).heights).all()


@pytest.mark.parametrize(
    ("tilt", "heading"),
    [(23.0, 47.0), pytest.param(38.0, -100.0, marks=pytest.mark.thorough)],
)
def test_a_tilted_camera_is_found_between_the_tilts_and_headings_that_are_tried(
    mosaic: Mosaic, tilt: float, heading: float
) -> None:
    """Straight down, no candidate is near; of the tilts, the first is."""
    turned = so3_exp(math.radians(heading) * UP)
    true = make_pose(tilt_camera(tilt) @ turned, (12.0, -20.0, 62.0))
    passes = [DOWN @ so3_exp(math.radians(30 * k) * UP) for k in range(12)]
    turns = [math.radians(6 * k) for k in range(-2, 3)]
    flat = Hypotheses(passes, turns, [70.0 * part for part in ALTITUDE_RATIOS])
    seen = MosaicSearch(mosaic).extract_views(lambda _: render_view(mosaic, true), flat)
    straight = [off(each.pose, true) for each in MosaicSearch(mosaic)(seen, flat, 16)]
    assert straight and all(metres > 8 or degrees > 10 for metres, degrees in straight)
    tilted = replace(flat, tilts=tilt_rotations([15.0, 30.0, 45.0, 60.0]))
    metres, degrees = off(MosaicSearch(mosaic)(seen, tilted, 1)[0].pose, true)
    assert metres < 8 and degrees < 10
