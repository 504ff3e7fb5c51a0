from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from objconnect.scene.bundle.georeference import EXACT_GEOREFERENCE as EXACT
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.manifest import (
    Manifest,
    Objects,
    SceneObject,
    Session,
    Splits,
    read_json,
    size_class,
    write_json,
)
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic

MANIFEST = Manifest(
    versions={"objconnect": "0.1.0"},
    preset="town",
    seed=7,
    config={"area": 400.0, "sessions": ["summer-noon:nadir"]},
    origin=Geodetic(46.8, -92.0, 198.5),
    sessions={"summer-noon-nadir": Session(condition="summer-noon", flight="nadir", role="map")},
    sha256={"splits.json": "00"},
)
CAR = SceneObject(
    id=3,
    class_name="car",
    centre=(1.0, 2.0, 0.7),
    size=(4.5, 1.8, 1.4),
    yaw_deg=30.0,
    size_class="medium",
)


def test_manifests_survive_writing_and_reading(tmp_path: Path) -> None:
    values = [
        MANIFEST,
        MANIFEST.model_copy(update={"preset": None, "seed": None}),
        Objects(classes={"car": 1}, objects=(CAR,)),
        Splits(map=("a/0.jpg",), queries={"b": ("b/0.jpg", "b/1.jpg")}),
    ]
    for value in values:
        write_json(tmp_path / "file.json", value)
        assert read_json(tmp_path / "file.json", type(value), "file") == value


def change(tmp_path: Path, **update: Any) -> Path:
    """A manifest file with some values replaced; None removes the key."""
    values = json.loads(MANIFEST.model_dump_json()) | update
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({k: v for k, v in values.items() if v is not ...}))
    return path


@pytest.mark.parametrize(
    ("update", "message"),
    [
        ({"colour": "red"}, "unknown key 'colour' in .*scene.json; known: schema_version"),
        ({"schema_version": 2}, "bad value for 'schema_version'"),
        ({"seed": "seven"}, "bad value for 'seed'"),
        ({"origin": [46.8, -92.0]}, "'origin"),
        ({"origin": [float("nan"), -92.0, 0.0]}, "bad value for 'origin"),
        ({"origin": [46.8, float("inf"), 0.0]}, "bad value for 'origin"),
        ({"sessions": {"a": {"condition": "x", "flight": "y"}}}, "missing key 'sessions.a.role'"),
        (
            {"sessions": {"a": {"condition": "x", "flight": "y", "role": "z"}}},
            "bad value for 'sessions.a.role'",
        ),
    ],
)
def test_bad_manifests_are_refused(tmp_path: Path, update: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_json(change(tmp_path, **update), Manifest, "scene manifest")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_a_missing_key_does_not_print_the_manifest(tmp_path: Path) -> None:
    sha256 = {f"sessions/a/images/{k:06d}.jpg": "0" * 64 for k in range(500)}
    path = change(tmp_path, seed=..., sha256=sha256)
    with pytest.raises(InputError) as caught:
        read_json(path, Manifest, "scene manifest")
    assert str(caught.value) == f"missing key 'seed' in {path}"


@pytest.mark.parametrize("key", ["centre", "size"])
def test_boxes_are_finite(tmp_path: Path, key: str) -> None:
    values = CAR.model_dump() | {key: [0.0, float("nan"), 1.0]}
    path = tmp_path / "objects.json"
    path.write_text(json.dumps({"classes": {"car": 1}, "objects": [values]}))
    with pytest.raises(InputError, match=f"bad value for 'objects.0.{key}"):
        read_json(path, Objects, "object list")


@pytest.mark.parametrize(
    "text", ["", "{", "nonsense", "[" * 100_000, '{"seed": ' + "9" * 5000 + "}"]
)
def test_a_file_that_is_not_json_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.json").write_text(text)
    with pytest.raises(InputError, match=r"scene manifest .*scene\.json is not valid JSON"):
        read_json(tmp_path / "scene.json", Manifest, "scene manifest")


@pytest.mark.parametrize("text", ["[]", "7", "null", '"scene"'])
def test_json_of_the_wrong_kind(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.json").write_text(text)
    with pytest.raises(InputError, match="bad value for 'Manifest'"):
        read_json(tmp_path / "scene.json", Manifest, "scene manifest")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read split list .*splits\.json: No such file"):
        read_json(tmp_path / "splits.json", Splits, "split list")


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((2.9, 1.0, 1.0), "small"),
        ((1.0, 1.0, 3.0), "medium"),
        ((1.0, 9.9, 3.0), "medium"),
        ((10.0, 1.0, 1.0), "large"),
    ],
)
def test_size_classes(size: tuple[float, float, float], expected: str) -> None:
    assert size_class(size) == expected


@pytest.mark.parametrize("name", ["../elsewhere", "/etc", "..", "a/b", "", "."])
def test_sessions_are_folders_of_the_scene(name: str, tmp_path: Path) -> None:
    values = json.loads(MANIFEST.model_dump_json())
    values["sessions"] = {name: values["sessions"].popitem()[1]}
    (tmp_path / "scene.json").write_text(json.dumps(values))
    with pytest.raises(InputError, match=r"sessions.*(folder|lie in the scene)"):
        read_json(tmp_path / "scene.json", Manifest, "manifest")


@pytest.mark.parametrize(
    "splits",
    [
        {"map": ["../../x.jpg"], "queries": {}},
        {"map": [], "queries": {"s": ["/etc/passwd"]}},
        {"map": [], "queries": {"../s": []}},
    ],
)
def test_split_frames_lie_in_the_scene(splits: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "splits.json").write_text(json.dumps(splits))
    with pytest.raises(
        InputError, match=r"splits\.json: (it does not lie|a session must be the name)"
    ):
        read_json(tmp_path / "splits.json", Splits, "split list")


def test_how_exactly_a_scene_is_placed_is_kept(tmp_path: Path) -> None:
    placed = Georeference(horizontal_m=4.2, vertical_m=None, source="gps")
    flown = {"preset": None, "seed": None, "reference": "sfm"}
    for georeference in (None, placed):
        value = MANIFEST.model_copy(update={**flown, "georeference": georeference})
        write_json(tmp_path / "scene.json", value)
        read = read_json(tmp_path / "scene.json", Manifest, "scene")
        assert read == value and read.effective_georeference == georeference
        # Earlier versions read what they can.
        assert ("georeference" in json.loads((tmp_path / "scene.json").read_text())) == (
            georeference is not None
        )


def test_invented_worlds_are_where_their_origin_says() -> None:
    assert MANIFEST.effective_georeference == EXACT
    of_a_site = {"config": {"site": {"dsm": "a.tif"}}}
    of_an_orthophoto = {"preset": None}
    for changes in (of_a_site, of_an_orthophoto, {"reference": "sfm"}):
        assert MANIFEST.model_copy(update=changes).effective_georeference is None, changes


@pytest.mark.parametrize(
    "georeference",
    [
        {"horizontal_m": -1.0, "source": "gps"},
        {"horizontal_m": float("nan"), "source": "gps"},
        {"horizontal_m": 1.0, "vertical_m": float("inf"), "source": "gps"},
        {"horizontal_m": 1.0, "source": "guess"},
        {"horizontal_m": 1.0},
        {"vertical_m": 1.0, "source": "gps"},
        {"horizontal_m": 1.0, "source": "gps", "unit": "ft"},
    ],
)
def test_a_bad_georeference_is_refused(tmp_path: Path, georeference: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="georeference"):
        read_json(change(tmp_path, georeference=georeference), Manifest, "scene manifest")
