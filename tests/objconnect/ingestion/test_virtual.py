"""Virtual views of an orthophoto, against the place that it was made of."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine
from typer.testing import CliRunner

from baselines.sift import SiftConfig, SiftLocalizer
from benchmark.cli import app
from objconnect.ingestion.virtual.command import photograph_orthophoto
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.ingestion.virtual.surface import Surface
from objconnect.mapping.build import build_map
from objconnect.scene.bundle.frames import dense_layers
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, geodetic_from_enu
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior, Query, Status
from tests.geoid import installed_geoid
from tests.objconnect.scene.geo.made_site import (
    HOUSE,
    ORIGIN,
    cast,
    colour,
    down_from,
    height,
    rasters,
)

CAMERA = Camera("PINHOLE", 200, 200, (180.0, 180.0, 100.0, 100.0))
SYSTEMS = ("EPSG:32632", "EPSG:2056")
VIEWS = ViewOptions(altitude=26, overlap=0.5, size=256)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path]]:
    """Orthophoto and surface model by reference system."""
    folder = tmp_path_factory.mktemp("rasters")
    return {crs: rasters(folder / crs[5:], crs) for crs in SYSTEMS}


@pytest.fixture(scope="module")
def mapped(
    files: dict[str, tuple[Path, Path]], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Scene]:
    """Makes the mapped scene of a system, with the origin that it chose itself, once."""

    @cache
    def scene(crs: str) -> Scene:
        out = tmp_path_factory.mktemp("maps") / crs[5:]
        photograph_orthophoto(*files[crs], out, options=VIEWS)
        build_map(out)
        return Scene.open(out)

    return scene


def surface(files: tuple[Path, Path]) -> Surface:
    ortho, dsm = Raster.open(files[0], "orthophoto"), Raster.open(files[1], "surface model")
    return Surface(ortho, dsm, 0.0, ORIGIN, ORIGIN.altitude - 5, ORIGIN.altitude + 7)


def clear_of_house(points: NDArray[np.float64], metres: float = 0.3) -> NDArray[np.bool_]:
    west, east, south, north = HOUSE
    x, y = points[..., 0], points[..., 1]
    off = np.maximum.reduce([west - x, x - east, south - y, y - north])
    return np.asarray(np.abs(off) > metres)


@pytest.mark.parametrize("tilt", [0.0, 35.0])
@pytest.mark.parametrize("crs", SYSTEMS)
def test_a_view_shows_the_place(files: dict[str, tuple[Path, Path]], crs: str, tilt: float) -> None:
    pose = down_from(3.0, -4.0 - 12 * (tilt > 0), 20.0, tilt)
    view = surface(files[crs]).render(CAMERA, pose, 100.0)
    depth, points = cast(CAMERA, pose)
    inside = (np.abs(points[..., :2]) < 19).all(-1) & clear_of_house(points)
    off = np.abs(view.depth - depth)[inside]
    # At the edges of the house a ray may pass, or meet, what is a pixel of the model wide.
    assert np.percentile(off, 97) < 0.01
    assert np.median(off) < 0.001
    truth = colour(points[..., 0], points[..., 1])
    unlike = np.abs(view.rgb - truth).max(-1)[inside]
    assert np.percentile(unlike[off < 0.01], 95) < 12


def test_where_nothing_is_known(files: dict[str, tuple[Path, Path]]) -> None:
    view = surface(files[SYSTEMS[0]]).render(CAMERA, down_from(20.0, 0.0, 20.0), 100.0)
    _, points = cast(CAMERA, down_from(20.0, 0.0, 20.0))
    assert 0.3 < view.coverage < 0.7
    assert (view.depth[points[..., 0] > 20.5] == 0).all()
    assert len(np.unique(view.rgb[view.depth == 0], axis=0)) == 1


def test_the_same_views_in_two_systems(files: dict[str, tuple[Path, Path]]) -> None:
    for pose in (down_from(0.0, 5.0, 25.0), down_from(-8.0, -14.0, 22.0, 30.0)):
        one, other = (surface(files[crs]).render(CAMERA, pose, 100.0) for crs in SYSTEMS)
        off = np.abs(one.depth - other.depth)[(one.depth > 0) & (other.depth > 0)]
        assert np.percentile(off, 97) < 0.01 and np.median(off) < 0.001


def test_scene_of_an_orthophoto(mapped: Callable[[str], Scene]) -> None:
    scene = mapped("EPSG:2056")
    assert scene.find_changed_files() == []
    assert scene.manifest.sessions["virtual"].condition == "orthophoto"
    frames = scene.frames("virtual")
    heights = frames.poses.centre().numpy()[:, 2]
    assert len(frames) == 9 and np.allclose(heights, 26, atol=3.5)
    sparse_map = scene.sparse_map()
    ground = [enu_from_geodetic(_geodetic(scene, xyz), ORIGIN) for xyz in sparse_map.xyz]
    points = np.array(ground)
    assert len(points) > 500
    off = points[:, 2] - height(points[:, 0], points[:, 1])
    assert np.abs(np.median(off)) < 0.02
    assert np.percentile(np.abs(off), 80) < 0.1


def _geodetic(scene: Scene, xyz: NDArray[np.float64]) -> Geodetic:
    return geodetic_from_enu(xyz, scene.manifest.origin)


@pytest.mark.thorough
def test_a_query_has_the_same_pose_in_two_systems(mapped: Callable[[str], Scene]) -> None:
    """To 1 cm, whatever grid the map's files are in: the query is the place's own, not a view."""
    camera = Camera("PINHOLE", 320, 320, (300.0, 300.0, 160.0, 160.0))
    pose = down_from(-3.0, 2.0, 22.0, 8.0)
    _, points = cast(camera, pose)
    photograph = np.rint(colour(points[..., 0], points[..., 1])).astype(np.uint8)
    truth = np.array([-3.0, 2.0, 22.0])
    found = []
    for crs in SYSTEMS:
        scene = mapped(crs)
        localizer = SiftLocalizer(SiftConfig())
        localizer.prepare(scene.sparse_map(), scene.images_root)
        place = geodetic_from_enu(truth, ORIGIN)
        prior = Prior(enu_from_geodetic(place, scene.manifest.origin), np.full(3, 10.0))
        estimate = localizer.localize(Query(f"{crs}.jpg", photograph, camera, prior))
        assert estimate.status is Status.OK
        assert estimate.cam_from_world is not None
        centre = Pose.centre(estimate.cam_from_world).numpy()
        found.append(enu_from_geodetic(_geodetic(scene, centre), ORIGIN))
    assert np.linalg.norm(found[0] - truth) < 0.05
    assert np.linalg.norm(found[0] - found[1]) < 0.01


def test_heights_above_sea_level(files: dict[str, tuple[Path, Path]], tmp_path: Path) -> None:
    """With an undulation of 48 m, the same heights lie 48 m higher above the ellipsoid."""
    few = ViewOptions(altitude=30, overlap=0.0, size=64)
    origins = []
    for undulation in (0.0, 48.0):
        out = tmp_path / f"{undulation:g}"
        photograph_orthophoto(*files[SYSTEMS[0]], out, undulation=undulation, options=few)
        origins.append(Scene.open(out).manifest.origin)
        with Scene.open(out).layers("virtual") as layers:
            depth = layers.read("depth", 0)
        assert np.median(depth[depth > 0]) == pytest.approx(30, abs=2)
    assert origins[1].altitude - origins[0].altitude == pytest.approx(48, abs=1e-3)


def test_oblique_views_look_to_four_sides(
    files: dict[str, tuple[Path, Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("objconnect.ingestion.virtual.command._MIN_COVERAGE", 0.8)
    options = ViewOptions(altitude=12, overlap=0.0, tilt=30, size=64)
    report = photograph_orthophoto(*files[SYSTEMS[0]], tmp_path / "out", options=options)
    axes = Scene.open(tmp_path / "out").frames("virtual").cam_from_world[:, 2, :3]
    downward = axes[:, 2] < -0.999
    assert 0 < downward.sum() < report.views == len(axes)
    assert np.allclose(axes[~downward, 2], -np.cos(np.deg2rad(30)))
    sides = {tuple(side) for side in np.sign(np.round(axes[~downward, :2], 6)).tolist()}
    assert sides <= {(1, 0), (-1, 0), (0, 1), (0, -1)} and len(sides) > 1
    # Views over the edge show less than they should.
    assert report.left_out > 0


def test_a_white_rim_is_told(files: dict[str, tuple[Path, Path]], tmp_path: Path) -> None:
    ortho, dsm = files[SYSTEMS[0]]
    with rasterio.open(ortho) as file:
        profile, values = file.profile, file.read()
    values[:, :80] = 255
    with rasterio.open(tmp_path / "white.tif", "w", **profile) as file:
        file.write(values)
    few = ViewOptions(altitude=30, overlap=0.0, size=64)
    report = photograph_orthophoto(tmp_path / "white.tif", dsm, tmp_path / "out", options=few)
    assert "% of the pixels are white, and white pixels lie at the edge" in report.notes[0]
    report = photograph_orthophoto(ortho, dsm, tmp_path / "plain", options=few)
    assert "white" not in report.text()


def test_what_cannot_be_photographed(files: dict[str, tuple[Path, Path]], tmp_path: Path) -> None:
    ortho, dsm = files[SYSTEMS[0]]
    elsewhere, far_dsm = _move(ortho, tmp_path / "o.tif"), _move(dsm, tmp_path / "d.tif")
    few = ViewOptions(altitude=5, overlap=0.95)
    cases = [
        (elsewhere, dsm, VIEWS, "do not overlap"),
        (ortho, far_dsm, VIEWS, "do not overlap"),
        (dsm, ortho, VIEWS, "orthophoto .*float32"),
        (ortho, ortho, VIEWS, "heights are one band"),
        (ortho, dsm, ViewOptions(altitude=9000), "choose a smaller --altitude"),
        (ortho, dsm, few.model_copy(update={"altitude": 0.05}), "choose a larger --altitude"),
        (ortho, tmp_path / "none.tif", VIEWS, "none.tif"),
    ]
    for colours, heights, options, says in cases:
        with pytest.raises(InputError, match=says):
            photograph_orthophoto(colours, heights, tmp_path / "out", options=options)
        assert not (tmp_path / "out").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty"):
        photograph_orthophoto(ortho, dsm, tmp_path / "mine")


def _move(path: Path, out: Path) -> Path:
    """The same raster 5 km further east."""
    with rasterio.open(path) as file:
        profile, values = file.profile, file.read()
    profile["transform"] = Affine.translation(5000, 0) @ profile["transform"]
    with rasterio.open(out, "w", **profile) as file:
        file.write(values)
    return out


def test_the_command_maps_an_orthophoto(
    files: dict[str, tuple[Path, Path]], tmp_path: Path
) -> None:
    ortho, dsm = files[SYSTEMS[0]]
    words = ["map", "--ortho", ortho, "--dsm", dsm, "--out", tmp_path / "out", "--json"]
    words += ["--altitude", "34", "--overlap", "0.4", "--georeference", "0.25"]
    words += ["--georeference-height", "0"]
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    scene = Scene.open(tmp_path / "out")
    assert summary["virtual"]["views"] == len(scene.frames("virtual")) == summary["registered"]
    assert summary["virtual"]["altitude_m"] == 34.0
    assert summary["points"] == len(scene.sparse_map().xyz) > 100
    stated = Georeference(horizontal_m=0.25, vertical_m=0, source="stated")
    assert scene.manifest.effective_georeference == stated


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "give the SCENE to map, or --ortho, --dsm and --out"),
        (["SCENE", "--dsm", "d.tif"], "--dsm describes the map of an orthophoto: give --ortho"),
        (["SCENE", "--tilt", "0"], "--tilt describes the map of an orthophoto"),
        (["--ortho", "o.tif", "--out", "x"], "--ortho needs --dsm and --out"),
        (["SCENE", "--ortho", "o.tif", "--dsm", "d.tif", "--out", "x"], "leave SCENE out"),
        (["SCENE", "--georeference", "0"], "--georeference describes the map of an orthophoto"),
        (
            ["--ortho", "o", "--dsm", "d", "--out", "x", "--georeference-height", "1"],
            "--georeference-height needs --georeference",
        ),
    ],
)
def test_what_the_command_refuses(words: list[str], says: str) -> None:
    result = CliRunner().invoke(app, ["map", *words])
    assert result.exit_code == 2
    assert says in result.stderr and len(result.stderr.splitlines()) == 1


def test_heights_above_the_geoid(files: dict[str, tuple[Path, Path]], tmp_path: Path) -> None:
    """A surface model above a geoid of 48.25 m gives the views of one above the ellipsoid."""
    ortho, dsm = files[SYSTEMS[0]]
    with rasterio.open(dsm) as file:
        profile, values = file.profile, file.read(1)
    profile["crs"] = "EPSG:32632+5773"
    with rasterio.open(tmp_path / "sea.tif", "w", **profile) as file:
        file.write(values - np.float32(48.25), 1)
    few = VIEWS.model_copy(update={"size": 64, "overlap": 0.0})
    with installed_geoid(tmp_path):
        photograph_orthophoto(ortho, dsm, tmp_path / "a", options=few)
        report = photograph_orthophoto(ortho, tmp_path / "sea.tif", tmp_path / "b", options=few)
        with pytest.raises(InputError, match="leave --undulation out"):
            photograph_orthophoto(ortho, tmp_path / "sea.tif", tmp_path / "c", undulation=48.0)
    assert report.notes == ()
    one, other = (Scene.open(tmp_path / name) for name in "ab")
    np.testing.assert_allclose(one.manifest.origin, other.manifest.origin, rtol=0, atol=2e-3)
    places = [scene.frames("virtual").poses.centre().numpy() for scene in (one, other)]
    np.testing.assert_allclose(*places, atol=0.01)
    depths = []
    for scene in (one, other):
        with dense_layers(scene.path / "sessions/virtual/frames.h5") as layers:
            depths.append(layers.read("depth", 0))
    assert (depths[0] > 0).any()
    assert np.median(np.abs(depths[0] - depths[1])) < 0.01
