from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import objconnect.scene.colmap.sift
from baselines.sift import SiftConfig, SiftLocalizer
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Prior, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.images import read_rgb

pytestmark = pytest.mark.usefixtures("extracted_once")

CONFIG = SiftConfig(max_features=2000)


@dataclass(frozen=True)
class Flight:
    """The hard split of a real flight, and a localizer prepared on it."""

    sparse_map: SparseMap
    images: Path
    queries: tuple[Query, ...]
    truth: dict[str, Pose]
    localizer: SiftLocalizer
    cache: Path


@pytest.fixture(scope="module")
def flight(beach: Path, tmp_path_factory: pytest.TempPathFactory) -> Flight:
    with (beach / "gps.csv").open() as stream:
        gps = {
            row["name"]: np.array([float(row[k]) for k in "enu"]) for row in csv.DictReader(stream)
        }
    queries = []
    for line in (beach / "queries_sparse.txt").read_text().splitlines():
        name, *words = line.split()
        camera = Camera.parse(words)
        image = read_rgb(beach / "images" / name, camera)
        queries.append(Query(name, image, camera, Prior(gps[name], np.full(3, 2.0))))
    truth = {}
    for line in (beach / "reference_poses_sparse.txt").read_text().splitlines():
        if not line.startswith("#"):
            name, *numbers = line.split()
            values = [float(n) for n in numbers]
            truth[name] = Pose.from_quaternion(values[:4], values[4:])
    sparse_map = read_model(beach / "sparse" / "map_sparse")
    cache = tmp_path_factory.mktemp("cache")
    localizer = SiftLocalizer(CONFIG)
    localizer.prepare(sparse_map, beach / "images", cache)
    return Flight(sparse_map, beach / "images", tuple(queries), truth, localizer, cache)


def without_prior(query: Query) -> Query:
    return Query(query.name, query.image, query.camera)


def assert_found(estimate: Estimate, truth: Pose) -> None:
    """Right, and honest about how far off it may be."""
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(truth)
    assert metres < 5
    assert degrees < 10
    sigma = estimate.sigma_position()
    assert sigma is not None
    assert 0.001 < sigma < 1
    assert estimate.inliers >= CONFIG.min_inliers
    assert set(estimate.seconds) == {"features", "retrieval", "matching", "pose"}


@pytest.mark.parametrize("prior", [True, False], ids=["with_prior", "without_prior"])
def test_every_query_of_a_real_flight_is_localized(flight: Flight, prior: bool) -> None:
    assert len(flight.queries) == 4
    for query in flight.queries:
        estimate = flight.localizer.localize(query if prior else without_prior(query))
        assert_found(estimate, flight.truth[query.name])


def test_a_cached_preparation_extracts_nothing_and_answers_the_same(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        pytest.fail("the features are in the cache")

    monkeypatch.setattr(objconnect.scene.colmap.sift, "extract_sift", refuse)
    again = SiftLocalizer(CONFIG)
    again.prepare(flight.sparse_map, flight.images, flight.cache)
    first = flight.localizer.localize(flight.queries[0])
    second = again.localize(flight.queries[0])
    assert first.cam_from_world is not None
    assert second.cam_from_world is not None
    metres, degrees = first.cam_from_world.error_to(second.cam_from_world)
    assert metres == 0
    assert degrees < 1e-9
    assert first.inliers == second.inliers


def test_another_configuration_does_not_use_the_cache(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    class ExtractedError(Exception):
        pass

    def notice(*_: Any, **__: Any) -> None:
        raise ExtractedError

    monkeypatch.setattr(objconnect.scene.colmap.sift, "extract_sift", notice)
    other = SiftLocalizer(SiftConfig(max_features=1999))
    with pytest.raises(ExtractedError):
        other.prepare(flight.sparse_map, flight.images, flight.cache)


@pytest.mark.parametrize("prior", [True, False], ids=["with_prior", "without_prior"])
def test_a_blank_query_is_an_answer_not_an_exception(flight: Flight, prior: bool) -> None:
    query = flight.queries[0]
    blank = Query("blank", np.full_like(query.image, 128), query.camera, query.prior)
    estimate = flight.localizer.localize(blank if prior else without_prior(blank))
    assert estimate.status is Status.FAILED
    assert estimate.cam_from_world is None
    assert estimate.reason == "0 matches to the map, 4 are needed"


def test_a_photograph_of_elsewhere_fails_with_a_reason(flight: Flight) -> None:
    query = flight.queries[0]
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, query.image.shape, dtype=np.uint8)
    estimate = flight.localizer.localize(Query("noise", noise, query.camera))
    assert estimate.status is Status.FAILED
    assert "needed" in estimate.reason


def small_map(flight: Flight) -> SparseMap:
    """Two photographs of the map, to be quick."""
    two = {name: flight.sparse_map.images[name] for name in flight.sparse_map.names[:2]}
    return replace(flight.sparse_map, images=two)


def copy_over(flight: Flight, folder: Path) -> Path:
    for name in small_map(flight).names:
        shutil.copy(flight.images / name, folder)
    return folder


def expect_error(flight: Flight, images: Path) -> str:
    with pytest.raises(InputError) as caught:
        SiftLocalizer(CONFIG).prepare(small_map(flight), images)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_missing_photograph_of_the_map_is_named(flight: Flight, tmp_path: Path) -> None:
    name = flight.sparse_map.names[1]
    (copy_over(flight, tmp_path) / name).unlink()
    message = expect_error(flight, tmp_path)
    assert name in message
    assert "does not exist" in message


def test_a_broken_photograph_of_the_map_is_named(flight: Flight, tmp_path: Path) -> None:
    name = flight.sparse_map.names[1]
    (copy_over(flight, tmp_path) / name).write_bytes(b"not a photograph")
    assert name in expect_error(flight, tmp_path)


def test_photographs_of_another_place_are_noticed(flight: Flight, tmp_path: Path) -> None:
    """No keypoint of a blank picture lies where the map has a point."""
    for name in small_map(flight).names:
        blank: NDArray[np.uint8] = np.full((576, 1024, 3), 128, np.uint8)
        Image.fromarray(blank).save(tmp_path / name)
    assert "no keypoint" in expect_error(flight, tmp_path)


def test_a_truncated_photograph_of_the_map_is_named(flight: Flight, tmp_path: Path) -> None:
    """COLMAP itself would take the half it can decode."""
    path = copy_over(flight, tmp_path) / flight.sparse_map.names[1]
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert f"{path} is damaged" in expect_error(flight, tmp_path)


def test_a_resized_photograph_of_the_map_is_named(flight: Flight, tmp_path: Path) -> None:
    path = copy_over(flight, tmp_path) / flight.sparse_map.names[1]
    path.chmod(0o644)
    with Image.open(path) as image:
        image.resize((512, 288)).save(path)
    assert "is 512 x 288 pixels but its camera is 1024 x 576" in expect_error(flight, tmp_path)
