"""The pipeline with weights that were never trained: they know a photograph again, and no more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from baselines.d2net.localizer import D2NetConfig, D2NetExtractor, D2NetLocalizer
from baselines.d2net.network import read_network
from benchmark.gate.scene import GATE_SCENES
from objconnect.methods import create
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.views import north_angle
from objconnect.scene.localizer import Prior, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.images import read_rgb
from tests.baselines.d2net.untrained import create_untrained

GATE = GATE_SCENES["gate"]
IMAGES = GATE / "images"


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return create_untrained(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="module")
def sparse_map() -> SparseMap:
    whole = read_model(GATE / "sparse" / "map")
    return replace(whole, images={name: whole.images[name] for name in whole.names[:6]})


@pytest.fixture(scope="module")
def localizer(weights: Path, sparse_map: SparseMap, cache: Path) -> D2NetLocalizer:
    made = D2NetLocalizer(D2NetConfig(weights=weights))
    made.prepare(sparse_map, IMAGES, cache)
    return made


def again(sparse_map: SparseMap, row: int = 2) -> Query:
    """A photograph of the map as a query."""
    image = sparse_map.images[sparse_map.names[row]]
    rgb = read_rgb(IMAGES / image.name, image.camera)
    prior = Prior(image.centre, np.full(3, 3.0), image.cam_from_world[:3, :3])
    return Query("again", rgb, image.camera, prior)


def test_a_photograph_of_the_map_is_known_again(
    localizer: D2NetLocalizer, sparse_map: SparseMap
) -> None:
    estimate = localizer.localize(again(sparse_map))
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(sparse_map.images[sparse_map.names[2]].pose)
    assert metres < 0.5
    assert degrees < 0.5
    assert set(estimate.seconds) == {"features", "retrieval", "matching", "pose"}


def test_headings_of_the_map_are_tried_where_attitude_is_unknown(
    localizer: D2NetLocalizer, sparse_map: SparseMap
) -> None:
    """A photograph that was flown otherwise than north, and nobody knows."""
    poses = [sparse_map.images[name].cam_from_world for name in sparse_map.names]
    row = int(np.argmax([abs(north_angle(pose[:3, :3])) for pose in poses]))
    assert abs(north_angle(poses[row][:3, :3])) > 0.5
    query = again(sparse_map, row)
    assert query.prior is not None
    position = query.prior.position - [0, 0, 200]
    blind = replace(query, prior=Prior(position, np.array([3.0, 3.0, 200.0])))
    estimate = localizer.localize(blind)
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(
        sparse_map.images[sparse_map.names[row]].pose
    )
    assert metres < 0.5
    assert degrees < 0.5


def test_a_cached_preparation_extracts_nothing(
    weights: Path, sparse_map: SparseMap, cache: Path, localizer: D2NetLocalizer
) -> None:
    other = D2NetLocalizer(D2NetConfig(weights=weights))

    def refuse(*_: Any) -> None:
        pytest.fail("the features are in the cache")

    other._extractor.extract_photographs = refuse  # type: ignore[method-assign,assignment]
    other.prepare(sparse_map, IMAGES, cache)
    first, second = (x.localize(again(sparse_map)) for x in (localizer, other))
    assert first.inliers == second.inliers > 0


def test_what_cannot_be_localized_has_a_reason(
    localizer: D2NetLocalizer, sparse_map: SparseMap
) -> None:
    query = again(sparse_map)
    noise = np.random.default_rng(0).integers(0, 256, query.image.shape, dtype=np.uint8)
    broken: dict[str, Query] = {
        "matches": replace(query, image=np.full_like(query.image, 128)),
        "agree": replace(query, image=noise),
        "not uint8": replace(query, image=np.full(query.image.shape, np.nan)),  # type: ignore[arg-type]
        "not finite": replace(query, prior=Prior(np.full(3, np.nan))),
    }
    for words, wrong in broken.items():
        estimate = localizer.localize(wrong)
        assert estimate.status is Status.FAILED
        assert estimate.cam_from_world is None
        assert words in estimate.reason


def test_a_map_with_one_point_localizes_nothing(weights: Path, sparse_map: SparseMap) -> None:
    images = {
        name: replace(image, xy=image.xy[:1], point_rows=np.zeros(1, np.int64))
        for name, image in list(sparse_map.images.items())[:2]
    }
    poor = replace(
        sparse_map,
        images=images,
        xyz=sparse_map.xyz[:1],
        rgb=sparse_map.rgb[:1],
        error=sparse_map.error[:1],
        track_length=sparse_map.track_length[:1],
    )
    made = D2NetLocalizer(D2NetConfig(weights=weights))
    made.prepare(poor, IMAGES)
    estimate = made.localize(again(sparse_map))
    assert estimate.status is Status.FAILED
    assert estimate.reason == "0 matches to the map, 4 are needed"


def test_keypoints_of_a_large_picture_are_in_its_own_pixels(weights: Path) -> None:
    """Made small again, a picture of large squares is the small picture."""
    network, digest = read_network(weights)
    small = read_rgb(IMAGES / "map/images/000000.jpg")
    large = small.repeat(3, 0).repeat(3, 1)
    extract = D2NetExtractor(network, digest, D2NetConfig(max_edge=256))
    here, there = extract(small), extract(large)
    np.testing.assert_allclose(there.xy, 3 * here.xy, atol=1e-3)
    np.testing.assert_allclose(there.scale, 3 * here.scale)
    assert there.descriptors.dtype == np.float16


def test_no_level_is_larger_than_the_largest_image(weights: Path) -> None:
    network, digest = read_network(weights)
    rgb = read_rgb(IMAGES / "map/images/000000.jpg")
    assert max(rgb.shape) == 256
    bounded = D2NetExtractor(network, digest, D2NetConfig(scales=(1.0, 2.0), max_edge=256))(rgb)
    halved = D2NetExtractor(network, digest, D2NetConfig(scales=(0.5, 1.0)))(rgb)
    np.testing.assert_array_equal(bounded.xy, halved.xy)


def test_the_strongest_keypoints_are_kept(weights: Path) -> None:
    network, digest = read_network(weights)
    rgb = read_rgb(IMAGES / "map/images/000000.jpg")
    every = D2NetExtractor(network, digest, D2NetConfig())(rgb)
    some = D2NetExtractor(network, digest, D2NetConfig(max_features=100))(rgb)
    assert len(every.xy) > len(some.xy) == 100
    np.testing.assert_array_equal(some.xy, every.xy[:100])


def test_a_mirrored_view_is_no_copy(weights: Path) -> None:
    """Views of arrays that go backwards are pictures too."""
    network, digest = read_network(weights)
    extract = D2NetExtractor(network, digest, D2NetConfig())
    rgb = read_rgb(IMAGES / "map/images/000000.jpg")
    np.testing.assert_array_equal(extract(rgb[:, ::-1]).xy, extract(cv2.flip(rgb, 1)).xy)


def test_without_weights_it_says_where_they_come_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("baselines.d2net.localizer.SHIPPED", tmp_path / "d2net.safetensors")
    with pytest.raises(InputError, match="train d2net") as caught:
        create("d2net", {})
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no weights at"):
        create("d2net", {"weights": tmp_path / "none.pth"})


@pytest.mark.parametrize("scales", [(), (1, 0.5), (1, 1), (-1,)])
def test_scales_become_larger(scales: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="scales"):
        create("d2net", {"scales": scales})
