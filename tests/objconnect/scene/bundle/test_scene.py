from __future__ import annotations

from pathlib import Path

import pycolmap
import pytest

from objconnect.scene.bundle.frames import write_frames
from objconnect.scene.bundle.manifest import Manifest, Objects, Session, Splits, write_json
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.digests import sha256_of
from tests.objconnect.scene.bundle.test_frames import ALL, assert_equal, make_frames, make_layers

SESSION = "summer-noon-nadir"


@pytest.fixture
def unfinished(tmp_path: Path) -> tuple[Path, Manifest]:
    """Write a scene without its manifest, in a folder with a space in its name."""
    path = tmp_path / "my scene"
    images = path / "sessions" / SESSION / "images"
    images.mkdir(parents=True)
    for k in range(2):
        (images / f"{k:06d}.jpg").write_bytes(bytes([k]))
    layers = (make_layers(k) for k in range(2))
    write_frames(images.parent / "frames.h5", make_frames(2), ALL, layers)
    (path / "map").mkdir()
    options = pycolmap.SyntheticDatasetOptions()
    options.num_points3D = 10
    pycolmap.synthesize_dataset(options).write(path / "map")
    write_json(path / "objects.json", Objects(classes={}, objects=()))
    names = make_frames(2).names
    write_json(path / "splits.json", Splits(map=names[:1], queries={SESSION: names[1:]}))
    manifest = Manifest(
        versions={},
        preset="town",
        seed=1,
        config={},
        origin=Geodetic(46.8, -92.0, 198.5),
        sessions={SESSION: Session(condition="summer-noon", flight="nadir", role="map")},
        sha256={},
    )
    return path, manifest


@pytest.fixture
def scene(unfinished: tuple[Path, Manifest]) -> Path:
    finish_scene(*unfinished)
    return unfinished[0]


def test_everything_is_read_back(scene: Path) -> None:
    opened = Scene.open(scene)
    assert opened.name == "my scene"
    assert list(opened.sessions) == [SESSION]
    assert_equal(opened.frames(SESSION), make_frames(2))
    with opened.layers(SESSION) as dense:
        assert (dense.read("depth", 1) == make_layers(1)["depth"]).all()
    assert opened.splits.map == make_frames(1).names
    assert opened.objects.objects == ()
    assert len(opened.sparse_map().xyz) == 10
    assert all((opened.images_root / name).is_file() for name in opened.splits.map)


def test_the_manifest_holds_the_digest_of_every_file(scene: Path) -> None:
    recorded = Scene.open(scene).manifest.sha256
    files = {p.relative_to(scene).as_posix() for p in scene.rglob("*") if p.is_file()}
    assert set(recorded) == files - {"scene.json"}
    for name, digest in recorded.items():
        assert sha256_of(scene / name) == digest


def test_a_fresh_scene_has_no_changed_files(scene: Path) -> None:
    assert Scene.open(scene).find_changed_files() == []


def test_edited_removed_and_added_files_are_noticed(scene: Path) -> None:
    images = scene / "sessions" / SESSION / "images"
    (images / "000000.jpg").write_bytes(b"edited")
    (images / "000001.jpg").unlink()
    (images / "000002.jpg").write_bytes(b"added")
    assert Scene.open(scene).find_changed_files() == [
        f"sessions/{SESSION}/images/00000{k}.jpg" for k in range(3)
    ]


def test_pictures_for_people_and_hidden_files_are_no_data(scene: Path) -> None:
    (scene / "pictures").mkdir()
    (scene / "pictures" / "contact_sheet.png").touch()
    (scene / ".DS_Store").touch()
    assert Scene.open(scene).find_changed_files() == []


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="scene folder .*nowhere does not exist"):
        Scene.open(tmp_path / "nowhere")


def test_an_unfinished_scene_is_refused(unfinished: tuple[Path, Manifest]) -> None:
    with pytest.raises(InputError, match=r"not a finished scene: it has no scene\.json"):
        Scene.open(unfinished[0])


def test_a_damaged_manifest_is_refused(scene: Path) -> None:
    text = (scene / "scene.json").read_text()
    (scene / "scene.json").write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match=r"scene manifest .*scene\.json is not valid JSON"):
        Scene.open(scene)


def test_unknown_session_lists_the_known_ones(scene: Path) -> None:
    with pytest.raises(InputError, match=f"no session 'winter'; it has {SESSION}"):
        Scene.open(scene).frames("winter")


def test_missing_parts_are_named(scene: Path) -> None:
    for part in ("splits.json", "objects.json", f"sessions/{SESSION}/frames.h5"):
        (scene / part).unlink()
    opened = Scene.open(scene)
    with pytest.raises(InputError, match=r"split list .*splits\.json"):
        _ = opened.splits
    with pytest.raises(InputError, match=r"object list .*objects\.json"):
        _ = opened.objects
    with pytest.raises(InputError, match=r"frames\.h5 does not exist"):
        opened.frames(SESSION)


def test_a_scene_without_a_map_says_how_to_build_it(scene: Path) -> None:
    for file in (scene / "map").iterdir():
        file.unlink()
    (scene / "map").rmdir()
    with pytest.raises(InputError, match="has no map yet: run 'objconnect map "):
        Scene.open(scene).sparse_map()


def test_an_unfinished_map_is_one_clear_error(scene: Path) -> None:
    (scene / "map" / "points3D.bin").unlink()
    with pytest.raises(InputError, match=r"points3D\.bin"):
        Scene.open(scene).sparse_map()
