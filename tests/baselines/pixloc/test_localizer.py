from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from baselines.pixloc.localizer import SHIPPED, PixlocConfig, PixlocLocalizer
from objconnect.localization.coarse.finder import CoarseSearchOptions
from objconnect.localization.featuremetric.acceptance import AcceptanceModel
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.localization.featuremetric.references import MAX_POINTS
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.methods import create
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import roll_rotation, rotate_north_up
from objconnect.scene.localizer import Estimate, Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.pixloc.made_map import CAMERA, looking_down, photograph, write_map

TRUTH = looking_down(9.3, -0.4, (1.5, -1.0, 4.0))
START = looking_down(8.9, -0.1, (0.5, 0.0, 3.0))
STAGES = {"features", "retrieval", "points", "alignment"}


@pytest.fixture(scope="module")
def weights() -> Path:
    """Those shipped: features of an untrained network say more of the picture's edge than of it."""
    return SHIPPED


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("map") / "images"
    return write_map(images), images


@pytest.fixture(scope="module")
def localizer(weights: Path, made: tuple[SparseMap, Path], cache: Path) -> PixlocLocalizer:
    localizer = PixlocLocalizer(PixlocConfig(weights=weights))
    localizer.prepare(*made, cache)
    return localizer


def prior(pose: Pose, attitude: bool = True) -> Prior:
    rotation = pose.rotation.numpy() if attitude else None
    return Prior(pose.centre().numpy(), None, rotation, None)


QUERY = Query("query.png", photograph(TRUTH), CAMERA, prior(START))


def errors(estimate: Estimate) -> tuple[float, float]:
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(TRUTH)
    return float(metres), float(degrees)


def assert_fell_back(estimate: Estimate, pose: Pose, reason: str) -> None:
    assert estimate.status is Status.FALLBACK
    assert reason in estimate.reason
    assert estimate.cam_from_world is not None
    np.testing.assert_allclose(estimate.cam_from_world.matrix(), pose.matrix(), atol=1e-9)


def test_finds_the_pose(localizer: PixlocLocalizer) -> None:
    estimate = localizer.localize(QUERY)
    assert estimate.status is Status.OK, estimate.reason
    metres, degrees = errors(estimate)
    assert metres < 0.1 and degrees < 0.25
    assert set(estimate.seconds) == STAGES
    assert 100 < estimate.inliers <= MAX_POINTS
    assert estimate.iterations > 3
    sigma = estimate.sigma_position()
    assert sigma is not None and 0 < sigma < 1


def test_attitude_of_the_nearest_photograph(localizer: PixlocLocalizer) -> None:
    pose = looking_down(9.0, -0.2)  # the photographs look straight down
    metres, degrees = errors(localizer.localize(replace(QUERY, prior=prior(pose, attitude=False))))
    assert metres < 0.15 and degrees < 0.375


def test_without_prior(localizer: PixlocLocalizer) -> None:
    """Photographs of the map find themselves among its photographs: these start at the truth."""
    for number in range(5):
        truth = looking_down(6.0 * number, 0.5 * (number % 2))
        estimate = localizer.localize(Query("q", photograph(truth), CAMERA))
        assert estimate.status is Status.OK, estimate.reason
        assert estimate.cam_from_world is not None
        metres, degrees = estimate.cam_from_world.error_to(truth)
        assert metres < 0.5 and degrees < 1


def test_references_of_the_query(localizer: PixlocLocalizer) -> None:
    estimate = localizer.localize(replace(QUERY, references=("1.png", "2.png")))
    assert errors(estimate)[0] < 0.1
    # The other end of the map shows little of what the query shows.
    other = localizer.localize(replace(QUERY, references=("4.png",)))
    assert errors(other)[0] > 2 * errors(estimate)[0]
    assert other.inliers < estimate.inliers / 2
    with pytest.raises(InputError, match="no photograph 9.png"):
        localizer.localize(replace(QUERY, references=("9.png",)))


def test_many_starts_reach_further(
    weights: Path, made: tuple[SparseMap, Path], cache: Path
) -> None:
    far = replace(QUERY, prior=prior(looking_down(15.0, 3.6, (7.0, -6.0, 10.0))))
    found = {}
    for many in (False, True):
        localizer = PixlocLocalizer(PixlocConfig(weights=weights, multistart=many))
        localizer.prepare(*made, cache)
        found[many] = errors(localizer.localize(far))[0]
    assert found[False] > 1
    assert found[True] < 0.2


NEVER = AcceptanceModel.model_validate(
    {
        "aligned": {"bias": -20, "peak": 0, "halves": 0, "curvature": 0},
        "matched": {"bias": -20, "inliers": 0},
    }
)


def test_where_no_answer_is_believed_is_searched_again(
    weights: Path, made: tuple[SparseMap, Path], cache: Path
) -> None:
    found = {}
    for name, search in {
        "believed": SearchOptions(),
        "refused": SearchOptions(acceptance=NEVER),
        "refused once": SearchOptions(acceptance=NEVER, again=1),
        "any": SearchOptions(acceptance=NEVER, risk=1),
    }.items():
        localizer = PixlocLocalizer(PixlocConfig(weights=weights, multistart=True, search=search))
        localizer.prepare(*made, cache)
        found[name] = localizer.localize(QUERY)
    assert found["refused"].iterations > 1.5 * found["refused once"].iterations
    assert found["believed"].iterations == found["refused once"].iterations
    assert found["refused"].status is Status.FALLBACK
    assert "right with a probability of 0.00, below 0.95" in found["refused"].reason
    for name in ("believed", "any"):
        assert errors(found[name])[0] < 0.1 and found[name].status is Status.OK
    assert (found["believed"].probability or 0) > 0.95 > (found["any"].probability or 0)


def test_a_search_that_references_begin_ends_with_the_nearest_ones(
    weights: Path, made: tuple[SparseMap, Path], cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photographs 0 and 3 are named; the query was taken between 1 and 2."""
    chosen = []

    def photographs(refine: Refiner, query: Query) -> NDArray[np.int64]:
        chosen.append(choose(refine, query).tolist())
        return np.array(chosen[-1])

    choose = Refiner.choose_references
    monkeypatch.setattr(Refiner, "choose_references", photographs)
    named = replace(QUERY, prior=None, references=("0.png", "3.png"))
    localizer = PixlocLocalizer(PixlocConfig(weights=weights, multistart=True, references=2))
    localizer.prepare(*made, cache)
    estimate = localizer.localize(named)
    assert errors(estimate)[0] < 0.2
    assert chosen[0] == [0, 3] and set(chosen[-1]) == {1, 2}


@pytest.mark.thorough
def test_an_altitude_nobody_knows_is_that_of_the_flight(
    weights: Path, made: tuple[SparseMap, Path], cache: Path
) -> None:
    """Below the ground, and known to no better than 60 m; nor how the camera is turned.

    One start is the same as at the flight's altitude, and as exact (0.15 m, as there).
    """
    low = looking_down(9.0, -0.2)
    flown = replace(QUERY, prior=prior(low, attitude=False))
    centre = low.centre().numpy() - [0, 0, 30]
    unknown = Prior(centre, np.array([2.0, 2.0, 60.0]))
    # Where it passes for known, only the place search leads out of the ground.
    sure = replace(unknown, position_sigma=np.array([2.0, 2.0, 1.0]))
    found, misled = {}, {}
    for many in (False, True):
        place = CoarseSearchOptions(candidates=5 if many else 0)
        localizer = PixlocLocalizer(PixlocConfig(weights=weights, multistart=many, place=place))
        localizer.prepare(*made, cache)
        found[many] = errors(localizer.localize(replace(QUERY, prior=unknown)))[0]
        misled[many] = localizer.localize(replace(QUERY, prior=sure))
        if not many:
            assert found[many] == pytest.approx(errors(localizer.localize(flown))[0], abs=1e-3)
    assert found[False] < 0.15 and found[True] < 0.1
    assert misled[False].status is not Status.OK
    assert misled[True].status is Status.OK and errors(misled[True])[0] < 0.1


def test_beside_photographs_is_looked_where_the_position_is_poor(
    weights: Path, made: tuple[SparseMap, Path], cache: Path
) -> None:
    """By the place search: above ground that the map does not have, turned by a right angle."""
    rotation = roll_rotation(-math.radians(100)) @ rotate_north_up(TRUTH.rotation.numpy())
    turned = Pose(torch.from_numpy(rotation), torch.from_numpy(-rotation @ TRUTH.centre().numpy()))
    aside = Prior(np.array([9.3, -26.0, 20.0]))
    query = Query("query.png", photograph(turned), CAMERA, aside)
    localizer = PixlocLocalizer(
        PixlocConfig(weights=weights, multistart=True, place=CoarseSearchOptions())
    )
    localizer.prepare(*made, cache)
    estimate = localizer.localize(query)
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(turned)
    assert metres < 0.1 and degrees < 0.25


def test_a_camera_turned_over_is_tried_where_attitude_is_unknown(
    weights: Path, made: tuple[SparseMap, Path], tmp_path: Path
) -> None:
    """The nearest photograph was flown the other way round."""
    sparse_map, images = made
    over = np.diag([-1.0, -1.0, 1.0])
    camera = CAMERA.params
    turned_camera = replace(
        CAMERA, params=(*camera[:2], CAMERA.width - camera[2], CAMERA.height - camera[3])
    )
    flown, folder = {}, tmp_path / "images"
    folder.mkdir()
    for name, image in sparse_map.images.items():
        picture = np.asarray(Image.open(images / name))
        if name == "2.png":  # the nearest to the query
            picture = picture[::-1, ::-1]
            pose = np.eye(4)
            pose[:3, :3] = over
            image = replace(
                image,
                camera=turned_camera,
                cam_from_world=pose @ image.cam_from_world,
                xy=[CAMERA.width, CAMERA.height] - image.xy,
            )
        Image.fromarray(picture).save(folder / name)
        flown[name] = image
    localizer = PixlocLocalizer(PixlocConfig(weights=weights, multistart=True))
    localizer.prepare(replace(sparse_map, images=flown), folder, tmp_path)
    near = Prior(looking_down(11.0, -0.4).centre().numpy(), None)
    assert errors(localizer.localize(replace(QUERY, prior=near)))[0] < 0.1


@pytest.mark.parametrize("offset", [(1000.0, 0, 0), (0, 0, -60.0)], ids=["aside", "below"])
def test_prior_far_off(localizer: PixlocLocalizer, offset: tuple[float, float, float]) -> None:
    rotation = START.rotation
    pose = Pose(rotation, -rotation @ (START.centre() + START.centre().new_tensor(offset)))
    assert_fell_back(localizer.localize(replace(QUERY, prior=prior(pose))), pose, "too few points")


def test_images_nobody_can_localize(localizer: PixlocLocalizer) -> None:
    nan = np.full((192, 256, 3), np.nan)
    small = Camera("PINHOLE", 15, 40, (20.0, 20.0, 7.0, 20.0))
    for query in (
        replace(QUERY, image=nan),  # type: ignore[arg-type]
        replace(QUERY, image=QUERY.image[:100]),
        replace(QUERY, image=np.zeros((40, 15, 3), np.uint8), camera=small),
        replace(QUERY, prior=Prior(np.array([np.nan, 0, 0]))),
    ):
        estimate = localizer.localize(query)
        assert estimate.status is Status.FAILED
        assert estimate.reason and estimate.cam_from_world is None


def test_a_blank_image_gives_a_finite_pose(localizer: PixlocLocalizer) -> None:
    """Whatever comes of it, it is a finite pose."""
    estimate = localizer.localize(replace(QUERY, image=np.zeros_like(QUERY.image)))
    assert estimate.cam_from_world is not None
    assert np.isfinite(estimate.cam_from_world.matrix()).all()


@pytest.mark.parametrize("kept", [0, 1])
def test_map_of_a_point_or_none(
    weights: Path, made: tuple[SparseMap, Path], tmp_path: Path, kept: int
) -> None:
    sparse_map, images = made
    few = {
        name: replace(image, point_rows=np.full_like(image.point_rows, -1))
        for name, image in sparse_map.images.items()
    }
    if kept:
        first = sparse_map.images["1.png"]
        rows = np.full_like(first.point_rows, -1)
        rows[len(rows) // 2] = first.point_rows[len(rows) // 2]
        few["1.png"] = replace(first, point_rows=rows)
    localizer = PixlocLocalizer(PixlocConfig(weights=weights))
    localizer.prepare(replace(sparse_map, images=few), images, tmp_path)
    assert_fell_back(localizer.localize(QUERY), START, "too few points")
    without = localizer.localize(replace(QUERY, prior=None))
    assert without.status is Status.FALLBACK


def test_sizes_that_are_no_multiples(weights: Path, made: tuple[SparseMap, Path]) -> None:
    """Resized by two factors that differ, and cut by the network: pixels still mean the same."""
    sparse_map, images = made
    odd = Camera("PINHOLE", 250, 187, (220.0, 224.0, 123.0, 95.5))
    query = replace(QUERY, image=photograph(TRUTH, odd), camera=odd)
    localizer = PixlocLocalizer(PixlocConfig(weights=weights, longest=171))
    localizer.prepare(sparse_map, images)
    metres, degrees = errors(localizer.localize(query))
    assert metres < 0.2 and degrees < 0.6


def test_no_weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("baselines.pixloc.localizer.SHIPPED", tmp_path / "pixloc.safetensors")
    with pytest.raises(InputError, match="train them .* or give a file"):
        create("pixloc", {})
    with pytest.raises(InputError, match="no weights at"):
        create("pixloc", {"weights": str(tmp_path / "none.tar")})
