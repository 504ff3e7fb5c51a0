"""The example package that brings matchers of others, without them: vismatch is a stand-in with its
interface around OpenCV's SIFT, and the files of hloc are written here."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmark.datasets.open import open_datasets
from benchmark.gate.scene import GATE_SCENES
from objconnect.methods import create, method_names
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Estimate, Localizer, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "matchers"
(DATASET,) = open_datasets(GATE_SCENES["gate"])
TRUTH = DATASET.queries[3].reference
QUERY = DATASET.queries[3].load(DATASET.queries[3].prior)

Matches = dict[str, NDArray[Any]]
Matcher = Callable[[NDArray[np.float32], NDArray[np.float32]], Matches]


def few_photographs(count: int = 4) -> SparseMap:
    """Those around the query, to be quick."""
    sparse_map = DATASET.load_map()
    near = np.linalg.norm(sparse_map.centres - TRUTH.centre().numpy(), axis=1).argsort()[:count]
    names = [sparse_map.names[row] for row in sorted(near)]
    return replace(sparse_map, images={name: sparse_map.images[name] for name in names})


MAP = few_photographs()


def sift_matches(img0: NDArray[np.float32], img1: NDArray[np.float32]) -> Matches:
    """What vismatch returns: pixels (N, 2) of both pictures, the first one's centre at (0, 0)."""
    found = []
    for image in (img0, img1):
        assert image.dtype == np.float32
        assert image.shape[0] == 3
        assert 0 <= image.min() <= image.max() <= 1
        grey = cv2.cvtColor(np.uint8(255 * image.transpose(1, 2, 0)), cv2.COLOR_RGB2GRAY)
        found.append(cv2.SIFT_create().detectAndCompute(grey, None))
    (keypoints0, described0), (keypoints1, described1) = found
    pairs = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(described0, described1)
    pixels0 = np.array([keypoints0[pair.queryIdx].pt for pair in pairs], np.float32)
    pixels1 = np.array([keypoints1[pair.trainIdx].pt for pair in pairs], np.float32)
    return {"matched_kpts0": pixels0, "matched_kpts1": pixels1}


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The package stands where Python looks for installed ones, with its entry points."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    ((group, entries),) = project["entry-points"].items()
    folder = tmp_path / "site" / "matchers-0.1.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: matchers\nVersion: 0.1\n")
    lines = [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(folder.parent)
    monkeypatch.syspath_prepend(EXAMPLE)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "matchers"]:
        del sys.modules[name]


@pytest.fixture
def vismatch(monkeypatch: pytest.MonkeyPatch) -> Callable[[Matcher], list[dict[str, Any]]]:
    """Installs a stand-in of vismatch with one matcher; returns what it is asked for."""

    def install(matcher: Matcher) -> list[dict[str, Any]]:
        asked: list[dict[str, Any]] = []

        def get_matcher(name: str, device: str, max_num_keypoints: int) -> Matcher:
            asked.append({"name": name, "device": device, "most": max_num_keypoints})
            if name != "sift-nn":
                raise RuntimeError(f"Matcher {name} not yet supported.\nChoose another.")
            return matcher

        module = ModuleType("vismatch")
        module.get_matcher = get_matcher  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "vismatch", module)
        return asked

    return install


def ready(localizer: Localizer) -> Localizer:
    localizer.prepare(MAP, DATASET.images)
    return localizer


def metres_off(estimate: Estimate) -> float:
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    return float((estimate.cam_from_world.centre() - TRUTH.centre()).norm())


@pytest.mark.parametrize("prior", [True, False], ids=["with-prior", "without-prior"])
def test_matches_of_vismatch_give_the_pose(vismatch: Any, prior: bool) -> None:
    asked = vismatch(sift_matches)
    localizer = ready(create("vismatch", {"matcher": "sift-nn", "max_features": 900}))
    assert asked == [{"name": "sift-nn", "device": "cpu", "most": 900}]
    estimate = localizer.localize(QUERY if prior else replace(QUERY, prior=None))
    # `sift` itself is 0.12 m off with these four photographs of 256 px, from 50 m above.
    assert metres_off(estimate) < 0.4
    assert estimate.inliers >= 12


def test_resized_photographs_give_the_pose(vismatch: Any) -> None:
    vismatch(sift_matches)
    localizer = ready(create("vismatch", {"matcher": "sift-nn", "longest_px": 200}))
    assert metres_off(localizer.localize(QUERY)) < 0.5


def test_pixels_of_vismatch_count_from_the_centre_of_the_first(
    vismatch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A spot on a black photograph: its centre of mass is where the matcher finds it.
    height, width = QUERY.image.shape[:2]
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    spot = np.exp(-((x - 120.3) ** 2 + (y[:, None] - 90.8) ** 2) / (2 * 3.0**2))
    image = np.repeat(np.uint8(np.rint(255 * spot))[..., None], 3, axis=2)

    def finds(img0: NDArray[np.float32], img1: NDArray[np.float32]) -> Matches:
        rows, columns = np.indices(img0.shape[1:])
        centre = [np.average(axis, weights=img0[0]) for axis in (columns, rows)]
        all_over = np.stack(np.meshgrid(*[np.linspace(60, 140, 30)] * 2), -1).reshape(-1, 2)
        return {"matched_kpts0": np.tile(centre, (900, 1)), "matched_kpts1": all_over}

    vismatch(finds)
    localizer = ready(create("vismatch", {"matcher": "sift-nn"}))
    solved = []

    def solve(query: Query, xy: NDArray[np.float64], *rest: object) -> Estimate:
        solved.append(xy)
        return Estimate(Status.FAILED)

    monkeypatch.setattr(sys.modules["matchers.pairwise"], "solve_pose", solve)
    localizer.localize(replace(QUERY, image=image))
    assert len(solved[0]) > 100
    np.testing.assert_allclose(solved[0], np.tile([120.3, 90.8], (len(solved[0]), 1)), atol=0.05)


def test_a_matcher_that_finds_nothing_or_fails_says_why(
    vismatch: Any, caplog: pytest.LogCaptureFixture
) -> None:
    nothing = np.empty((0, 2))
    vismatch(lambda img0, img1: {"matched_kpts0": nothing, "matched_kpts1": nothing})
    estimate = ready(create("vismatch", {"matcher": "sift-nn"})).localize(QUERY)
    assert estimate.status is Status.FAILED
    assert estimate.reason == "0 matches to the map, 4 are needed"

    def fails(img0: NDArray[np.float32], img1: NDArray[np.float32]) -> Matches:
        raise ValueError("no keypoints")

    vismatch(fails)
    assert ready(create("vismatch", {"matcher": "sift-nn"})).localize(QUERY).status == "failed"
    assert "sift-nn failed on" in caplog.text
    assert "ValueError('no keypoints')" in caplog.text


def test_vismatch_is_needed_only_when_it_is_used(
    vismatch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "vismatch", None)  # as if not installed
    localizer = create("vismatch", {})
    with pytest.raises(InputError, match="pip install vismatch"):
        ready(localizer)
    vismatch(sift_matches)
    with pytest.raises(InputError, match=r"matcher=roma on device=cpu: Matcher roma not yet.*d\.$"):
        ready(create("vismatch", {"matcher": "roma"}))
    assert {"vismatch", "hloc", "adalam"} <= set(method_names())


@pytest.mark.parametrize("prior", [True, False], ids=["with-prior", "without-prior"])
def test_pairs_of_adalam_give_the_pose(prior: bool) -> None:
    pytest.importorskip("kornia", reason="kornia is not installed: make install")
    localizer = ready(create("adalam", {"max_features": 2048}))
    estimate = localizer.localize(QUERY if prior else replace(QUERY, prior=None))
    assert metres_off(estimate) < 0.4
    blank = replace(QUERY, image=np.zeros_like(QUERY.image))
    assert localizer.localize(blank).status is Status.FAILED


def test_without_kornia_adalam_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kornia.feature", None)
    monkeypatch.setitem(sys.modules, "kornia", None)
    with pytest.raises(InputError, match=r"objconnect\[kornia\]"):
        create("adalam", {})


def write_hloc(folder: Path, query_first: bool = True, separator: str = "/") -> dict[str, Path]:
    """Files as hloc writes them: the map's own keypoints, matched with where the query sees them.

    Half of the matches are wrong. Pixels count from the centre of the first one.
    """
    random = np.random.default_rng(0)
    paths = {"features": folder / "features.h5", "matches": folder / "matches.h5"}
    own = QUERY.camera.project(TRUTH.transform(torch.from_numpy(MAP.xyz)))
    visible = (own.valid & QUERY.camera.contains(own.xy)).numpy()
    rows = np.flatnonzero(visible)
    with h5py.File(paths["features"], "w") as features, h5py.File(paths["matches"], "w") as matches:
        features[f"{QUERY.name}/keypoints"] = own.xy.numpy()[rows] - 0.5
        for name, image in MAP.images.items():
            features[f"{name}/keypoints"] = image.xy - 0.5
            seen = np.flatnonzero(np.isin(image.point_rows, rows))
            at = np.searchsorted(rows, image.point_rows[seen])
            at[::2] = random.permutation(at[::2])
            pair = [part.replace("/", "-") for part in (QUERY.name, name)]
            matches0 = np.full(len(rows) if query_first else len(image.xy), -1)
            matches0[at if query_first else seen] = seen if query_first else at
            where = separator.join(pair if query_first else pair[::-1])
            matches[f"{where}/matches0"] = matches0
            matches[f"{where}/matching_scores0"] = np.ones(len(matches0), np.float16)
    return paths


@pytest.mark.parametrize("query_first", [True, False])
@pytest.mark.parametrize("separator", ["/", "_"])
def test_matches_of_hloc_give_the_pose(tmp_path: Path, query_first: bool, separator: str) -> None:
    paths = write_hloc(tmp_path, query_first, separator)
    estimate = ready(create("hloc", paths)).localize(QUERY)
    # Points are interpolated; half a pixel's error of the keypoints would make it 0.48 m.
    assert metres_off(estimate) < 0.2


def test_a_query_without_pairs_says_why(tmp_path: Path) -> None:
    paths = write_hloc(tmp_path)
    h5py.File(paths["matches"], "w").close()
    estimate = ready(create("hloc", paths)).localize(QUERY)
    assert estimate.status is Status.FAILED
    assert "pairs it with no photograph of the map" in estimate.reason


def test_files_of_other_programs_are_refused(tmp_path: Path) -> None:
    paths = write_hloc(tmp_path)
    with h5py.File(paths["features"], "a") as file:
        del file[QUERY.name]
        file[f"{QUERY.name}/keypoints"] = np.zeros((3, 2))
    with pytest.raises(InputError, match="no matches of the keypoints in .*out of bounds"):
        ready(create("hloc", paths)).localize(QUERY)
    paths["matches"].write_bytes(paths["matches"].read_bytes()[:600])
    with pytest.raises(InputError, match="is not an HDF5 file, or is damaged"):
        ready(create("hloc", paths))
    with pytest.raises(InputError, match="matches"):
        create("hloc", {"features": paths["features"]})
    with pytest.raises(InputError, match="absent.h5"):
        ready(create("hloc", {**paths, "matches": tmp_path / "absent.h5"}))
