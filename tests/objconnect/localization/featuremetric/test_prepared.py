"""The map's features, which are not computed before a query needs them."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.prepared import MapState
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.localization.pipeline.localization_map import open_map
from objconnect.localization.pipeline.localize import localize
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.methods import create
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError, PreparationError
from objconnect.scene.localizer import (
    Estimate,
    PoseSource,
    PreparesLazily,
    Prior,
    Query,
    Status,
    prepare_lazily,
)
from tests.baselines.pixloc.made_map import write_map

pytestmark = pytest.mark.usefixtures("extracted_once")

# Twelve inliers are an answer: that a query needs no alignment is what counts here.
OPTIONS: dict[str, Any] = {"search": {"matched_answer_inliers": 12}}


@pytest.fixture(scope="module")
def hamlet(rendered: Scene) -> Dataset:
    (dataset,) = open_datasets(rendered.path)
    return dataset


@pytest.fixture(scope="module")
def first(hamlet: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cache of a method that has prepared what comes first."""
    cache = tmp_path_factory.mktemp("first")
    method = create("objconnect", OPTIONS)
    assert isinstance(method, PreparesLazily)
    prepare_lazily(method, hamlet.load_map(), hamlet.images, cache)
    return cache


@pytest.fixture
def left(hamlet: Dataset, first: Path, tmp_path: Path) -> FeaturemetricLocalizer:
    """A method that has prepared what comes first."""
    shutil.copytree(first, tmp_path / "cache")
    method = create("objconnect", OPTIONS)
    assert isinstance(method, FeaturemetricLocalizer)
    prepare_lazily(method, hamlet.load_map(), hamlet.images, tmp_path / "cache")
    return method


def load_without_prior(hamlet: Dataset) -> Query:
    return next(query for query in hamlet.queries if "summer" in query.name).load()


def load_with_prior(hamlet: Dataset) -> Query:
    query = next(query for query in hamlet.queries if "summer" in query.name)
    pose = query.reference
    prior = Prior(pose.centre().numpy() + 0.3, np.full(3, 1.0), pose.rotation.numpy(), 1.0)
    return query.load(prior)


def list_kinds(folder: Path) -> set[str]:
    """The kinds of the files in a cache."""
    return {path.name.rpartition("-")[0] for path in folder.iterdir()}


def same(one: Estimate, other: Estimate) -> bool:
    """Whether two answers are one, bit by bit, but for the time they took."""
    assert one.cam_from_world is not None and other.cam_from_world is not None
    poses = [each.cam_from_world.matrix() for each in (one, other) if each.cam_from_world]
    alike = [
        (each.status, each.by, each.inliers, each.iterations, str(each.covariance))
        for each in (one, other)
    ]
    return bool((poses[0] == poses[1]).all()) and alike[0] == alike[1]


def test_matches_need_no_features_of_the_network(
    hamlet: Dataset, left: FeaturemetricLocalizer, tmp_path: Path
) -> None:
    found = left.localize(load_without_prior(hamlet))
    assert (found.status, found.by) == (Status.OK, PoseSource.MATCHES)
    assert set(found.seconds) == {"matches"}
    assert list_kinds(tmp_path / "cache") == {"sift-points"}


def test_the_first_query_that_needs_them_says_how_long_they_took(
    hamlet: Dataset, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where other tests have left them in the cache."""
    left = create("objconnect", OPTIONS)
    assert isinstance(left, FeaturemetricLocalizer)
    prepare_lazily(left, hamlet.load_map(), hamlet.images, cache)
    now, prepare = 0.0, left._preparation._prepare

    def take_an_hour() -> MapState:
        nonlocal now
        now += 3600
        return prepare()

    monkeypatch.setattr(left._preparation, "_prepare", take_an_hour)
    monkeypatch.setattr("objconnect.scene.localizer.perf_counter", lambda: now)
    first, second = (left.localize(load_with_prior(hamlet)) for _ in range(2))
    assert "retrieval" in first.seconds
    assert {stage: s for stage, s in first.seconds.items() if s} == {"preparation": 3600}
    assert "preparation" not in second.seconds
    assert (first.status, first.by) == (Status.OK, PoseSource.ALIGNMENT) and same(first, second)


@pytest.mark.thorough
def test_answers_and_files_are_those_of_a_map_prepared_at_once(
    hamlet: Dataset, left: FeaturemetricLocalizer, tmp_path: Path
) -> None:
    left.localize(load_with_prior(hamlet))
    whole = create("objconnect", OPTIONS)
    whole.prepare(hamlet.load_map(), hamlet.images, tmp_path / "whole")
    assert {path.name for path in (tmp_path / "whole").iterdir()} == {
        path.name for path in (tmp_path / "cache").iterdir()
    }
    assert {"objconnect", "mosaic", "objects", "sift-points"} <= list_kinds(tmp_path / "cache")
    for query in (load_with_prior(hamlet), load_without_prior(hamlet)):
        answer = whole.localize(query)
        assert same(answer, left.localize(query)) and "preparation" not in answer.seconds


def test_what_goes_wrong_then_is_no_failure_of_a_query(
    hamlet: Dataset, left: FeaturemetricLocalizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("no memory")

    monkeypatch.setattr("objconnect.localization.featuremetric.localizer.load_references", broken)
    with pytest.raises(PreparationError, match="could not be prepared: RuntimeError: no memory"):
        localize_safely(left, load_with_prior(hamlet))
    assert localize_safely(left, load_without_prior(hamlet)).status is Status.OK


def test_a_photograph_that_is_gone_by_then_is_named(
    rendered_copy: Path, first: Path, tmp_path: Path
) -> None:
    shutil.copytree(first, tmp_path / "cache")
    (dataset,) = open_datasets(rendered_copy)
    method, sparse_map = create("objconnect", OPTIONS), dataset.load_map()
    prepare_lazily(method, sparse_map, dataset.images, tmp_path / "cache")
    (dataset.images / sparse_map.names[0]).unlink()
    with pytest.raises(InputError, match=Path(sparse_map.names[0]).name):
        localize_safely(method, load_with_prior(dataset))


def test_without_matches_nothing_is_left(tmp_path: Path) -> None:
    images = tmp_path / "images"
    sparse_map = write_map(images)
    for method, more in (("pixloc", {}), ("objconnect", {"matches": None})):
        options = {"longest": 128, **more}
        localizer = create(method, options)
        prepare_lazily(localizer, sparse_map, images, tmp_path / method)
        assert method in list_kinds(tmp_path / method)
        assert isinstance(localizer, FeaturemetricLocalizer)
        assert localizer._preparation._done is not None


def test_a_method_that_leaves_nothing_is_prepared(hamlet: Dataset, tmp_path: Path) -> None:
    method = create("sift", {})
    prepare_lazily(method, hamlet.load_map(), hamlet.images, tmp_path)
    assert method.localize(load_without_prior(hamlet)).by is PoseSource.MATCHES


def test_the_command_leaves_them(rendered: Scene, hamlet: Dataset, tmp_path: Path) -> None:
    folder = tmp_path / "new"
    folder.mkdir()
    # Without EXIF, whose position would be a prior.
    Image.fromarray(load_without_prior(hamlet).image).save(folder / "a.jpg", quality=95)
    cache, out = tmp_path / "cache", tmp_path / "poses.txt"
    method = create("objconnect", OPTIONS)
    options = LocalizeOptions(cache=cache)
    (located,) = localize(open_map(rendered.path), folder, method, out, options)
    assert located.is_localized and located.estimate.by is PoseSource.MATCHES
    assert list_kinds(cache) == {"sift-points"}
    (row,) = csv.DictReader(out.with_suffix(".csv").open())
    assert row["by"] == "matches" and float(row["probability"]) > 0.99
