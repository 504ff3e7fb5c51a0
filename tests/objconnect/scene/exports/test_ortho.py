"""Orthophotos and surface models of a scene, against the surface that its photographs show."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
import torch
from numpy.typing import NDArray

from objconnect.scene.bundle.frames import Frames, read_frames, write_frames
from objconnect.scene.bundle.manifest import Manifest, Objects, Session, Splits, write_json
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.exports.ortho import utm_of
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.maps.depth_files import write_array
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.exif import Exif, write_jpeg
from objconnect.scene.storage.images import read_rgb
from tests.objconnect.scene.geo.made_site import (
    HOUSE,
    ORIGIN,
    ROOF_M,
    cast,
    colour,
    down_from,
    height,
)

CAMERA = Camera("SIMPLE_RADIAL", 128, 128, (110.0, 64.0, 64.0, -0.02))
PLACES = [(x, y) for x in (-10.0, 0.0, 10.0) for y in (-10.0, 0.0, 10.0)]
PIXEL = 0.4


def write_site(path: Path) -> None:
    """A session of the map and one of a query in the dark, both with depth."""
    everything = np.full((len(PLACES), 4), np.nan)
    for session, brightness, up in (("map", 1.0, 35.0), ("night", 0.1, 30.0)):
        poses = np.array([down_from(x, y, up, 8.0) for x, y in PLACES])
        depths = []
        for k, pose in enumerate(poses):
            depth, points = cast(CAMERA, pose)
            # Waves shorter than pixels would be noise.
            rgb = brightness * colour(points[..., 0] / 8, points[..., 1] / 8)
            name = path / "sessions" / session / "images" / f"{k:06d}.jpg"
            write_jpeg(name, np.rint(rgb).astype(np.uint8), Exif(None, None), 98)
            depths.append(depth.astype(np.float32))
        frames = Frames(
            names=tuple(f"{session}/images/{k:06d}.jpg" for k in range(len(poses))),
            cameras=(CAMERA,) * len(poses),
            cam_from_world=poses,
            time=everything[:, 0],
            gps_prior=everything[:, :3],
            gps_sigma=everything[:, :3],
            attitude_prior=everything,
            attitude_sigma_deg=everything[:, 0],
        )
        layers = iter([{"depth": depth} for depth in depths])
        write_frames(path / "sessions" / session / "frames.h5", frames, ["depth"], layers)
    names = tuple(f"map/images/{k:06d}.jpg" for k in range(len(PLACES)))
    nights = tuple(name.replace("map", "night", 1) for name in names)
    write_json(path / "splits.json", Splits(map=names, queries={"night": nights}))
    write_json(path / "objects.json", Objects(classes={}, objects=()))
    sessions = {
        "map": Session(condition="summer-noon", flight="grid", role="map"),
        "night": Session(condition="summer-night", flight="grid", role="query"),
    }
    manifest = Manifest(
        versions={}, preset=None, seed=None, config={}, origin=ORIGIN, sessions=sessions, sha256={}
    )
    finish_scene(path, manifest)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ortho") / "site"
    write_site(path)
    return path


def read(folder: Path) -> tuple[NDArray[np.float64], ...]:
    """World points (N, 3), and colours (N, 3), of the pixels with data, by exact geodesy."""
    with rasterio.open(folder / "dsm.tif") as file:
        heights, transform, crs = file.read(1, masked=True), file.transform, file.crs
    with rasterio.open(folder / "orthophoto.tif") as file:
        assert (file.transform, file.crs) == (transform, crs)
        rgba = file.read()
    assert np.array_equal(rgba[3] > 0, ~heights.mask)
    rows, columns = np.nonzero(~heights.mask)
    east, north = transform @ (columns + 0.5, rows + 0.5)
    projection = Projection(crs.to_wkt())
    few = np.random.default_rng(0).permutation(len(rows))[:6000]
    world = [
        enu_from_geodetic(
            projection.to_geodetic(np.array([east[k], north[k], heights[rows[k], columns[k]]])),
            ORIGIN,
        )
        for k in few
    ]
    return np.array(world), rgba[:3, rows[few], columns[few]].T.astype(float)


def make_points(posed: list[PosedImage]) -> SparseMap:
    """A map of one point, without which none is read."""
    images = {
        i.name: MapImage(i.name, i.camera, i.cam_from_world, np.ones((1, 2)), np.zeros(1, int))
        for i in posed
    }
    return SparseMap(
        images, np.zeros((1, 3)), np.zeros((1, 3), np.uint8), np.zeros(1), np.full(1, len(posed))
    )


def far_from_walls(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    west, east, south, north = HOUSE
    x, y = points[:, 0], points[:, 1]
    off = np.maximum.reduce([west - x, x - east, south - y, y - north])
    return np.asarray(np.abs(off) > 1.5 * PIXEL)


@pytest.mark.parametrize("crs", [None, "EPSG:2056"])
def test_heights_and_colours_are_those_of_the_world(
    site: Path, tmp_path: Path, crs: str | None
) -> None:
    summary = export(site, "ortho", tmp_path / "out", resolution=PIXEL, crs=crs)
    assert summary["sessions"] == ["map", "night"]
    with rasterio.open(tmp_path / "out/dsm.tif") as file:
        assert file.res == (PIXEL, PIXEL)
        assert file.crs.to_epsg() == int((crs or "EPSG:32632")[5:])
    points, rgb = read(tmp_path / "out")
    clear = far_from_walls(points)
    off = points[:, 2] - height(points[:, 0], points[:, 1])
    assert np.abs(np.median(off[clear])) < 0.01
    assert np.percentile(np.abs(off[clear]), 95) < 0.05
    on_roof = clear & (points[:, 2] > 4)
    assert on_roof.sum() > 20 and np.abs(points[on_roof, 2] - ROOF_M).max() < 0.01
    # Those of the photographs of the map: those of the night are darker by far.
    truth = colour(points[:, 0] / 8, points[:, 1] / 8)
    assert np.percentile(np.abs(rgb[clear] - truth[clear]).max(1), 90) < 12


def test_a_session_without_map_frames_alone(site: Path, tmp_path: Path) -> None:
    export(site, "ortho", tmp_path / "out", ["night"], resolution=PIXEL)
    _, rgb = read(tmp_path / "out")
    assert rgb.mean() < 20


def test_a_pixel_is_that_of_the_photographs(site: Path, tmp_path: Path) -> None:
    export(site, "ortho", tmp_path / "out")
    with rasterio.open(tmp_path / "out/dsm.tif") as file:
        # 35 m above the hills with a focal length of 110 pixels, in two digits.
        assert file.res[0] == pytest.approx(35 / 110, rel=0.05)


def test_results_of_dense(site: Path, tmp_path: Path) -> None:
    """The same depth as a workspace of dense: two photographs, with undistorted names."""
    copy = tmp_path / "copy"
    shutil.copytree(site, copy)
    frames = read_frames(site / "sessions/map/frames.h5")
    posed = []
    for k in (3, 4):
        depth = cast(CAMERA, frames.cam_from_world[k])[0].astype(np.float32)
        name = frames.names[k]
        for root in ("images", "stereo/depth_maps"):
            (copy / "dense" / root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(site / "sessions" / name, copy / "dense/images" / name)
        write_array(copy / f"dense/stereo/depth_maps/{name}.geometric.bin", depth[None])
        posed.append(PosedImage(name, CAMERA, frames.cam_from_world[k]))
    (copy / "dense/sparse").mkdir()
    write_with_poses(posed, make_points(posed), copy / "dense/sparse")
    for session in ("map", "night"):
        path = copy / "sessions" / session / "frames.h5"
        write_frames(path, read_frames(path), (), iter([{}] * len(PLACES)))
    finish_scene(copy, Scene.open(copy).manifest)
    export(copy, "ortho", tmp_path / "out", resolution=PIXEL)
    points, _ = read(tmp_path / "out")
    off = points[:, 2] - height(points[:, 0], points[:, 1])
    assert np.percentile(np.abs(off[far_from_walls(points)]), 90) < 0.06
    shutil.rmtree(copy / "dense")
    with pytest.raises(InputError, match="have no depth: run 'objconnect dense"):
        export(copy, "ortho", tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"crs": "EPSG:4326"},
            "other units than metres: choose another system, such as EPSG:32632",
        ),
        ({"crs": "EPSG:0"}, "is not a coordinate reference system"),
        ({"resolution": 0.0001}, "choose a larger --resolution"),
        ({"colour": "red"}, "--colour is not an option of the format ortho"),
    ],
)
def test_what_cannot_be(
    site: Path, tmp_path: Path, options: dict[str, float | str], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        export(site, "ortho", tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_other_formats_have_no_resolution(site: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--resolution is not an option of the format tum"):
        export(site, "tum", tmp_path / "out", resolution=1.0)


def test_photographs_are_seen_again(site: Path, tmp_path: Path) -> None:
    """A pixel of the orthophoto has the colour that photographs show there."""
    export(site, "ortho", tmp_path / "out", resolution=PIXEL)
    points, rgb = read(tmp_path / "out")
    frames = read_frames(site / "sessions/map/frames.h5")
    pose = frames.cam_from_world[4]
    local = torch.from_numpy(points @ pose[:3, :3].T + pose[:3, 3])
    xy = CAMERA.project(local).xy
    seen = (CAMERA.contains(xy, 2).numpy()) & far_from_walls(points)
    photograph = read_rgb(site / "sessions" / frames.names[4])
    column, row = xy.numpy()[seen].astype(int).T
    off = np.abs(photograph[row, column].astype(float) - rgb[seen]).max(1)
    assert seen.sum() > 300 and np.median(off) < 6


def test_zones_of_utm() -> None:
    assert utm_of(Geodetic(60.0, 180.0, 0.0)) == "EPSG:32660"
    assert utm_of(Geodetic(-1.0, -180.0, 0.0)) == "EPSG:32701"
