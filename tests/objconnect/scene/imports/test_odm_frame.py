"""The frame of reconstruction.json: told by files, names and GPS, stated, or refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.imports.formats import read_foreign
from objconnect.scene.imports.poses import CoordinateFrame
from objconnect.scene.quantities.horizontal_axes import convergence, infer_axes, utm_zone
from tests.objconnect.scene.imports.made_models import (
    Truth,
    make_truth,
    move_of_odm,
    plain_project,
    project_points,
)
from tests.objconnect.scene.imports.test_imports import nerfstudio

LENS = {"projection_type": "brown", "width": 1200, "height": 900, "focal_x": 0.75, "focal_y": 0.75}


def shots_of(truth: Truth, matrices: Any, gps: bool) -> str:
    from tests.objconnect.scene.imports.made_models import _shots

    measured = truth.world_from_cam[:, :3, 3] if gps else None
    reference = dict(zip(("latitude", "longitude", "altitude"), truth.origin, strict=True))
    shots = _shots(truth, matrices, measured)
    return json.dumps([{"cameras": {"c": LENS}, "shots": shots, "reference_lla": reference}])


@pytest.fixture
def odm(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, Truth]:
    """A project of ODM at the edge of a zone, with every file it leaves."""
    truth = make_truth(np.random.default_rng(3))
    latitude = getattr(request, "param", 47.0)
    truth.origin = Geodetic(latitude, 11.9, 0.0)
    linear, shift, header = move_of_odm(truth.origin, 32)
    offset = np.floor(shift[:2]) - 3
    (tmp_path / "opensfm").mkdir()
    (tmp_path / "odm_georeferencing").mkdir()
    path = tmp_path / "opensfm" / "reconstruction.json"
    moved = project_points(truth.world_from_cam, linear, shift - [*offset, 0])
    path.write_text(shots_of(truth, moved, True))
    first = path.with_name("reconstruction.topocentric.json")
    first.write_text(shots_of(truth, truth.world_from_cam, True))
    coords = tmp_path / "odm_georeferencing" / "coords.txt"
    coords.write_text(f"{header}\n{offset[0]:.0f} {offset[1]:.0f}\n1 2 3\n")
    return path, truth


def assert_true(path: Path, truth: Truth, frame: CoordinateFrame | None = None) -> None:
    poses = read_foreign(path, frame)
    assert poses.origin == truth.origin
    np.testing.assert_allclose(poses.positions, truth.world_from_cam[:, :3, 3], atol=1e-3)
    turned = poses.cam_from_world[:, :3, :3] @ truth.world_from_cam[:, :3, :3]
    np.testing.assert_allclose(turned, np.tile(np.eye(3), (len(truth.names), 1, 1)), atol=1e-5)


@pytest.mark.parametrize("odm", [47.0, -35.0, 61.0], indirect=True)
@pytest.mark.parametrize("without", [[], ["first"], ["coords"]])
def test_both_files_of_odm_are_one_reconstruction(
    odm: tuple[Path, Truth], without: list[str]
) -> None:
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    assert_true(first, truth)
    if "first" in without:
        first.unlink()
    if "coords" in without:
        (path.parents[1] / "odm_georeferencing" / "coords.txt").unlink()
    assert_true(path, truth)


def test_a_projected_file_alone_is_refused(odm: tuple[Path, Truth], tmp_path: Path) -> None:
    path, _ = odm
    alone = tmp_path / "reconstruction.json"
    alone.write_text(path.read_text())
    (tmp_path / "odm_georeferencing" / "coords.txt").unlink()
    with pytest.raises(
        InputError, match=r"in a projected system according to gps_position \(turned by 2\.\d+"
    ):
        read_foreign(alone)
    with pytest.raises(InputError, match=r"gps_position .*, but topocentric .* --poses-frame"):
        read_foreign(alone, "topocentric")
    with pytest.raises(InputError, match=r"its offset is unknown: give .*coords\.txt"):
        read_foreign(alone, "projected")


def test_without_gps_the_frame_in_a_project_of_odm_is_stated(odm: tuple[Path, Truth]) -> None:
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    first.unlink()
    document = json.loads(path.read_text())
    for shot in document[0]["shots"].values():
        del shot["gps_position"]
    path.write_text(json.dumps(document))
    with pytest.raises(
        InputError, match=r"UTM zone 32N\) cannot be determined .* state --poses-frame"
    ):
        read_foreign(path)
    assert_true(path, truth, "projected")
    path.write_text(shots_of(truth, truth.world_from_cam, False))
    with pytest.raises(InputError, match="cannot be determined"):
        read_foreign(path)
    assert_true(path, truth, "topocentric")


@pytest.mark.parametrize(("made", "gps"), [("moved", True), ("first", True), ("first", False)])
def test_a_stated_frame_contradicts_what_the_files_show(
    odm: tuple[Path, Truth], made: str, gps: bool
) -> None:
    """With ODM's other file beside it, with coords.txt and GPS, and by its name."""
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    if made == "first":
        path.write_text(shots_of(truth, truth.world_from_cam, gps))
    frames: tuple[CoordinateFrame, CoordinateFrame] = ("topocentric", "projected")
    right, wrong = frames if made == "first" else frames[::-1]
    assert_true(path, truth, right)
    with pytest.raises(InputError, match=f"are {right} .*beside it, but {wrong} .*--poses-f"):
        read_foreign(path, wrong)
    with pytest.raises(InputError, match="topocentric according to its name, but projected"):
        read_foreign(first, "projected")
    first.unlink()
    if gps:
        with pytest.raises(InputError, match=f"{right} .* gps_position.*, but {wrong} .*--poses"):
            read_foreign(path, wrong)


@pytest.mark.parametrize("folder", ["opensfm", "photos"])
def test_the_project_of_plain_opensfm_tells_the_frame(
    odm: tuple[Path, Truth], tmp_path: Path, folder: str
) -> None:
    _, truth = odm
    path = tmp_path / "site" / folder / "reconstruction.json"
    path.parent.mkdir(parents=True)
    path.write_text(shots_of(truth, truth.world_from_cam, False))
    with pytest.raises(
        InputError, match=r"a UTM grid, such as zone 32\) cannot be determined \(gps_position"
    ):
        read_foreign(path)
    assert_true(path, truth, "topocentric")
    plain_project(path.parent)
    assert_true(path, truth)
    with pytest.raises(InputError, match="the OpenSfM project that holds it, but projected"):
        read_foreign(path, "projected")
    (path.parent / "image_list.txt").write_text("/datasets/project/images/a.jpg\n")
    with pytest.raises(InputError, match="cannot be determined"):
        read_foreign(path)


def test_a_frame_is_stated_of_a_file_that_leaves_it_open(
    odm: tuple[Path, Truth], tmp_path: Path
) -> None:
    path = odm[0]
    document = json.loads(path.read_text())
    del document[0]["reference_lla"]
    path.write_text(json.dumps(document))
    assert read_foreign(path).origin is None
    with pytest.raises(InputError, match="so GPS georegisters it: leave"):
        read_foreign(path, "projected")
    with pytest.raises(
        InputError, match=r"not a reconstruction\.json of ODM or OpenSfM: leave out"
    ):
        read_foreign(nerfstudio(tmp_path), "topocentric")


def test_the_files_of_odm_are_found_from_where_the_user_stands(
    odm: tuple[Path, Truth], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, truth = odm
    path.with_name("reconstruction.topocentric.json").unlink()
    (tmp_path / "link").symlink_to(path.parent)
    assert_true(tmp_path / "link" / path.name, truth)
    monkeypatch.chdir(path.parent)
    assert_true(Path(path.name), truth)


def test_a_name_that_contradicts_the_poses_is_refused(
    odm: tuple[Path, Truth], tmp_path: Path
) -> None:
    path, truth = odm
    project = tmp_path / "plain" / "opensfm"
    project.mkdir(parents=True)
    plain_project(project)
    document = json.loads(path.read_text())
    for shot in document[0]["shots"].values():
        del shot["gps_position"]
    moved = json.dumps(document)
    for name, says in (
        ("topocentric", r"to its name, but projected according to gps_position \(turned by 2"),
        (
            "geocoords",
            "projected according to its name, but topocentric according to the OpenSfM",
        ),
    ):
        file = project / f"reconstruction.{name}.json"
        file.write_text(path.read_text() if name == "topocentric" else moved)
        with pytest.raises(InputError, match=f"{says}.*: give OpenSfM's own file"):
            read_foreign(file)
        file.unlink()
    named = path.with_name("reconstruction.geocoords.json")
    named.write_text(moved)
    path.with_name("reconstruction.topocentric.json").unlink()
    assert_true(named, truth)


def test_two_places_of_one_reconstruction_are_refused(odm: tuple[Path, Truth]) -> None:
    path, truth = odm
    first = path.with_name("reconstruction.topocentric.json")
    same = first.read_text()
    truth.origin = Geodetic(47.001, 11.9, 0.0)
    first.write_text(shots_of(truth, truth.world_from_cam, True))
    for text in (path.read_text(), same):  # moved, and not
        path.write_text(text)
        with pytest.raises(InputError, match=r"reference_lla differs from that of .*topocentric"):
            read_foreign(path)


@pytest.mark.parametrize("origin", [Geodetic(0.0, 0.0, 0.0), Geodetic(0.0, 0.0, 2.0)])
def test_opensfm_without_gps_is_nowhere_on_earth(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, origin: Geodetic
) -> None:
    """Its world has any scale then; a scene of ours that is there says so itself."""
    truth = make_truth(np.random.default_rng(3))
    truth.origin = origin
    plain_project(tmp_path)
    path = tmp_path / "reconstruction.json"
    path.write_text(shots_of(truth, truth.world_from_cam, False))
    assert read_foreign(path).origin is None
    assert "reference_lla is 0, 0, OpenSfM's value without GPS" in caplog.text
    document = json.loads(path.read_text())
    document[0]["frame"] = "topocentric"
    path.write_text(json.dumps(document))
    assert_true(path, truth)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"focal_x": 3200.0, "focal_y": 3200.0}, "focal 3200 is not in units of"),
        ({"c_x": 0.7}, "c_x puts the principal point"),
        ({"c_y": 1500.0}, "c_y puts the principal point"),
    ],
)
def test_lenses_in_pixels_are_no_lenses_of_opensfm(
    odm: tuple[Path, Truth], keys: dict[str, float], says: str
) -> None:
    path = odm[0].with_name("reconstruction.topocentric.json")
    document = json.loads(path.read_text())
    for lens in document[0]["cameras"].values():
        lens.update(projection_type="brown", **keys)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=says):
        read_foreign(path)


def test_coordinates_of_export_geocoords_are_no_metres_from_here(
    odm: tuple[Path, Truth], tmp_path: Path
) -> None:
    _, truth = odm
    linear, shift, _ = move_of_odm(truth.origin, 32)
    path = tmp_path / "reconstruction.geocoords.json"
    (tmp_path / "odm_georeferencing" / "coords.txt").unlink()
    path.write_text(shots_of(truth, project_points(truth.world_from_cam, linear, shift), False))
    with pytest.raises(InputError, match="but in a projected system, as export_geocoords writes"):
        read_foreign(path)


def test_files_of_two_reconstructions_are_refused(odm: tuple[Path, Truth]) -> None:
    path, truth = odm
    other = make_truth(np.random.default_rng(4))
    other.names, other.origin = truth.names, truth.origin
    other.world_from_cam = np.resize(other.world_from_cam, truth.world_from_cam.shape)
    first = path.with_name("reconstruction.topocentric.json")
    first.write_text(shots_of(truth, other.world_from_cam, True))
    with pytest.raises(InputError, match="hold different reconstructions"):
        read_foreign(path)
    (path.parent / "reference_lla.json").write_text(
        '{"latitude": 47.1, "longitude": 11.9, "altitude": 0}'
    )
    with pytest.raises(InputError, match="reference_lla differs from that of reference_lla.json"):
        read_foreign(path)


def test_the_turn_of_a_grid() -> None:
    """ODM's map turns axes by the convergence, on both sides of a zone and of the equator."""
    for latitude, longitude in ((47.0, 11.9), (47.0, 6.1), (-35.0, 11.9), (60.0, -179.5)):
        place = Geodetic(latitude, longitude, 0.0)
        linear, _, _ = move_of_odm(place, utm_zone(longitude))
        turn = np.arctan2(linear[1, 0], linear[0, 0])
        assert convergence(place, utm_zone(longitude)) == pytest.approx(turn, abs=2e-5)


def test_axes_that_positions_do_not_tell_are_unknown() -> None:
    rng = np.random.default_rng(1)
    gps = rng.uniform(-50, 50, (20, 2))
    cos, sin = np.cos(0.03), np.sin(0.03)
    turned = gps @ np.array([[cos, sin], [-sin, cos]]) + 7
    assert infer_axes(gps + 3, gps, 0.03).value == "east and north"
    assert infer_axes(turned, gps, 0.03).value == "grid"
    assert (
        infer_axes(turned, gps, -0.03).value == "grid"
        or not infer_axes(turned, gps, -0.03).is_known
    )
    assert not infer_axes(turned, gps + rng.normal(0, 9, gps.shape), 0.03).is_known
    assert not infer_axes(turned, np.full_like(gps, np.nan), 0.03).is_known
