"""Queries and maps that nobody can do anything with: an answer with its reason, never an exception
and never a pose that is not finite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import GATE_SCENES
from objconnect.methods import METHODS, create
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from tests.baselines.lightglue.weights import LIGHTGLUE, options_of

GATE = GATE_SCENES["gate"]
(DATASET,) = open_datasets(GATE)
# The prior itself looks at neither image nor points.
LOOKING = tuple(name for name in METHODS if name != "prior")
# The coarsest threshold of recall.
FOUND_M = 5.0


def few_photographs(sparse_map: SparseMap) -> SparseMap:
    """Those around the query, to be quick."""
    truth = DATASET.queries[0].reference.centre().numpy()
    near = np.linalg.norm(sparse_map.centres - truth, axis=1).argsort()[:3]
    names = [sparse_map.names[row] for row in sorted(near)]
    return replace(sparse_map, images={name: sparse_map.images[name] for name in names})


def observing(sparse_map: SparseMap, points: NDArray[np.int64]) -> SparseMap:
    """The map with the observations of some of its points alone."""
    images = {
        name: replace(
            image, point_rows=np.where(np.isin(image.point_rows, points), image.point_rows, -1)
        )
        for name, image in sparse_map.images.items()
    }
    return replace(sparse_map, images=images)


WHOLE = few_photographs(DATASET.load_map())
QUERY = DATASET.queries[0].load(DATASET.queries[0].prior)
TRUTH = DATASET.queries[0].reference


def one_point(sparse_map: SparseMap) -> SparseMap:
    """The point that most photographs see, alone."""
    seen = np.concatenate([image.point_rows for image in sparse_map.images.values()])
    row = int(np.bincount(seen[seen >= 0]).argmax())
    kept = observing(sparse_map, np.array([row]))
    images = {
        name: replace(image, point_rows=np.minimum(image.point_rows, 0))
        for name, image in kept.images.items()
    }
    return SparseMap(
        images,
        sparse_map.xyz[[row]],
        sparse_map.rgb[[row]],
        sparse_map.error[[row]],
        sparse_map.track_length[[row]],
    )


def create_or_skip(method: str) -> Localizer:
    try:
        return create(method, options_of(method))
    except InputError as error:
        pytest.skip(f"{method} cannot be made: {error}")


# They differ from ``sift`` in their features alone.
LEARNED = ("d2net", *LIGHTGLUE)


def mark_slow(method: str, slow: tuple[str, ...]) -> Any:
    return pytest.param(method, marks=pytest.mark.thorough) if method in slow else method


@pytest.fixture(scope="module", params=[mark_slow(name, LEARNED) for name in LOOKING])
def localizer(request: pytest.FixtureRequest, cache: Path) -> Localizer:
    """Every method, prepared on a sound map."""
    localizer = create_or_skip(request.param)
    localizer.prepare(WHOLE, DATASET.images, cache)
    return localizer


def assert_answer(estimate: Estimate) -> None:
    """Whatever it says, it can be read."""
    if estimate.status is Status.FAILED:
        assert estimate.cam_from_world is None
    else:
        assert estimate.cam_from_world is not None
        assert bool(estimate.cam_from_world.matrix().isfinite().all())
    assert (estimate.by is None) == (estimate.cam_from_world is None)
    if estimate.status is not Status.OK:
        assert estimate.reason
    if estimate.covariance is not None:
        assert np.isfinite(estimate.covariance).all()


def metres_off(pose: Pose | None) -> float:
    assert pose is not None
    return float(pose.error_to(TRUTH)[0])


def with_image(make: Callable[[tuple[int, ...]], NDArray[np.uint8]]) -> Query:
    return replace(QUERY, image=make(QUERY.image.shape))


def with_prior(**changes: object) -> Query:
    assert QUERY.prior is not None
    return replace(QUERY, prior=replace(QUERY.prior, **changes))  # type: ignore[arg-type]


def noise(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)


IMAGES = {
    "black": with_image(lambda shape: np.zeros(shape, np.uint8)),
    "white": with_image(lambda shape: np.full(shape, 255, np.uint8)),
    "noise": with_image(noise),
}
NAN = np.full(3, np.nan)
FAULTS = {
    "position": (with_prior(position=NAN), "the prior's position is not finite"),
    "infinite": (with_prior(position=np.array([0, np.inf, 0])), "position is not finite"),
    "sigma": (with_prior(position_sigma=NAN), "has a sigma that is negative"),
    "negative": (
        with_prior(position_sigma=np.full(3, -1.0)),
        "has a sigma that is negative",
    ),
    "attitude": (with_prior(cam_from_world_rotation=np.full((3, 3), np.nan)), "attitude is not"),
    "angle": (with_prior(attitude_sigma_deg=float("nan")), "attitude has a sigma that is negative"),
    "float": (replace(QUERY, image=QUERY.image / 255), "the image is float64, not uint8"),  # type: ignore[arg-type]
    "size": (replace(QUERY, image=QUERY.image[:-1]), "the image has shape"),
    "grey": (replace(QUERY, image=QUERY.image[..., 0]), "the image has shape"),
}


NOTHING = [kind for kind in IMAGES if kind != "noise"]


@pytest.mark.parametrize("kind", [*NOTHING, pytest.param("noise", marks=pytest.mark.thorough)])
def test_an_image_of_nothing_is_not_localized(localizer: Localizer, kind: str) -> None:
    if localizer.name == "place" and kind == "noise":
        pytest.skip("place answers the likeliest start, which nothing has verified")
    for query in (IMAGES[kind], replace(IMAGES[kind], prior=None)):
        estimate = localizer.localize(query)
        assert_answer(estimate)
        assert estimate.status is not Status.OK


@pytest.mark.parametrize("kind", FAULTS)
def test_a_query_that_is_none_is_named(localizer: Localizer, kind: str) -> None:
    query, reason = FAULTS[kind]
    estimate = localizer.localize(query)
    assert_answer(estimate)
    assert estimate.status is Status.FAILED
    assert reason in estimate.reason


def test_a_prior_a_kilometre_off_is_no_answer(localizer: Localizer) -> None:
    """The nearest photographs may still be the right ones, and then the pose is."""
    assert QUERY.prior is not None
    estimate = localizer.localize(
        with_prior(position=QUERY.prior.position + np.array([1000.0, 0, 0]))
    )
    assert_answer(estimate)
    if estimate.status is Status.OK:
        assert metres_off(estimate.cam_from_world) < FOUND_M


def test_a_prior_of_infinite_sigma_is_one_nobody_relies_on(localizer: Localizer) -> None:
    assert QUERY.prior is not None
    wrong = QUERY.prior.position + np.array([30.0, -20, 10])
    prior = Prior(wrong, np.full(3, np.inf), QUERY.prior.cam_from_world_rotation, np.inf)
    estimate = localizer.localize(replace(QUERY, prior=prior))
    assert_answer(estimate)
    if estimate.status is Status.OK:
        # The place search answers starts.
        limit = 3 * FOUND_M if localizer.name == "place" else FOUND_M
        assert metres_off(estimate.cam_from_world) < limit


# Both search by the engine of ``pixloc``.
SEARCHING = ("objconnect", "pixloc-search")


@pytest.mark.parametrize(
    "method",
    [mark_slow(name, (*SEARCHING, *LEARNED)) for name in LOOKING],
)
@pytest.mark.parametrize(
    "spoiled",
    [one_point(WHOLE), observing(WHOLE, np.zeros(0, np.int64))],
    ids=["one_point", "points_nobody_sees"],
)
def test_a_map_that_says_nothing(method: str, spoiled: SparseMap, cache: Path) -> None:
    localizer = create_or_skip(method)
    localizer.prepare(spoiled, DATASET.images, cache)
    estimate = localizer.localize(QUERY)
    assert_answer(estimate)
    if estimate.status is Status.OK:
        # Without points from the photographs alone.
        assert metres_off(estimate.cam_from_world) < FOUND_M
