"""What ``publish`` writes, what it refuses, and what it leaves behind."""

from __future__ import annotations

import errno
import hashlib
import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from benchmark.publishing import command, shards
from benchmark.publishing.columns import columns_with
from benchmark.publishing.command import publish
from benchmark.publishing.description import Release
from benchmark.publishing.index import INDEX, read_index
from benchmark.publishing.licenses import hub_license
from benchmark.publishing.rows import Row, SceneRows
from benchmark.publishing.shards import read_shards, write_shards
from benchmark.tracks.difficulty import measure
from objconnect.scene.bundle.frames import LAYERS, Layer
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.bundle.thermal import Thermal, write_thermal
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.checksums import CHECKSUMS
from tests.benchmark.publishing.conftest import STATED
from tests.benchmark.test_cli import invoke


def names_in(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def change(scene: Path, **values: object) -> None:
    """Finish a scene again with other facts."""
    finish_scene(scene, Scene.open(scene).manifest.model_copy(update=values))


def add_thermal(scene: Path) -> None:
    """Write thermal pictures of invented temperatures beside all photographs of a scene."""
    record = Thermal(kelvin_per_count=0.01, netd_k=0.05, air_c=20.0, low_c=10.0, high_c=60.0)
    opened, rng = Scene.open(scene), np.random.default_rng(3)
    for session in opened.sessions:
        frames = opened.frames(session)
        for name, camera in zip(frames.names, frames.cameras, strict=True):
            counts = rng.integers(28000, 33000, (camera.height, camera.width), np.uint16)
            write_thermal(opened.images_root, name, counts, record)
    sessions = {
        name: session.model_copy(update={"thermal": record})
        for name, session in opened.sessions.items()
    }
    change(scene, sessions=sessions)


def read_query_rows(folder: Path, *columns: str) -> list[Row]:
    return list(read_shards(sorted(folder.glob("data/*/query-*.parquet")), columns))


def test_the_folder_is_whole(published: Path) -> None:
    assert names_in(published) == {
        "README.md",
        "croissant.json",
        INDEX,
        CHECKSUMS,
        "pictures/hamlet.jpg",
        "data/hamlet/map-00000.parquet",
        "data/hamlet/query-00000.parquet",
        "scenes/hamlet/objects.json",
        *(f"scenes/hamlet/map/{name}.bin" for name in ("cameras", "images", "points3D")),
        "scenes/hamlet/map/supplement.json",
    }


def test_checksums_are_those_of_all_files(published: Path) -> None:
    lines = (published / CHECKSUMS).read_text().splitlines()
    listed = {name: sha256 for sha256, name in (line.split("  ") for line in lines)}
    assert set(listed) == names_in(published) - {CHECKSUMS}
    for name, sha256 in listed.items():
        assert hashlib.sha256((published / name).read_bytes()).hexdigest() == sha256


def test_publishing_twice_gives_the_same_bytes(
    published: Path, hamlet: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again" / "published"
    again.parent.mkdir()
    publish([hamlet], again, release=STATED)
    assert (again / CHECKSUMS).read_bytes() == (published / CHECKSUMS).read_bytes()


def test_photographs_and_maps_are_as_they_were(published: Path, hamlet: Path) -> None:
    rows = read_query_rows(published, "name", "image", "sha256")
    assert len(rows) == 6
    for row in rows:
        photograph = (hamlet / "sessions" / row["name"]).read_bytes()
        assert row["image"] == {"bytes": photograph, "path": row["name"]}
        assert row["sha256"] == hashlib.sha256(photograph).hexdigest()
    for model in (published / "scenes/hamlet/map").iterdir():
        assert model.read_bytes() == (hamlet / "map" / model.name).read_bytes()


def test_a_dry_run_tells_the_bytes_and_writes_nothing(hamlet: Path, tmp_path: Path) -> None:
    before = names_in(tmp_path)
    report = publish([hamlet], tmp_path / "out", dry_run=True)
    photographs = sum(p.stat().st_size for p in hamlet.glob("sessions/*/images/*.jpg"))
    assert report.written is None
    assert report.sizes.photographs == photographs
    assert report.as_dict()["total"] == photographs + report.sizes.maps
    assert f"would hold about {report.sizes.total} bytes" in report.text()
    assert names_in(tmp_path) == before
    assert not (tmp_path / "out").exists()


def test_a_dry_run_is_near_to_the_bytes_of_a_render(rendered: Scene, tmp_path: Path) -> None:
    report = publish([rendered.path], tmp_path / "out", layers=["depth", "instance"])
    assert report.written is not None
    assert report.sizes.layers > 0
    assert 0.7 < report.written / report.sizes.total < 1.3


def test_layers_are_exact(rendered: Scene, tmp_path: Path) -> None:
    every: tuple[Layer, ...] = tuple(LAYERS)
    rows = SceneRows(rendered, {s: rendered.frames(s) for s in rendered.sessions}, every)
    files = write_shards(tmp_path, "map", columns_with(every), rows.rows("map"))
    row = next(read_shards(files, ("name", *every)))
    session = row["name"].split("/")[0]
    index = rendered.frames(session).names.index(row["name"])
    with rendered.layers(session) as dense:
        for layer in every:
            with Image.open(io.BytesIO(row[layer]["bytes"])) as image:
                pixels = np.asarray(image)
            if layer == "normal":
                pixels = (pixels.astype(np.int16) - 128).astype(np.int8)
            assert pixels.dtype == LAYERS[layer]
            assert np.array_equal(pixels, dense.read(layer, index)), layer


def test_thermal_pictures_are_published_in_kelvin(hamlet: Path, tmp_path: Path) -> None:
    add_thermal(hamlet)
    report = publish([hamlet], tmp_path / "out", layers=["thermal"])
    pictures = hamlet.glob("sessions/*/thermal/*.png")
    assert report.sizes.layers == sum(picture.stat().st_size for picture in pictures)
    rows = read_query_rows(tmp_path / "out", "name", "thermal")
    for row in rows:
        with Image.open(io.BytesIO(row["thermal"]["bytes"])) as image:
            kelvin = np.asarray(image)
        assert kelvin.dtype == np.float32
        assert np.array_equal(kelvin, Scene.open(hamlet).thermal(row["name"]))
    assert read_index(tmp_path / "out").layers == ("thermal",)


def test_a_scene_without_whole_thermal_pictures_is_refused(hamlet: Path, tmp_path: Path) -> None:
    def refusal() -> str:
        with pytest.raises(InputError) as caught:
            publish([hamlet], tmp_path / "out", layers=["thermal"])
        assert not (tmp_path / "out").exists()
        return str(caught.value)

    assert "session without thermal images: leave out --layer thermal" in refusal()
    add_thermal(hamlet)
    picture = next(hamlet.glob("sessions/*/thermal/*.png"))
    picture.write_bytes(picture.read_bytes()[:60])
    assert str(picture) in refusal()
    picture.unlink()
    assert f"cannot read {picture}: No such file" in refusal()


def test_difficulty_is_that_of_the_tracks(rendered: Scene, tmp_path: Path) -> None:
    publish([rendered.path], tmp_path / "out")
    columns = ("overlap", "scale", "angle_deg", "days")
    rows = {row["name"]: row for row in read_query_rows(tmp_path / "out", "name", *columns)}
    measured = measure(rendered)
    assert len(rows) == len(measured)
    for query in measured:
        assert tuple(rows[query.name][column] for column in columns) == query.difficulty


def test_shards_end_at_their_size(hamlet: Path, tmp_path: Path) -> None:
    scene = Scene.open(hamlet)
    rows = SceneRows(scene, {session: scene.frames(session) for session in scene.sessions})
    one = max(p.stat().st_size for p in hamlet.glob("sessions/*/images/*.jpg"))
    files = write_shards(tmp_path, "query", columns_with(()), rows.rows("query"), one + 1)
    assert [file.name for file in files] == [f"query-0000{k}.parquet" for k in range(3)]
    names = [row["name"] for row in read_shards(files, ["name"])]
    assert names == [name for of in scene.splits.queries.values() for name in of]


def test_a_folder_of_scenes_is_all_of_them(hamlet: Path, tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    for name in ("b", "a"):
        shutil.copytree(hamlet, scenes / name)
    (scenes / "notes").mkdir()
    report = publish([scenes], tmp_path / "out")
    assert report.scenes == ("a", "b")
    assert report.photographs == {"map": 6, "query": 12}
    matter = yaml.safe_load((tmp_path / "out/README.md").read_text().split("---\n")[1])
    assert [config["config_name"] for config in matter["configs"]] == ["default", "a", "b"]


def test_photographs_in_no_split_are_left_out_and_counted(hamlet: Path, tmp_path: Path) -> None:
    splits = Scene.open(hamlet).splits
    kept = {session: names[:1] for session, names in splits.queries.items()}
    write_json(hamlet / "splits.json", splits.model_copy(update={"queries": kept}))
    report = publish([hamlet], tmp_path / "out")
    assert report.left_out == 4
    assert "4 photographs are in no split" in report.text()
    assert read_index(tmp_path / "out").scenes[0].photographs == {"map": 3, "query": 2}


def test_a_photograph_of_another_size_is_refused(hamlet: Path, tmp_path: Path) -> None:
    Image.new("RGB", (9, 9)).save(hamlet / "sessions/winter-grid/images/000001.jpg")
    with pytest.raises(InputError, match=r"000001\.jpg .*9"):
        publish([hamlet], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_was_not_stated_is_named(hamlet: Path, tmp_path: Path) -> None:
    report = publish([hamlet], tmp_path / "out", release=Release(creator="A. Author"))
    assert report.unstated == ("url", "date")
    assert "--url, --date" in report.text()
    assert not STATED.unstated


def test_a_folder_that_is_not_empty_is_refused(published: Path, hamlet: Path) -> None:
    before = (published / CHECKSUMS).read_bytes()
    with pytest.raises(InputError, match="is not empty"):
        publish([hamlet], published)
    assert (published / CHECKSUMS).read_bytes() == before


def test_a_published_data_set_is_not_published_again(
    published: Path, hamlet: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="is published already: give the scenes"):
        publish([published], tmp_path / "again")
    with pytest.raises(InputError, match="lies in the data set .*: choose a folder outside it"):
        publish([hamlet], published / "pictures" / "inner")
    assert not (tmp_path / "again").exists() and not (published / "pictures" / "inner").exists()


@pytest.mark.parametrize(
    ("paths", "out", "says"),
    [
        (["hamlet"], "hamlet/out", "lies in the scene"),
        (["hamlet", "hamlet"], "out", "given 2 times"),
        (["hamlet", "copy/hamlet"], "out", "two scenes are called 'hamlet'"),
        (["nothing"], "out", "does not exist"),
        (["empty"], "out", "not a finished scene"),
    ],
)
def test_wrong_paths_are_refused(
    paths: list[str], out: str, says: str, hamlet: Path, tmp_path: Path
) -> None:
    shutil.copytree(hamlet, tmp_path / "copy/hamlet")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=says):
        publish([tmp_path / path for path in paths], tmp_path / out)


def test_a_scene_without_a_layer_is_refused(hamlet: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="session without depth images: leave out --layer depth"):
        publish([hamlet], tmp_path / "out", layers=["depth"])
    with pytest.raises(InputError, match="no layer 'height'; there are depth"):
        publish([hamlet], tmp_path / "out", layers=["height"])


@pytest.mark.parametrize(
    "facts",
    [{"reference": "sfm", "preset": None}, {"config": {"area": 1.0, "site": {"ortho": ""}}}],
)
def test_a_real_site_needs_a_licence(
    facts: dict[str, object], hamlet: Path, tmp_path: Path
) -> None:
    change(hamlet, **facts)
    with pytest.raises(InputError, match="may show a real site: state the licence"):
        publish([hamlet], tmp_path / "out")
    publish([hamlet], tmp_path / "out", release=Release(license="CC0-1.0"))
    card = (tmp_path / "out/README.md").read_text()
    assert "license: cc0-1.0" in card
    assert "https://spdx.org/licenses/CC0-1.0.html" in card
    assert "may show real sites, people" in card


@pytest.mark.parametrize(
    "wrong",
    [
        {"license": "my own"},
        {"license": "NOPE"},
        {"license": "cc-by-4.0"},
        {"creator": " "},
        {"creator": "two\nlines"},
        {"url": "example"},
        {"date": "17.5.2026"},
        {"version": "1"},
    ],
)
def test_wrong_facts_are_refused(wrong: dict[str, str]) -> None:
    name = next(iter(wrong))
    with pytest.raises(InputError, match="release" if name == "version" else name):
        replace(STATED, **wrong)


@pytest.mark.parametrize("command", ["publish", "publish-weights"])
def test_a_licence_that_the_hub_does_not_know_is_refused(command: str, tmp_path: Path) -> None:
    subject = {"publish": tmp_path, "publish-weights": "objconnect"}[command]
    result = invoke(command, subject, "--out", tmp_path / "out", "--license", "NOPE")
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert "license 'NOPE' is no SPDX identifier that the hub accepts: give one of AFL-3.0," in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("given", "named"), [("MIT", "mit"), ("ODbL-1.0", "odbl")])
def test_a_licence_has_the_name_of_the_hub(given: str, named: str) -> None:
    assert replace(STATED, license=given).license == given
    assert hub_license(given) == named


@pytest.mark.parametrize("step", ["write_shards", "draw_preview", "write_card", "write_croissant"])
def test_a_full_disk_leaves_nothing_behind(
    step: str, hamlet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(command, step, fail)
    before = names_in(tmp_path)
    with pytest.raises(WriteError, match=f"cannot write {tmp_path / 'out'}: No space left"):
        publish([hamlet], tmp_path / "out")
    assert names_in(tmp_path) == before
    assert not list(tmp_path.glob(".objconnect-*"))
    assert not (tmp_path / "out").exists()


def test_a_missing_library_is_named_before_any_work(
    hamlet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(module: str, extra: str, purpose: str) -> None:
        raise InputError(f"{purpose} needs {module}: {extra}")

    monkeypatch.setattr(shards, "import_extra", missing)
    with pytest.raises(InputError, match="pyarrow.parquet: hub"):
        publish([tmp_path / "nothing"], tmp_path / "out")
