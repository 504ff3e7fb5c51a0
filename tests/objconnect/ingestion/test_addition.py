"""New photographs in a finished scene, which stays as it is."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import objconnect.scene.colmap.database
from benchmark.cli import app
from benchmark.datasets.open import open_datasets
from objconnect.ingestion.command import ingest
from objconnect.ingestion.neighbours import choose_similar
from objconnect.ingestion.options import IngestOptions
from objconnect.ingestion.report import IngestReport
from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.matching.features import map_features
from objconnect.localization.matching.sift import Sift
from objconnect.scene.bundle.georeference import EXACT_GEOREFERENCE as EXACT
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.checks.validate import validate
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.features import FeatureFile, Features, read_features, write_features
from objconnect.scene.maps.sparse_map import SparseMap
from tests.objconnect.ingestion.test_imported_poses import SESSION, geocentric, photographs_of

pytestmark = pytest.mark.usefixtures("extracted_once")

Ingested = tuple[Scene, IngestReport]
OLD = 8
THIRD_OF_A_PIXEL = 0.1  # m on the ground


def centres(scene: Scene) -> dict[str, np.ndarray]:
    """Camera centres (3,) by file name."""
    found = {}
    for session in scene.sessions:
        frames = scene.frames(session)
        there = frames.poses.centre().numpy()
        found |= {Path(name).name: xyz for name, xyz in zip(frames.names, there, strict=True)}
    return found


def some(folder: Path, files: Sequence[Path], *, exif: bool = True) -> Path:
    """A folder of some photographs, with their EXIF or without."""
    folder.mkdir()
    for path in files:
        if exif:
            shutil.copy(path, folder / path.name)
        else:
            with Image.open(path) as image:
                image.save(folder / path.name, quality=95, exif=b"")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def old(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of the first photographs of a rendered session, with their true poses."""
    folder = tmp_path_factory.mktemp("old")
    files = sorted(photographs_of(rendered).iterdir())[:OLD]
    export(rendered.path, "opensfm", folder / "given", [SESSION])
    poses = folder / "given" / "reconstruction.json"
    ingest(some(folder / "photos", files), folder / "scene", poses=poses, every=6)
    return folder / "scene"


def new_ones(rendered: Scene, folder: Path, *, exif: bool = True) -> Path:
    return some(folder, sorted(photographs_of(rendered).iterdir())[OLD:], exif=exif)


@pytest.fixture(scope="module")
def added(
    rendered: Scene, old: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, IngestReport]:
    """The old scene and the new photographs. Tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("added")
    report = ingest(new_ones(rendered, folder / "photos"), folder / "both", add=old)
    return Scene.open(folder / "both"), report


def require_unchanged(scene: Path, before: dict[str, bytes], kept: Scene) -> None:
    """The scene is as before, and its frames are in the other one bit by bit."""
    assert contents(scene) == before
    for name, content in before.items():
        if name.startswith("sessions/"):
            assert (kept.path / name).read_bytes() == content
    old_map, new_map = Scene.open(scene).sparse_map(), kept.sparse_map()
    for name, image in old_map.images.items():
        assert np.array_equal(new_map.images[name].cam_from_world, image.cam_from_world)
        assert new_map.images[name].camera == image.camera
    ours, theirs = tracks(new_map), tracks(old_map)
    untouched = [track for track in ours if all(name in old_map.images for name, _ in track)]
    assert untouched
    for track in untouched:
        np.testing.assert_array_equal(ours[track], theirs[track])


def test_features_of_the_map_are_those_that_localizers_would_extract(
    rendered: Scene, old: Path, added: tuple[Scene, IngestReport], tmp_path: Path
) -> None:
    """So that they need not, also once photographs are added; not where the old are unknown."""
    for path in (old, added[0].path):
        scene = Scene.open(path)
        sift, sparse_map = Sift(SiftOptions().max_features), scene.sparse_map()
        kept = map_features(MapCache.of(sparse_map, scene.images_root, tmp_path / "cache"), sift)
        assert isinstance(kept, FeatureFile) and kept.path == sparse_map.features
        name = sparse_map.names[-1]
        fresh = sift.extract_photographs(scene.images_root, [name], lambda _: None)[name]
        np.testing.assert_array_equal(kept[name].xy, fresh.xy)
        np.testing.assert_array_equal(kept[name].descriptors, fresh.descriptors)
    shutil.copytree(old, tmp_path / "unknown")
    features = tmp_path / "unknown" / "map" / "features.h5"
    write_features(features, read_features(features))
    finish_scene(tmp_path / "unknown", Scene.open(old).manifest)
    photos = new_ones(rendered, tmp_path / "photos")
    ingest(photos, tmp_path / "other", add=tmp_path / "unknown")
    assert FeatureFile(tmp_path / "other" / "map" / "features.h5").inputs_digest == ""


def tracks(sparse_map: SparseMap) -> dict[tuple[tuple[str, int], ...], np.ndarray]:
    """Places (3,) of points by their observations: photographs and numbers of keypoints."""
    found: dict[int, list[tuple[str, int]]] = {}
    for name in sparse_map.names:
        rows = sparse_map.images[name].point_rows
        for keypoint in np.flatnonzero(rows >= 0).tolist():
            found.setdefault(int(rows[keypoint]), []).append((name, keypoint))
    return {tuple(track): sparse_map.xyz[row] for row, track in found.items()}


@pytest.mark.parametrize("exif", [pytest.param(True, marks=pytest.mark.thorough), False])
def test_new_photographs_stand_where_they_were_taken(
    rendered: Scene, old: Path, tmp_path: Path, exif: bool
) -> None:
    """To a third of a pixel of the truth: with GPS and a lens that the map knows, and by matches
    alone, with a calibration."""
    before, origin = contents(old), Scene.open(old).manifest.origin
    camera = None if exif else rendered.frames(SESSION).cameras[0]
    photos = new_ones(rendered, tmp_path / "photos", exif=exif)
    report = ingest(photos, tmp_path / "both", add=old, camera=camera)
    assert (report.photographs, report.registered, report.left_out) == (4, 4, {})
    assert (report.kept, report.level) == (OLD, "map")
    assert (report.gps is not None) == exif
    assert "4 of 4 new photographs registered in a scene of 8" in report.text()
    both = Scene.open(tmp_path / "both")
    require_unchanged(old, before, both)
    assert both.manifest.origin == origin
    assert tuple(both.sessions) == ("flight", "flight-2")
    made, truth = geocentric(both, "flight-2"), geocentric(rendered, SESSION)
    assert len(made) == 4
    for name, pose in made.items():
        assert np.linalg.norm(pose[:, 3] - truth[name][:, 3]) < THIRD_OF_A_PIXEL
    mapped = {name for name in both.sparse_map().images if name.startswith("flight-2/")}
    assert mapped == set(both.splits.map) - set(Scene.open(old).splits.map)
    assert both.splits.queries["flight-2"] == ("flight-2/images/000010.jpg",)
    assert (report.map_images, report.queries) == (len(both.splits.map), 1 + 1)
    assert report.map_points > len(Scene.open(old).sparse_map().xyz)
    checked = validate(both.path)
    assert checked.ok, checked.text()
    assert both.find_changed_files() == []
    (dataset,) = open_datasets(both.path)
    assert len(dataset.queries) == report.queries


def test_covisibility_of_old_and_new(
    rendered: Scene, old: Path, added: tuple[Scene, IngestReport]
) -> None:
    """The shares among old frames are as before, and those of new ones are near the true ones."""
    before, both = Scene.open(old).covisibility, added[0].covisibility
    assert both.names[:OLD] == before.names
    assert np.array_equal(both.overlap[:OLD, :OLD], before.overlap)
    names = [f"{SESSION}/images/{Path(name).name}" for name in both.names]
    off = np.abs(both.overlap - rendered.covisibility.select(names).overlap)
    assert off[OLD:].mean() < 1.5 * off[:OLD, :OLD].mean()
    assert off[:, OLD:].mean() < 1.5 * off[:OLD, :OLD].mean()


def test_what_is_there_is_not_added_again(rendered: Scene, old: Path, tmp_path: Path) -> None:
    """Photographs of the first flight in the folder of the second are listed; a scene can be added
    to twice, and names may be those of the first flight."""
    files = sorted(photographs_of(rendered).iterdir())
    photos = some(tmp_path / "photos", files[6:10])
    shutil.move(photos / files[9].name, photos / files[0].name)
    report = ingest(photos, tmp_path / "both", add=old, split="none")
    assert report.left_out == {
        path.name: f"already in the scene as {path.name}" for path in files[6:8]
    }
    assert report.registered == 2
    again = some(tmp_path / "again", files[9:])
    report = ingest(again, tmp_path / "three", add=tmp_path / "both", split="none")
    assert report.left_out == {files[9].name: f"already in the scene as {files[0].name}"}
    three = Scene.open(tmp_path / "three")
    assert {name: len(three.frames(name)) for name in three.sessions} == {
        "flight": 8,
        "flight-2": 2,
        "flight-3": 2,
    }
    truth = geocentric(rendered, SESSION)
    pose = geocentric(three, "flight-2")[files[0].name]
    assert np.linalg.norm(pose[:, 3] - truth[files[9].name][:, 3]) < THIRD_OF_A_PIXEL
    with pytest.raises(InputError, match=r"none of the 4 photographs can be added .* is already"):
        ingest(photos, tmp_path / "four", add=tmp_path / "three")
    assert not (tmp_path / "four").exists()


def test_an_interrupted_addition_goes_on(
    rendered: Scene,
    old: Path,
    added: tuple[Scene, IngestReport],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Features of the map are never extracted, those of new photographs once; the old scene is
    whole after the interruption."""
    before = contents(old)
    photos, out = new_ones(rendered, tmp_path / "photos"), tmp_path / "both"
    extract, match = (
        objconnect.scene.colmap.database.extract_sift,
        objconnect.scene.colmap.database.match,
    )
    extracted: list[str] = []
    matched = 0

    def note(root: Path, names: Sequence[str], *rest: Any, **options: Any) -> Any:
        extracted.extend(names)
        return extract(root, names, *rest, **options)

    def kill(*args: Any) -> Any:
        nonlocal matched
        matched += 1
        if matched == 3:
            raise KeyboardInterrupt
        return match(*args)

    monkeypatch.setattr(objconnect.scene.colmap.database, "extract_sift", note)
    with monkeypatch.context() as patch:
        patch.setattr(objconnect.scene.colmap.database, "match", kill)
        with pytest.raises(KeyboardInterrupt):
            ingest(photos, out, add=old)
    assert contents(old) == before
    with pytest.raises(InputError, match="not a finished scene"):
        Scene.open(out)
    with pytest.raises(InputError, match="unfinished scene of other photographs or options"):
        ingest(photos, out, add=old, every=2)
    report = ingest(photos, out, add=old)
    assert sorted(extracted) == [
        f"flight-2/images/{path.name}" for path in sorted(photos.iterdir())
    ]
    assert ingest(photos, out, add=old) == report
    at_once, expected = added
    assert report == expected
    first, second = Scene.open(out).manifest, at_once.manifest
    assert first.sha256["map/points3D.bin"] == second.sha256["map/points3D.bin"]
    assert not list(out.glob(".*"))


def test_photographs_of_elsewhere_are_refused(old: Path, tmp_path: Path) -> None:
    """No overlap: one line, nothing is left of the new scene, and the old one is whole."""
    before = contents(old)
    (tmp_path / "photos").mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    Image.fromarray(noise).resize((320, 213)).save(tmp_path / "photos" / "elsewhere.jpg")
    arguments = ["ingest", str(tmp_path / "photos"), "--add", str(old)]
    answer = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "both")])
    assert answer.exit_code == 2
    assert "none of the 1 new photographs could be registered" in answer.stderr
    assert not (tmp_path / "both").exists()
    assert contents(old) == before


def test_one_of_another_camera_and_one_of_elsewhere(
    rendered: Scene, old: Path, tmp_path: Path
) -> None:
    """A larger picture of a camera that nobody knows is registered, and its focal length, guessed
    39 % too long, found as well as flat ground allows; a photograph of another place is left out
    and listed."""
    photos = new_ones(rendered, tmp_path / "photos", exif=False)
    size = rendered.frames(SESSION).cameras[0]
    for path in photos.iterdir():
        with Image.open(path) as image:
            larger = image.resize(
                (size.width * 5 // 4, size.height * 5 // 4), Image.Resampling.LANCZOS
            )
        larger.save(path, quality=95)
    noise = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    Image.fromarray(noise).resize((320, 213)).save(photos / "elsewhere.jpg")
    report = ingest(photos, tmp_path / "both", add=old, split="none")
    assert report.left_out == {"elsewhere.jpg": "not registered: too few matches"}
    both = Scene.open(tmp_path / "both")
    cameras = set(both.frames("flight-2").cameras)
    assert len(cameras) == 1
    camera = cameras.pop()
    assert (camera.model, camera.width) == ("SIMPLE_RADIAL", size.width * 5 // 4)
    assert camera.focal[0] == pytest.approx(size.focal[0] * 1.25, rel=0.1)
    assert not (both.images_root / "flight-2" / "images" / "elsewhere.jpg").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mapper": "global"}, "leave out --poses, --poses-frame, --gcp, --gcp-check and --mapper"),
        ({"checks": ("A",)}, "leave out --poses, --poses-frame, --gcp, --gcp-check and --mapper"),
        (
            {"camera": Camera("PINHOLE", 400, 100, (300.0, 300.0, 200.0, 50.0))},
            "of the same aspect ratio",
        ),
    ],
)
def test_options_that_do_not_go_with_it(
    rendered: Scene, old: Path, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    photos = new_ones(rendered, tmp_path / "photos")
    with pytest.raises(InputError, match=message):
        ingest(photos, tmp_path / "both", add=old, **options)
    assert not (tmp_path / "both").exists()


def test_scenes_that_cannot_be_added_to(rendered: Scene, old: Path, tmp_path: Path) -> None:
    photos = new_ones(rendered, tmp_path / "photos")
    with pytest.raises(InputError, match="does not exist"):
        ingest(photos, tmp_path / "both", add=tmp_path / "none")
    with pytest.raises(InputError, match="choose a folder outside it"):
        ingest(photos, old, add=old)
    with pytest.raises(InputError, match="choose a folder outside it"):
        ingest(photos, old / "more", add=old)
    copy = Path(shutil.copytree(old, tmp_path / "copy"))
    picture = copy / "sessions" / "flight" / "images" / "000001.jpg"
    picture.write_bytes(picture.read_bytes() + b"0")
    with pytest.raises(InputError, match="000001.jpg was changed or removed since"):
        ingest(photos, tmp_path / "both", add=copy)
    shutil.rmtree(copy / "map")
    with pytest.raises(InputError, match="has no map yet"):
        ingest(photos, tmp_path / "both", add=copy)
    assert not (tmp_path / "both").exists()


@pytest.mark.thorough
def test_a_rendered_scene_can_be_added_to(rendered: Scene, old: Path, tmp_path: Path) -> None:
    """Its other sessions, their layers and objects come along."""
    assert sorted(path.name for path in photographs_of(rendered).iterdir())[0] == "000000.jpg"
    photos = new_ones(rendered, tmp_path / "photos")
    for path in photos.iterdir():  # other bytes, the same place
        with Image.open(path) as image:
            image.save(path, quality=90, exif=image.getexif())
    ingest(photos, tmp_path / "both", add=rendered.path, split="none")
    both = Scene.open(tmp_path / "both")
    assert tuple(both.sessions) == (*rendered.sessions, "flight")
    assert both.objects == rendered.objects
    assert both.manifest.effective_georeference == rendered.manifest.effective_georeference == EXACT
    made, truth = geocentric(both, "flight"), geocentric(rendered, SESSION)
    for name, pose in made.items():
        assert np.linalg.norm(pose[:, 3] - truth[name][:, 3]) < THIRD_OF_A_PIXEL
    checked = validate(both.path)
    assert checked.ok, checked.text()


def test_photographs_look_alike_by_their_largest_features() -> None:
    """A photograph without a position shares features with two of three others."""
    random = np.random.default_rng(0)

    def features(rows: np.ndarray) -> Features:
        count = len(rows)
        return Features(np.zeros((count, 2), np.float32), np.ones(count, np.float32), rows)

    ground = random.integers(0, 255, (60, 128), np.uint8)
    other = random.integers(0, 255, (60, 128), np.uint8)
    found = {
        "a": features(ground[:40]),
        "b": features(other),
        "c": features(ground[30:]),
        "new": features(ground),
    }
    chosen = choose_similar(["new"], ["a", "b", "c"], found, IngestOptions(nearest=2))
    assert chosen == [("a", "new"), ("c", "new")]
    nearest = choose_similar(["new"], ["a", "b", "c"], found, IngestOptions(nearest=1))
    assert nearest == [("a", "new")]


def align(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> dict[str, float]:
    """Distances (m) after the best similarity of all common centres."""
    names = sorted(ours.keys() & theirs.keys())
    a, b = (np.array([found[name] for name in names]) for found in (ours, theirs))
    a, b = a - a.mean(0), b - b.mean(0)
    u, singular, v = np.linalg.svd(a.T @ b)
    scale = singular.sum() / (a**2).sum()
    return dict(zip(names, np.linalg.norm(scale * a @ u @ v - b, axis=1), strict=True))


@pytest.mark.thorough
def test_a_real_flight_in_two_parts(photographs: Path, ingested: Ingested, tmp_path: Path) -> None:
    """Photographs of a flight's end are added to a scene of its beginning, and stand where they
    stand in a scene of the whole, to centimetres where the two overlap. The pilot turned some of
    them by 180 degrees: the gimbal tells."""
    files = sorted(photographs.iterdir())
    late = files[10:14]
    ingest(some(tmp_path / "early", [*files[:10], *files[14:]]), tmp_path / "scene")
    report = ingest(some(tmp_path / "late", late), tmp_path / "both", add=tmp_path / "scene")
    assert report.registered == 4
    turned = {path.name for path in late} & set(ingested[1].turned)
    assert set(report.turned) == turned
    assert report.wrong_attitudes == {}
    apart = align(centres(Scene.open(tmp_path / "both")), centres(ingested[0]))
    new: Collection[float] = [apart[path.name] for path in late]
    assert max(new) < 0.3
    before = Scene.open(tmp_path / "scene").manifest.effective_georeference
    assert (
        before is not None
        and Scene.open(tmp_path / "both").manifest.effective_georeference == before
    )
    assert validate(tmp_path / "both").ok
