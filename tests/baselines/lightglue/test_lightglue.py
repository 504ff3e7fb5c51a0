"""ALIKED and DISK with LightGlue, with their authors' weights, on small photographs."""

from __future__ import annotations

import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from typer.testing import CliRunner

from baselines import lightglue
from baselines.lightglue.config import AlikedLightGlueConfig, DiskLightGlueConfig
from baselines.lightglue.extraction import Aliked, Disk, KorniaExtractor
from baselines.lightglue.known_files import KNOWN_FILES, require_network
from baselines.lightglue.localizer import LightGlueMatcher
from benchmark.cli import app
from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import GATE_SCENES
from objconnect.localization.matching.matcher import Keypoints
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.methods import create
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import north_angle
from objconnect.scene.localizer import Localizer, Prior, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.images import read_rgb
from tests.baselines.lightglue.weights import LIGHTGLUE, find_weights, options_of

(DATASET,) = open_datasets(GATE_SCENES["gate"])
WHOLE = DATASET.load_map()
PHOTOGRAPHS = 3


def few_photographs() -> SparseMap:
    """Those around one that flies another way than north."""
    turns = [abs(north_angle(WHOLE.images[name].cam_from_world[:3, :3])) for name in WHOLE.names]
    turned = int(np.argmax(turns))
    assert turns[turned] > 0.5
    near = np.linalg.norm(WHOLE.centres - WHOLE.centres[turned], axis=1).argsort()[:PHOTOGRAPHS]
    return replace(WHOLE, images={WHOLE.names[row]: WHOLE.images[WHOLE.names[row]] for row in near})


MAP = few_photographs()
(TURNED, *_) = MAP.images.values()


def again() -> Query:
    """The photograph of the map that flies another way than north, as a query."""
    rgb = read_rgb(DATASET.images / TURNED.name, TURNED.camera)
    prior = Prior(TURNED.centre, np.full(3, 3.0), TURNED.cam_from_world[:3, :3], 5.0)
    return Query("again", rgb, TURNED.camera, prior)


QUERY = again()


@pytest.fixture(scope="module", params=LIGHTGLUE)
def localizer(request: pytest.FixtureRequest, cache: Path) -> StructureLocalizer:
    made = create(request.param, options_of(request.param))
    assert isinstance(made, StructureLocalizer)
    made.prepare(MAP, DATASET.images, cache)
    return made


@pytest.fixture(scope="module")
def extractor(localizer: StructureLocalizer) -> KorniaExtractor:
    assert isinstance(localizer._extractor, KorniaExtractor)
    return localizer._extractor


# ALIKED alone in the default part, where both have the code that is tested in common.
QUICK_ALONE = pytest.mark.parametrize(
    "localizer",
    [
        name if name == "aliked+lightglue" else pytest.param(name, marks=pytest.mark.thorough)
        for name in LIGHTGLUE
    ],
    indirect=True,
)


def test_a_photograph_of_the_map_is_known_again(localizer: Localizer) -> None:
    estimate = localizer.localize(QUERY)
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(TURNED.pose)
    assert metres < 0.3
    assert degrees < 0.3
    assert estimate.covariance is not None
    assert set(estimate.seconds) == {"features", "retrieval", "matching", "pose"}


@QUICK_ALONE
def test_a_query_is_turned_where_its_heading_is_unknown(localizer: Localizer) -> None:
    """Its picture on its side, and nobody knows; no photograph of the map has this heading."""
    rgb = np.ascontiguousarray(np.rot90(QUERY.image, 1))
    wide, high = QUERY.camera.width, QUERY.camera.height
    assert QUERY.camera.model == "OPENCV"
    fx, fy, cx, cy, k1, k2, *_ = QUERY.camera.params
    camera = Camera("OPENCV", high, wide, (fy, fx, cy, wide - cx, k1, k2, 0.0, 0.0))
    estimate = localizer.localize(Query("aside", rgb, camera))
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    away = estimate.cam_from_world.centre() - TURNED.pose.centre()
    assert float(away.norm()) < 0.5


@QUICK_ALONE
def test_answers_repeat(localizer: StructureLocalizer, cache: Path) -> None:
    other = create(localizer.name, localizer.config.model_dump())
    other.prepare(MAP, DATASET.images, cache)
    first, second = (each.localize(QUERY) for each in (localizer, other))
    assert first.cam_from_world is not None
    assert second.cam_from_world is not None
    assert torch.equal(first.cam_from_world.matrix(), second.cam_from_world.matrix())
    assert other.weights_sha256 == localizer.weights_sha256


@QUICK_ALONE
def test_what_cannot_be_localized_has_a_reason(localizer: Localizer) -> None:
    noise = np.random.default_rng(0).integers(0, 256, QUERY.image.shape, dtype=np.uint8)
    for image in (np.zeros_like(QUERY.image), noise):
        estimate = localizer.localize(replace(QUERY, image=image))
        assert estimate.status is Status.FAILED
        assert estimate.cam_from_world is None
        assert re.search(r"\d+ (of \d+ )?matches .*needed", estimate.reason)


def test_keypoints_are_pixels_of_the_photograph(extractor: KorniaExtractor) -> None:
    found = extractor.extract_warped(QUERY.image, QUERY.camera, 0.0)
    count = len(found.xy)
    assert 50 < count <= 256
    assert found.xy.dtype == np.float32
    assert found.descriptors.shape == (count, 128)
    np.testing.assert_allclose(
        np.linalg.norm(found.descriptors.astype(float), axis=1), 1, atol=0.01
    )


def test_the_first_pixel_s_centre_is_half_a_pixel_from_the_edge() -> None:
    """ALIKED finds the last pixel of a bright square; DISK's keypoints are whole pixels."""
    image = np.full(QUERY.image.shape, 77, np.uint8)
    image[60:100, 80:140] = 230
    square = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8), np.uint8)
    aliked = Aliked(AlikedLightGlueConfig(**options_of("aliked+lightglue")))
    found = aliked.extract_warped(square, QUERY.camera, 0.0)
    assert np.linalg.norm(found.xy - [139.5, 99.5], axis=1).min() < 0.3
    disk = Disk(DiskLightGlueConfig(**options_of("disk+lightglue")))
    found = disk.extract_warped(square, QUERY.camera, 0.0)
    assert len(found.xy)
    assert set((found.xy % 1).ravel().tolist()) == {0.5}


@QUICK_ALONE
def test_a_turned_picture_gives_pixels_of_the_photograph(extractor: KorniaExtractor) -> None:
    straight = extractor.extract_warped(QUERY.image, QUERY.camera, 0.0).xy
    turned = extractor.extract_warped(QUERY.image, QUERY.camera, 0.2, 1.1).xy
    away = np.linalg.norm(turned[:, None] - straight, axis=2).min(1)
    assert np.median(away) < 1.5
    size = np.array(QUERY.image.shape[1::-1])
    assert ((turned > 0) & (turned < size)).all()


@QUICK_ALONE
def test_the_strongest_keypoints_are_kept(extractor: KorniaExtractor) -> None:
    made = type(extractor)
    config = extractor._config.model_copy(update={"max_features": 100})
    some = made(config).extract_warped(QUERY.image, QUERY.camera, 0.0)
    assert len(some.xy) == 100
    every = extractor.extract_warped(QUERY.image, QUERY.camera, 0.0)
    assert {tuple(xy) for xy in some.xy} <= {tuple(xy) for xy in every.xy}


def keypoints(xy: NDArray[Any], descriptors: NDArray[Any]) -> Keypoints:
    return Keypoints(xy.astype(np.float32), (64.0, 64.0), descriptors.astype(np.float16))


def test_lightglue_pairs_equal_keypoints(extractor: KorniaExtractor) -> None:
    found = extractor.extract_warped(QUERY.image, QUERY.camera, 0.0)
    middle = np.array(QUERY.image.shape[1::-1]) / 2
    own = keypoints(found.xy - middle, found.descriptors)
    backwards = keypoints((found.xy - middle)[::-1], found.descriptors[::-1])
    nothing = keypoints(np.zeros((0, 2)), np.zeros((0, 128)))
    one = keypoints(np.zeros((1, 2)), found.descriptors[:1])
    pairs, none, single = LightGlueMatcher(extractor)(own, [backwards, nothing, one])
    assert len(pairs) > 0.8 * len(found.xy)
    assert (pairs.sum(1) == len(found.xy) - 1).mean() > 0.98
    assert none.shape == (0, 2)
    assert len(single) <= 1
    assert LightGlueMatcher(extractor)(nothing, [own])[0].shape == (0, 2)


def test_few_pairs_are_sure() -> None:
    counts = []
    for confidence in (0.0, 0.5, 0.95):
        options = options_of("aliked+lightglue", min_confidence=confidence)
        extractor = Aliked(AlikedLightGlueConfig(**options))
        found = extractor.extract_warped(QUERY.image, QUERY.camera, 0.0)
        blurred = np.asarray(QUERY.image // 2 + 60, np.uint8)
        other = extractor.extract_warped(blurred, QUERY.camera, 0.3)
        middle = np.array(QUERY.image.shape[1::-1]) / 2
        both = [keypoints(each.xy - middle, each.descriptors) for each in (found, other)]
        counts.append(len(LightGlueMatcher(extractor)(both[0], both[1:])[0]))
    assert counts[0] > counts[1] > counts[2]


@pytest.mark.parametrize("method", LIGHTGLUE)
def test_without_kornia_the_extra_is_named(
    method: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "kornia", None)
    monkeypatch.setitem(sys.modules, "kornia.feature", None)
    localizer = create(method, {})
    with pytest.raises(InputError, match=r"kornia.*pip install 'objconnect\[kornia\]'") as caught:
        localizer.prepare(MAP, DATASET.images)
    assert "\n" not in str(caught.value)
    answer = CliRunner().invoke(app, ["options", method])
    assert answer.exit_code == 0
    assert "min_confidence=0.1" in answer.output


def test_without_a_network_the_files_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    find_weights("aliked-n16.pth")
    import kornia.feature

    def refuse(*_: object, **__: object) -> None:
        raise OSError("no route to host\nand more")

    monkeypatch.setattr(kornia.feature, "LightGlue", refuse)
    for method in LIGHTGLUE:
        with pytest.raises(InputError) as caught:
            create(method, {}).prepare(MAP, DATASET.images)
        said = str(caught.value)
        assert "cannot download" in said
        assert "no route to host" in said
        assert "matcher_weights=FILE" in said
        assert "\n" not in said


def test_weights_of_other_networks_are_refused(tmp_path: Path) -> None:
    aliked, disk = find_weights("aliked-n16.pth"), find_weights("disk-depth-save.pth")
    matcher = find_weights("aliked_lightglue.pth")
    cut = tmp_path / "cut.pth"
    cut.write_bytes(aliked.read_bytes()[:5000])
    unknown = tmp_path / "unknown.pth"
    torch.save(torch.load(disk, map_location="cpu", weights_only=True), unknown)
    wrong: list[tuple[str, dict[str, Path]]] = [
        ("lacks block1", {"weights": unknown, "matcher_weights": matcher}),
        ("of ALIKED aliked-n16, .*LightGlue", {"weights": aliked, "matcher_weights": aliked}),
        ("cannot be read", {"weights": cut, "matcher_weights": matcher}),
    ]
    for words, files in wrong:
        with pytest.raises(InputError, match=words) as caught:
            create("aliked+lightglue", dict(files)).prepare(MAP, DATASET.images)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="absent.pth"):
        create("disk+lightglue", {"weights": tmp_path / "absent.pth"})


def test_a_known_file_of_an_equal_network_is_refused(tmp_path: Path) -> None:
    """Their tensors have the names and shapes of those that are needed."""
    rotated, disk = tmp_path / "mine.pth", find_weights("disk_lightglue.pth")
    shutil.copy(find_weights("aliked-n16rot.pth"), rotated)
    options = options_of("aliked+lightglue", weights=rotated)
    words = r"mine.pth holds .* ALIKED aliked-n16rot, those of ALIKED aliked-n16 are needed$"
    with pytest.raises(InputError, match=words):
        _ = Aliked(AlikedLightGlueConfig(**options)).networks
    config = AlikedLightGlueConfig(**(options | {"extractor": "aliked-n16rot"}))
    assert len(Aliked(config).networks) == 2
    options = options_of("aliked+lightglue", matcher_weights=disk)
    with pytest.raises(InputError, match=r"of LightGlue disk, those of LightGlue aliked are"):
        _ = Aliked(AlikedLightGlueConfig(**options)).networks


def test_files_are_known_by_their_digests() -> None:
    for known in KNOWN_FILES:
        require_network(Path(known.name), known.sha256, known.network)
        with pytest.raises(InputError, match=known.name):
            require_network(Path(known.name), known.sha256, "another")
        require_network(Path(known.name), "0" * 64, "another")


def test_the_card_lists_the_known_files() -> None:
    card = (Path(lightglue.__file__).parent / "lightglue.md").read_text()
    rows = re.findall(r"^\| (\S+\.pth), .*\| ([0-9a-f]{64}) \|$", card, re.MULTILINE)
    assert rows == [(known.name, known.sha256) for known in KNOWN_FILES]


def test_weights_of_the_first_release_are_read(tmp_path: Path) -> None:
    """Those for DISK are: they number the layers after the block."""
    path = find_weights("disk_lightglue.pth")
    tensors = torch.load(path, map_location="cpu", weights_only=True)
    old = {name for name in tensors if name.startswith(("self_attn.", "cross_attn."))}
    assert old
    new = {}
    for name, value in tensors.items():
        block, layer, rest = (*name.split(".", 2), "")[:3]
        new[f"transformers.{layer}.{block}.{rest}" if name in old else name] = value
    torch.save(new, tmp_path / "new.pth")
    digests = []
    for file in (path, tmp_path / "new.pth"):
        options = options_of("disk+lightglue", matcher_weights=file)
        digests.append(Disk(DiskLightGlueConfig(**options)).weights_sha256)
    assert digests[0] == digests[1]


def test_a_change_of_weights_changes_the_digest(tmp_path: Path) -> None:
    first = Aliked(AlikedLightGlueConfig(**options_of("aliked+lightglue")))
    tensors = torch.load(find_weights("aliked-n16.pth"), map_location="cpu", weights_only=True)
    next(iter(tensors.values())).flatten()[0] += 1
    torch.save(tensors, tmp_path / "own.pth")
    options = options_of("aliked+lightglue", weights=tmp_path / "own.pth")
    assert Aliked(AlikedLightGlueConfig(**options)).weights_sha256 != first.weights_sha256


# Queries in snow found within 5 m of ten, told the pose to 3 m and 5 degrees; `sift` finds none.
FOUND_IN_SNOW = {"aliked+lightglue": 7, "disk+lightglue": 5}


@pytest.mark.thorough
@pytest.mark.parametrize("method", LIGHTGLUE)
def test_queries_in_snow_are_found_in_a_map_of_the_summer(method: str, tmp_path: Path) -> None:
    (snow,) = open_datasets(GATE_SCENES["gate-snow"])
    queries = [query for query in snow.queries if "snow" in query.name][-10:]
    assert len(queries) == 10
    localizer = create(method, options_of(method, max_features=1024))
    localizer.prepare(snow.load_map(), snow.images, tmp_path)
    metres = []
    for query in queries:
        estimate = localizer.localize(query.load(query.prior))
        if estimate.cam_from_world is not None:
            metres.append(float(estimate.cam_from_world.error_to(query.reference)[0]))
    assert sum(away < 5 for away in metres) >= FOUND_IN_SNOW[method], metres
