"""Starts from objects: what is known is kept, the rest is searched, and maps are looked at once."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmark.datasets.open import open_datasets
from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.cache.store import Store
from objconnect.localization.coarse.headings import TILTS_DEG
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.global_search import GlobalSearch
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.references import ReferenceSource, load_references
from objconnect.network.finder import (
    ALTITUDE_RATIOS,
    ObjectSearch,
    ObjectSearchOptions,
    allowed_poses,
)
from objconnect.network.landmarks import Landmarks
from objconnect.network.localizer import SHIPPED, ObjConnectConfig, ObjConnectLocalizer
from objconnect.network.network import read_network
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.geometry.views import tilt
from objconnect.scene.localizer import Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap

DOWN = torch.diag(torch.tensor([1.0, -1.0, -1.0])).double()
ROTATION = (DOWN @ so3_exp(torch.ones(3).double() / 9)).numpy()


def test_nothing_known_is_searched_all_around() -> None:
    attitudes, bounds = allowed_poses(None, [70.0, 80.0, 90.0], TILTS_DEG, 8)
    assert torch.equal(attitudes[0], DOWN)
    tilts = [math.degrees(tilt(each.numpy())) for each in attitudes]
    assert tilts == pytest.approx(TILTS_DEG, abs=1e-4)
    assert bounds.headings == pytest.approx([k * math.tau / 8 for k in range(8)])
    assert bounds.heights == [80.0 * part for part in ALTITUDE_RATIOS]
    assert bounds.region is None


@pytest.mark.parametrize(
    ("sigma", "count"), [(math.inf, 24), (None, 24), (5.0, 3), (60.0, 17), (176.0, 24), (400.0, 24)]
)
def test_a_known_attitude_is_kept(sigma: float | None, count: int) -> None:
    prior = Prior(
        np.zeros(3),
        position_sigma=np.full(3, np.inf),
        cam_from_world_rotation=ROTATION,
        heading_sigma_deg=sigma,
    )
    (base,), bounds = allowed_poses(prior, [80.0])
    headings = bounds.headings
    np.testing.assert_array_equal(base.numpy(), ROTATION)
    assert len(headings) == count
    assert 0 in headings
    assert len({round(heading % math.tau, 6) for heading in headings}) == count


@pytest.fixture(scope="module")
def finder() -> ObjectSearch:
    network, _ = read_network(SHIPPED)
    return ObjectSearch(network, MapExtractor(network, 512, "float32"), ObjectSearchOptions())


def source_of(
    finder: ObjectSearch, sparse_map: SparseMap, scene: Scene, cache: Path, key: str = "a key"
) -> ReferenceSource:
    kept = MapCache.of(sparse_map, scene.images_root, cache)
    return ReferenceSource(kept, finder._finder._extract, key, "objconnect", 64)


def landmarks_in(path: Path) -> Landmarks:
    """Return the objects that a file of the cache holds."""
    return Store(path).make(0, Landmarks.ARRAYS, Landmarks.of)


@pytest.fixture(scope="module")
def seen(finder: ObjectSearch, rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cache of a finder that has looked at the rendered scene; no test changes it."""
    cache = tmp_path_factory.mktemp("seen")
    finder.prepare(source_of(finder, rendered.sparse_map(), rendered, cache))
    return cache


@pytest.fixture(scope="module")
def few(rendered: Scene) -> SparseMap:
    """Five photographs of the rendered scene."""
    whole = rendered.sparse_map()
    return replace(whole, images={name: whole.images[name] for name in whole.names[:5]})


@pytest.fixture(scope="module")
def seen_few(
    finder: ObjectSearch,
    rendered: Scene,
    few: SparseMap,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """The cache of a finder that has looked at the five photographs; no test changes it."""
    cache = tmp_path_factory.mktemp("seen-few")
    finder.prepare(source_of(finder, few, rendered, cache))
    return cache


def test_objects_are_found_in_the_feature_maps_of_references(
    finder: ObjectSearch,
    rendered: Scene,
    few: SparseMap,
    seen_few: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The network sees every photograph once, and finds the objects that it would find alone."""
    source = source_of(finder, few, rendered, tmp_path)
    load_references(source, 64, finder.observer(source))
    with monkeypatch.context() as patched:
        patched.setattr(MapExtractor, "features", None)
        finder.prepare(source)
    assert finder.observer(source) is None
    (one,), (other,) = (folder.glob("objects-*.h5") for folder in (seen_few, tmp_path))
    assert one.name == other.name
    found, again = landmarks_in(one), landmarks_in(other)
    assert len(found) >= 10
    np.testing.assert_array_equal(found.xyz, again.xyz)
    np.testing.assert_array_equal(found.vectors, again.vectors)


def test_the_map_is_looked_at_once(
    finder: ObjectSearch,
    rendered: Scene,
    seen: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sparse_map = rendered.sparse_map()
    cache = shutil.copytree(seen, tmp_path / "cache")
    (kept,) = cache.glob("objects-*.h5")
    assert len(landmarks_in(kept)) >= 10

    def again(*_: object) -> None:
        raise AssertionError("looked at twice")

    monkeypatch.setattr(MapExtractor, "__call__", again)
    finder.prepare(source_of(finder, sparse_map, rendered, cache))
    with pytest.raises(AssertionError, match="twice"):
        finder.prepare(source_of(finder, sparse_map, rendered, cache, "another network"))


def test_objects_of_a_photograph_that_was_seen_are_kept_where_others_are_added(
    finder: ObjectSearch,
    rendered: Scene,
    few: SparseMap,
    seen_few: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fewer = replace(few, images={name: few.images[name] for name in few.names[2:]})
    finder.prepare(source_of(finder, fewer, rendered, tmp_path))
    asked: list[int] = []
    found = MapExtractor.__call__

    def count_calls(of: MapExtractor, *args: Any) -> Any:
        asked.append(1)
        return found(of, *args)

    monkeypatch.setattr(MapExtractor, "__call__", count_calls)
    source = source_of(finder, few, rendered, tmp_path)
    load_references(source, 64, finder.observer(source))
    assert len(asked) == len(few.names)  # the references needed all, the objects two of them
    finder.prepare(source)
    assert len(asked) == len(few.names)
    (one,) = seen_few.glob("objects-*.h5")
    kept, fresh = landmarks_in(tmp_path / one.name), landmarks_in(one)
    np.testing.assert_array_equal(kept.xyz, fresh.xyz)
    np.testing.assert_array_equal(kept.vectors, fresh.vectors)


def test_a_map_seen_along_the_ground_has_no_objects(
    finder: ObjectSearch, rendered: Scene, tmp_path: Path
) -> None:
    up = np.eye(4)
    up[:3, :3] = so3_exp(torch.tensor([math.pi / 2, 0.0, 0.0]).double()).numpy()
    sparse_map = rendered.sparse_map()
    images = {
        name: replace(image, cam_from_world=up @ image.cam_from_world)
        for name, image in sparse_map.images.items()
    }
    flat = replace(sparse_map, images=images)
    finder.prepare(source_of(finder, flat, rendered, tmp_path))
    assert len(landmarks_in(next(tmp_path.glob("objects-*.h5")))) == 0
    camera = flat.images[flat.names[0]].camera
    image = np.zeros((camera.height, camera.width, 3), np.uint8)
    assert finder.find(Query("query", image, camera, None)) == []


def test_landmarks_lie_where_objects_are(rendered: Scene, seen: Path) -> None:
    landmarks = landmarks_in(next(seen.glob("objects-*.h5")))
    true = np.array([item.centre for item in rendered.objects.objects])[:, :2]
    found = landmarks.xyz[:, :2].astype(np.float64)
    anywhere = np.random.default_rng(0).uniform(found.min(0), found.max(0), (2000, 2))

    def near(some: NDArray[np.float64], others: NDArray[np.float64]) -> float:
        away = np.linalg.norm(some[:, None] - others[None], axis=-1).min(1)
        return float(np.mean(away < 2.0))

    assert near(true, found) > 0.6
    assert near(found, true) > 4 * near(anywhere, true)


def test_the_place_of_a_query_is_among_those_found(
    finder: ObjectSearch, rendered: Scene, seen: Path
) -> None:
    """In the map's own season, told nothing."""
    (dataset,) = open_datasets(rendered.path)
    finder.prepare(source_of(finder, rendered.sparse_map(), rendered, seen))
    right = []
    for query in dataset.queries:
        if "summer" in query.name:
            places = finder.find(query.load())
            assert [p.score for p in places] == sorted((p.score for p in places), reverse=True)
            apart = [p.pose.error_to(query.reference) for p in places]
            right.append(any(float(metres) < 8 and float(deg) < 10 for metres, deg in apart))
    assert len(right) == 4
    assert sum(right) >= 3


def test_objects_are_switched_off_by_name() -> None:
    with_objects = ObjConnectLocalizer(ObjConnectConfig())
    without = ObjConnectLocalizer(ObjConnectConfig(objects=None))
    assert with_objects._extra_finder is not None
    assert without._extra_finder is None


@pytest.mark.parametrize(
    ("most", "asked"), [pytest.param(5000, True, marks=pytest.mark.thorough), (0, False)]
)
def test_in_large_maps_the_search_is_asked_first(
    rendered: Scene, cache: Path, most: int, asked: bool
) -> None:
    """Of a query that the search finds by itself."""
    options = ObjectSearchOptions(most_landmarks=most)
    localizer = ObjConnectLocalizer(ObjConnectConfig(objects=options, matches=None))
    (dataset,) = open_datasets(rendered.path)
    localizer.prepare(dataset.load_map(), dataset.images, cache)
    other = localizer._extra_finder
    assert isinstance(other, ObjectSearch)
    assert other.is_first is asked
    calls: list[str] = []
    find = other.find
    other.find = lambda query: calls.append(query.name) or find(query)  # type: ignore[method-assign, func-returns-value]
    query = next(query for query in dataset.queries if "summer" in query.name)
    assert localizer.localize(query.load()).status is Status.OK
    assert calls == ([query.name] if asked else [])


@pytest.mark.parametrize(
    ("away", "sigma", "allowed"),
    [
        pytest.param(None, 0.0, True, marks=pytest.mark.thorough),
        (50.0, 29.0, True),
        (50.0, 5.0, False),
    ],
)
def test_objects_are_asked_where_the_search_fails(
    rendered: Scene,
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    away: float | None,
    sigma: float,
    allowed: bool,
) -> None:
    """Their places count as far as the position that is told, if any, allows them."""
    options = ObjectSearchOptions(most_landmarks=0)
    localizer = ObjConnectLocalizer(ObjConnectConfig(objects=options, matches=None))
    (dataset,) = open_datasets(rendered.path)
    localizer.prepare(dataset.load_map(), dataset.images, cache)
    monkeypatch.setattr(GlobalSearch, "_find_candidates", lambda *_: [])
    query = next(query for query in dataset.queries if "summer" in query.name)
    calls: list[str] = []
    other = localizer._extra_finder
    assert isinstance(other, ObjectSearch)
    there = Candidate(query.reference, 1.0)
    monkeypatch.setattr(other, "find", lambda query: calls.append(query.name) or [there])
    told = None
    if away is not None:
        told = Prior(query.reference.centre().numpy() + np.array([away, 0, 0]), np.full(3, sigma))
    estimate = localizer.localize(query.load(told))
    assert calls == [query.name]
    near = estimate.cam_from_world is not None and float(
        estimate.cam_from_world.error_to(query.reference)[0]
    )
    assert (estimate.status is Status.OK and near < 1) is allowed
