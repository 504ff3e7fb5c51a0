"""A changed byte is another data set: of a query, of the map's photographs, of the map.

Photographs are edited behind the program's back, as a careless user or a tool does: one pixel, with
the size and the time of the file as they were.
"""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PIL import Image

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.submission import submit
from benchmark.results.results_files import load
from objconnect.methods import METHODS, create
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Estimate, Query, Status
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from tests.baselines.lightglue.weights import LIGHTGLUE, options_of
from tests.baselines.pixloc.made_map import write_map
from tests.benchmark.datasets.test_cmu import HIDDEN, REFERENCE, SNOW, cmu  # noqa: F401
from tests.benchmark.made_data import FakeLocalizer, pose_at, write_flight, write_scene
from tests.benchmark.test_cli import error_line, invoke


def edit(path: Path) -> None:
    """Change one pixel; name and time of the file stay, as far as the system lets them."""
    with Image.open(path) as image:
        pixels, kind = np.array(image.convert("RGB")), image.format
    pixels[20, 30] = 255 - pixels[20, 30]
    status = path.stat()
    Image.fromarray(pixels).save(path, kind)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def digest_of(path: Path) -> str:
    (dataset,) = open_datasets(path)
    return dataset.sha256


@pytest.fixture
def made_flight(tmp_path: Path) -> Path:
    """A small flight."""
    return write_flight(tmp_path / "meadow")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A small scene."""
    return write_scene(tmp_path / "hamlet")


@pytest.fixture(params=["flight", "scene", "cmu"])
def data(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str, str]:
    """A data set of each kind: its folder, one photograph of a query, and one of the map."""
    if request.param == "flight":
        return write_flight(tmp_path / "here" / "meadow"), "images/b.jpg", "images/a.jpg"
    if request.param == "scene":
        path = write_scene(tmp_path / "here" / "hamlet")
        images = [
            f"sessions/{flight}/images/000001.jpg" for flight in ("winter-grid", "summer-nadir")
        ]
        return path, images[0], images[1]
    path = request.getfixturevalue("cmu")
    return path, f"slice2/query/{SNOW}", f"slice2/database/{REFERENCE[1]}"


def test_a_pixel_of_a_query_makes_another_data_set(data: tuple[Path, str, str]) -> None:
    path, query, _ = data
    before = digest_of(path)
    edit(path / query)
    assert digest_of(path) != before


def test_a_pixel_of_a_map_photograph_makes_another_data_set(data: tuple[Path, str, str]) -> None:
    path, _, photograph = data
    before = digest_of(path)
    edit(path / photograph)
    changed = digest_of(path)
    assert changed != before
    (path / photograph).unlink()
    assert digest_of(path) not in (before, changed)


@pytest.mark.parametrize("part", ["cameras", "images", "points3D"])
def test_a_byte_of_the_map_makes_another_data_set(data: tuple[Path, str, str], part: str) -> None:
    """Also one that no localizer reads, as a colour."""
    path, _, _ = data
    before = digest_of(path)
    (file,) = path.glob(f"**/{'slice2/**/' if 'slice2' in data[1] else ''}{part}.bin")
    content = bytearray(file.read_bytes())
    # The last bit of the camera's last number, of the last observation's x, a point's red.
    at = {"cameras": -8, "images": -24, "points3D": 8 + 8 + 24}[part]
    content[at] ^= 1
    file.write_bytes(content)
    assert digest_of(path) != before


def test_a_copy_elsewhere_is_the_same_data_set(
    data: tuple[Path, str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _, _ = data
    before = digest_of(path)
    copy = tmp_path / "elsewhere" / "under another name"
    shutil.copytree(path, copy)
    assert digest_of(copy) == before
    monkeypatch.chdir(copy.parent)
    assert digest_of(Path(copy.name)) == before


def test_the_manifest_is_not_believed(scene: Path) -> None:
    before = digest_of(scene)
    manifest = scene / "scene.json"
    manifest.write_text(re.sub(r'"[0-9a-f]{64}"', f'"{"0" * 64}"', manifest.read_text()))
    assert digest_of(scene) == before
    edit(scene / "sessions/winter-grid/images/000000.jpg")
    assert digest_of(scene) != before


def run_queries(
    path: Path, out: Path, answers: dict[str, Estimate | KeyboardInterrupt]
) -> list[str]:
    """The queries that a run puts to its method; interrupted where an answer says so."""
    (dataset,) = open_datasets(path)
    localizer = FakeLocalizer(answers)
    try:
        evaluate(dataset, localizer, out)
    except KeyboardInterrupt:
        assert any(isinstance(answer, KeyboardInterrupt) for answer in answers.values())
    return [query.name for query in localizer.seen]


def warning(caplog: pytest.LogCaptureFixture) -> str:
    """The one line that was said."""
    (record,) = caplog.records
    caplog.clear()
    return record.getMessage()


def test_answers_to_other_bytes_are_not_taken(
    data: tuple[Path, str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, photograph, _ = data
    (dataset,) = open_datasets(path)
    names = [query.name for query in dataset.queries]
    (edited,) = (query.name for query in dataset.queries if query.image == path / photograph)
    last = {names[-1]: KeyboardInterrupt()}
    assert run_queries(path, tmp_path / "out", {**last}) == names
    assert run_queries(path, tmp_path / "out", {**last}) == names[-1:]
    assert not caplog.records
    edit(path / photograph)
    assert run_queries(path, tmp_path / "out", {}) == names
    said = warning(caplog)
    assert said.startswith(f"the data set {dataset.name} changed since ")
    assert said.endswith(f" was written: query photograph {edited}")


def test_what_changed_since_the_results_is_said(
    data: tuple[Path, str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, _, photograph = data
    out = tmp_path / "out"
    run_queries(path, out, {})
    (file,) = out.glob("*/fake.json")
    before = load(file)
    run_queries(path, out, {})
    assert not caplog.records
    edit(path / photograph)
    run_queries(path, out, {})
    name = Path(photograph).name
    pattern = rf"changed since {file} was written: map photograph .*{name}"
    assert re.search(pattern, warning(caplog))
    assert load(file).dataset.sha256 != before.dataset.sha256


def test_results_of_an_older_version_are_one_line(
    made_flight: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run_queries(made_flight, tmp_path / "out", {})
    file = tmp_path / "out/meadow/fake.json"
    text = file.read_text()
    file.write_text(text.replace(load(file).dataset.sha256, "0" * 64))
    run_queries(made_flight, tmp_path / "out", {})
    said = "fake.json was written: the earlier run did not record its parts"
    assert warning(caplog).endswith(said)
    file.write_text(text[: len(text) // 2])
    run_queries(made_flight, tmp_path / "out", {})
    assert not caplog.records


def test_many_changes_are_one_line(
    made_flight: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run_queries(made_flight, tmp_path / "out", {})
    for name in "abdef":
        edit(made_flight / "images" / f"{name}.jpg")
    (made_flight / "gps.csv").unlink()
    run_queries(made_flight, tmp_path / "out", {})
    assert warning(caplog).endswith(
        "map photograph a.jpg, map photograph e.jpg, query photograph b.jpg and 5 more"
    )


@pytest.mark.parametrize("photograph", ["a.jpg", "f.jpg"])
def test_a_data_set_that_changes_during_the_run_gives_no_results(
    made_flight: Path, tmp_path: Path, photograph: str
) -> None:
    class Meddler(FakeLocalizer):
        def localize(self, query: Query) -> Estimate:
            if query.name == "d.jpg":
                edit(made_flight / "images" / photograph)
            return super().localize(query)

    (dataset,) = open_datasets(made_flight)
    with pytest.raises(InputError, match=rf"meadow was changed during the run: .*{photograph}"):
        evaluate(dataset, Meddler({}), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_gate_refuses_other_bytes_in_one_line(made_flight: Path, tmp_path: Path) -> None:
    run_queries(made_flight, tmp_path / "old", {})
    edit(made_flight / "images" / "a.jpg")
    run_queries(made_flight, tmp_path / "new", {})
    result = invoke("regress", tmp_path / "new", "--against", tmp_path / "old")
    assert result.exit_code == 2
    old, new = (
        load(tmp_path / folder / "meadow" / "fake.json").dataset.sha256 for folder in ("old", "new")
    )
    line = error_line(result.stderr)
    assert f"are of data set {new[:12]}, the baseline of {old[:12]}" in line


# What is kept per map.


@pytest.fixture(scope="module")
def made_map(tmp_path_factory: pytest.TempPathFactory) -> tuple[SparseMap, Path]:
    images = tmp_path_factory.mktemp("map") / "images"
    return write_map(images), images


Content = dict[str, dict[str, list[Any]]]


def content(cache: Path) -> Content:
    """The arrays of every file of a cache, to six decimals: of the last bits of a solution of
    linear equations nobody is sure."""
    found: Content = {}
    for path in cache.iterdir():
        arrays: dict[str, list[Any]] = {}

        def note(name: str, node: object, arrays: dict[str, list[Any]] = arrays) -> None:
            if isinstance(node, h5py.Dataset):
                values = node[...]
                is_text = values.dtype.kind == "S"
                arrays[name] = (values if is_text else np.round(values.astype(float), 6)).tolist()

        with h5py.File(path) as file:
            file.visititems(note)
        found[path.name] = arrays
    return found


# Smaller pictures, where a network looks at them.
QUICK = {
    "d2net": {"max_edge": 128},
    **{name: {"longest": 128} for name in ("pixloc", "pixloc-search", "objconnect")},
}


# The objects of objconnect without what it shares with pixloc, place and sift.
OBJECTS = {"longest": 128, "matches": None, "place": {"candidates": 0}}
# The first two keep what the other methods keep, and objconnect its objects; LightGlue is slow.
COMBINED = dict.fromkeys(("objconnect", "pixloc-search", *LIGHTGLUE), pytest.mark.thorough)


@pytest.mark.parametrize(
    ("method", "part"),
    [
        *(pytest.param(name, "photograph", marks=COMBINED.get(name, ())) for name in METHODS),
        ("d2net", "camera"),
        ("pixloc", "tracks"),
        ("objconnect", "objects"),
    ],
)
def test_no_method_takes_from_the_cache_what_was_of_other_bytes(
    made_map: tuple[SparseMap, Path], tmp_path: Path, method: str, part: str
) -> None:
    """After an edit the cache must give what an empty one would."""
    sparse_map, images = made_map
    images = Path(shutil.copytree(images, tmp_path / "images"))
    used, fresh = tmp_path / "used", tmp_path / "fresh"
    used.mkdir()
    fresh.mkdir()

    def prepare(cache: Path) -> Content:
        options = OBJECTS if part == "objects" else QUICK.get(method, {})
        create(method, options_of(method, **options)).prepare(sparse_map, images, cache)
        return content(cache)

    before = prepare(used)
    assert prepare(used) == before
    if part in ("photograph", "objects"):
        edit(images / "2.png")
    elif part == "camera":
        sparse_map = replace(sparse_map, images=dict(map(narrow, sparse_map.images.items())))
    else:
        few = np.where(np.arange(len(sparse_map.xyz)) % 3, 1, 5)
        sparse_map = replace(sparse_map, track_length=few)
    now, anew = prepare(used), prepare(fresh)
    assert now == before | anew
    assert not before.keys() & anew.keys()
    assert bool(before) == (method != "prior")


def narrow(item: tuple[str, MapImage]) -> tuple[str, MapImage]:
    """A photograph with pixels that are not squares."""
    name, image = item
    fx, fy, cx, cy = image.camera.params
    return name, replace(image, camera=replace(image.camera, params=(fx, 1.3 * fy, cx, cy)))


@pytest.mark.parametrize("folder", ["database", "query"])
def test_a_submission_does_not_go_on_with_other_bytes(
    cmu: Path,  # noqa: F811
    tmp_path: Path,
    folder: str,
) -> None:
    shutil.rmtree(cmu / "slice22")
    submit(cmu, FakeLocalizer({SNOW: Estimate(Status.OK, pose_at(3))}), tmp_path / "out")
    again = FakeLocalizer({})
    submit(cmu, again, tmp_path / "out")
    assert not again.seen
    edit(cmu / "slice2" / folder / {"database": REFERENCE[0], "query": HIDDEN}[folder])
    submit(cmu, again, tmp_path / "out")
    assert len(again.seen) == 3


# Results that are given twice.


@pytest.fixture
def results(scene: Path, tmp_path: Path) -> Path:
    """Of a method on six queries."""
    run_queries(scene, tmp_path / "out", {})
    return tmp_path / "out" / "hamlet" / "fake.json"


@pytest.mark.parametrize("how", ["again", "folder", "link", "copy", "hard link"])
def test_results_given_twice_count_once(results: Path, tmp_path: Path, how: str) -> None:
    other = tmp_path / "other.json"
    if how == "again":
        other = results
    elif how == "folder":
        other = results.parents[1]
    elif how == "link":
        other.symlink_to(results)
    elif how == "copy":
        shutil.copyfile(results, other)
    else:
        other.hardlink_to(results)
    once = invoke("leaderboard", results, "--json")
    twice = invoke("leaderboard", results, other, "--json")
    assert (once.exit_code, twice.exit_code) == (0, 0)
    assert twice.stdout == once.stdout
    assert "6" in invoke("leaderboard", results, other).stdout


def test_that_results_count_once_is_said(
    results: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copy = Path(shutil.copyfile(results, tmp_path / "copy.json"))
    invoke("leaderboard", results, copy)
    assert warning(caplog) == f"{copy} holds the same results as {results}: they count once"


def test_two_results_of_one_run_are_refused(scene: Path, results: Path, tmp_path: Path) -> None:
    """The same method on the same data, asked again: other seconds, or other answers."""
    name = "winter-grid/images/000000.jpg"
    run_queries(scene, tmp_path / "again", {name: Estimate(Status.OK, pose_at(2))})
    other = tmp_path / "again" / "hamlet" / "fake.json"
    result = invoke("leaderboard", results, other, "--out", tmp_path / "board")
    assert result.exit_code == 2
    line = error_line(result.stderr)
    assert f"{results} and {other} are two results of fake" in line
    assert not (tmp_path / "board").exists()


def test_results_before_and_after_an_edit_stand_apart(
    scene: Path, results: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    edit(scene / "sessions/summer-nadir/images/000000.jpg")
    run_queries(scene, tmp_path / "after", {})
    result = invoke("leaderboard", results, tmp_path / "after")
    assert result.exit_code == 0
    assert len(re.findall(r"^## uav-sim: hamlet", result.stdout, re.MULTILINE)) == 2
    assert "results are of 2 data sets called hamlet (" in warning(caplog)
