"""``evaluate`` on a published folder: the scene's data set, or one line that names the fault."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.identity import describe_changes
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.publishing.command import publish
from benchmark.publishing.index import INDEX
from benchmark.results.query_result import QueryResult
from objconnect.methods import create
from objconnect.scene.bundle.frames import Frames, read_frames, write_frames
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError


def test_it_is_the_data_set_of_the_scene(published: Path, hamlet: Path) -> None:
    (ours,), (theirs,) = open_datasets(hamlet), open_datasets(published)
    assert describe_changes(ours.parts, theirs.parts) == ""
    assert (ours.name, ours.track, ours.sha256) == (theirs.name, theirs.track, theirs.sha256)
    assert ours.map_conditions == theirs.map_conditions
    for ours_of, theirs_of in zip(ours.queries, theirs.queries, strict=True):
        one, other = ours_of.load(ours_of.prior), theirs_of.load(theirs_of.prior)
        assert np.array_equal(one.image, other.image)
        assert ours_of.group == theirs_of.group


def test_unknown_priors_stay_unknown(hamlet: Path, tmp_path: Path) -> None:
    path = hamlet / "sessions/winter-grid/frames.h5"
    frames = read_frames(path)
    values = {key: value.copy() for key, value in vars(frames).items() if key not in NAMED}
    values["gps_prior"][0] = values["gps_sigma"][0] = np.nan
    values["attitude_prior"][1] = values["attitude_sigma_deg"][1] = np.nan
    values["time"][2] = np.nan
    write_frames(path, Frames(frames.names, frames.cameras, **values), (), iter(()))
    finish_scene(hamlet, Scene.open(hamlet).manifest)
    publish([hamlet], tmp_path / "out")
    (ours,), (theirs,) = open_datasets(hamlet), open_datasets(tmp_path / "out")
    assert ours.sha256 == theirs.sha256
    assert theirs.queries[3].prior is None
    prior = theirs.queries[4].prior
    assert prior is not None
    assert prior.cam_from_world_rotation is None


NAMED = ("names", "cameras")


@pytest.mark.thorough
def test_sift_finds_the_same_poses(rendered: Scene, tmp_path: Path, extracted_once: None) -> None:
    publish([rendered.path], tmp_path / rendered.name)
    outcomes = []
    for source in (rendered.path, tmp_path / rendered.name):
        (dataset,) = open_datasets(source)
        results = evaluate(dataset, create("sift", {}), tmp_path / f"results-{len(outcomes)}")
        outcomes.append([without_seconds(query) for query in results.queries])
        assert results.summary.queries == 7
    assert outcomes[0] == outcomes[1]
    assert any(query["t_err_m"] is not None for query in outcomes[0])


def without_seconds(query: QueryResult) -> dict[str, object]:
    return query.model_dump(exclude={"seconds"})


def test_photographs_are_unpacked_once(published: Path, photographs_cache: Path) -> None:
    (first,) = open_datasets(published)
    before = {path: path.stat().st_ino for path in photographs_cache.rglob("*.jpg")}
    assert len(before) == 9
    (second,) = open_datasets(published)
    assert {path: path.stat().st_ino for path in photographs_cache.rglob("*.jpg")} == before
    first.queries[0].image.write_bytes(b"spoiled")
    second.queries[1].image.unlink()
    (third,) = open_datasets(published)
    assert third.sha256 == first.sha256


def spoil_index(**values: object) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        text = json.loads((folder / INDEX).read_text())
        text["scenes"][0] |= values
        (folder / INDEX).write_text(json.dumps(text))

    return spoil


def spoil_byte(name: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        content = bytearray((folder / name).read_bytes())
        content[len(content) // 2] ^= 1
        (folder / name).write_bytes(content)

    return spoil


QUERIES = "data/hamlet/query-00000.parquet"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (spoil_byte(QUERIES), "query-00000.parquet is not the file that was published"),
        (spoil_byte("scenes/hamlet/map/images.bin"), "images.bin is not the file"),
        (lambda folder: (folder / QUERIES).unlink(), "query-00000.parquet does not exist"),
        (lambda folder: shutil.rmtree(folder / "scenes"), "does not exist"),
        (lambda folder: (folder / INDEX).write_text("{"), "is not valid JSON"),
        (spoil_index(files={}), "shard data/hamlet/.* has no digest"),
        (spoil_index(shards={}), "has no query"),
        (spoil_index(sessions={}), "belongs to no session"),
        (spoil_index(name="../hamlet"), INDEX),
        (spoil_index(colour="red"), "colour"),
    ],
)
def test_a_changed_folder_is_refused(
    spoil: Callable[[Path], None], says: str, published: Path
) -> None:
    spoil(published)
    with pytest.raises(InputError, match=says):
        open_datasets(published)


def test_no_home_is_named(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", _no_home)
    with pytest.raises(InputError, match="set XDG_CACHE_HOME"):
        open_datasets(published)


def _no_home() -> Path:
    raise RuntimeError("Could not determine home directory.")
