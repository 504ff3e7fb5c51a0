"""The small folder tree of the misuse tests: intact files of every kind, built once."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import rasterio
import torch
from PIL import Image
from rasterio.transform import from_origin

from benchmark.publishing.command import publish
from benchmark.tracks.description import TRACKS_FOLDER, Track, TrackPlace, write_track
from objconnect.learning.checkpoint import write_weights
from objconnect.learning.training.command import _identity
from objconnect.learning.training.config import TrainConfig
from objconnect.network import network as objconnect
from objconnect.network.config import ObjConnectNetConfig
from objconnect.scene.bundle.covisibility import Covisibility, write_covisibility
from objconnect.scene.bundle.frames import write_frames
from objconnect.scene.bundle.manifest import Objects, SceneObject, write_json
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.bundle.supplement import AddedPoint, Supplement
from objconnect.scene.config import load_config
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.rasters import Grid, Patch, raster_writer
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu
from objconnect.scene.maps.features import Features, write_features
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.exif import Exif
from objconnect.scene.storage.exif import write_jpeg as write_photograph
from tests.benchmark.made_data import (
    CAMERA,
    MAP_NAMES,
    QUERY_NAMES,
    pose_at,
    write_flight,
    write_jpeg,
    write_model,
    write_scene,
)
from tests.benchmark.report.board.made_board import write_board
from tests.benchmark.submissions.made_submission import TRACK, write_submission
from tests.robustness.fuzz.readers import CMU_NAME, CMU_QUERY, READERS
from tests.robustness.misuse.harness import run
from tests.simulate.test_qgroundcontrol import PLAN

TAKEN = datetime(2026, 6, 1, 12, tzinfo=UTC)
ORIGIN = Geodetic(47.0, 8.0, 400.0)


def make(root: Path) -> None:
    """Write everything that an argument of a command can name."""
    _mine(root / "mine")
    make_scene(root / "hamlet")
    publish([root / "hamlet"], root / "published")
    _grove(root / "hamlet", root / "grove")
    _meadow(root / "meadow")
    _photographs(root / "photos")
    READERS["videos"].make(root / "film")
    _cmu(root)
    (root / "rasters").mkdir()
    READERS["rasters"].make(root / "rasters")
    _pair(root / "pair")
    _site(root / "site")
    _tables(root / "tables")
    _configs(root / "configs")
    _masks(root / "masks", Scene.open(root / "hamlet").sparse_map().names)
    _weights(root / "weights")
    _results(root)
    _results_of_weights(root)
    write_board(root / "tracks", 2, [("town", 1)], ("pixloc", "sift"), ("none",))
    _board(root)
    shutil.copytree(TRACKS_FOLDER / TRACK, root / "small" / TRACK)
    write_submission(root / "submission")
    _run(root)


def copy(whole: Path, names: set[str], root: Path) -> None:
    """A copy, to spoil, of some of its folders."""
    for name in sorted(names):
        shutil.copytree(whole / name, root / name, symlinks=True)


def _mine(folder: Path) -> None:
    """The user's own, which is nobody's business."""
    folder.mkdir()
    (folder / "notes.txt").write_text("mine\n")
    (folder / ".snapshot.20261122").write_text("mine\n")


def make_scene(path: Path) -> Path:
    """A scene with all its lists."""
    write_scene(path)
    box = SceneObject(
        id=1, class_name="car", centre=(0, 0, 1), size=(4, 2, 1.5), yaw_deg=30, size_class="medium"
    )
    write_json(path / "objects.json", Objects(classes={"sky": 0, "car": 1}, objects=(box,)))
    scene = Scene.open(path)
    names = tuple(name for session in scene.sessions for name in scene.frames(session).names)
    overlap = np.full((len(names), len(names)), 0.6) - 0.6 * np.eye(len(names))
    write_covisibility(path / "covisibility.h5", Covisibility(names, overlap))
    rng = np.random.default_rng(0)
    features = {
        name: Features(
            rng.uniform(1, 60, (60, 2)).astype("f4"),
            np.ones(60, "f4"),
            rng.integers(0, 255, (60, 128), dtype=np.uint8),
        )
        for name in scene.splits.map
    }
    write_features(path / "map" / "features.h5", features)
    added = AddedPoint(id=60, object=0, confidence=0.5)
    digest = scene.sparse_map().drop_points(np.arange(60) == 59).sha256
    write_json(path / "map" / "supplement.json", Supplement(points=(added,), map_sha256=digest))
    # Like that of a simulated scene: two photographs of noise would show no square of a site.
    finish_scene(path, scene.manifest.model_copy(update={"config": {"area": 120.0}}))
    return path


def _grove(hamlet: Path, path: Path) -> None:
    """The same through a lens without distortion, to learn from."""
    shutil.copytree(hamlet, path, ignore=shutil.ignore_patterns("images", "map"))
    scene = Scene.open(path)
    focal, x, y, _ = CAMERA.params
    pinhole = Camera("PINHOLE", CAMERA.width, CAMERA.height, (focal, focal, x, y))
    for session in scene.sessions:
        frames = scene.frames(session)
        straight = replace(frames, cameras=(pinhole,) * len(frames))
        write_frames(path / "sessions" / session / "frames.h5", straight, (), iter([{}] * 9))
    finish_scene(path, scene.manifest)


def _cmu(root: Path) -> None:
    READERS["cmu"].make(root)
    part = root / "cmu" / "slice2"
    write_model(part / "sparse", {CMU_NAME: pose_at(0)}, points=600)
    write_jpeg(part / "database" / CMU_NAME, 1)
    write_jpeg(part / "query" / CMU_QUERY, 2)


def _meadow(path: Path) -> None:
    write_flight(path)
    declared = [f"{name},same-flight" for name in (*MAP_NAMES, *QUERY_NAMES)]
    (path / "conditions.csv").write_text("\n".join(["name,condition", *declared]) + "\n")
    (path / "origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 400.5}\n')


def _photographs(folder: Path) -> None:
    rng = np.random.default_rng(5)
    for k in range(3):
        position = geodetic_from_enu(np.array([4.0 * k, 0, 40]), ORIGIN)
        noise = rng.integers(0, 255, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
        folder.mkdir(exist_ok=True)
        write_photograph(
            folder / f"p{k}.jpg", noise, Exif(position, time=TAKEN, focal_35mm=30.0), 90
        )


def _site(folder: Path) -> None:
    """An orthophoto, a surface model and classes of a place that is just large enough."""
    folder.mkdir()
    grid = Grid(Projection("EPSG:32632"), 424_000.0, 5_205_650.0, (2.0, 2.0), 66, 66)
    grey = np.random.default_rng(0).uniform(60, 62, (3, 66, 66)).astype(np.float32)
    with raster_writer(folder / "ortho.tif", "orthophoto", grid) as put:
        put(Patch(grid, grey))
    with raster_writer(folder / "dsm.tif", "surface model", grid) as put:
        put(Patch(grid, 340 + grey[:1]))
    size = {"driver": "GTiff", "count": 1, "dtype": "uint8", "width": 66, "height": 66}
    place = from_origin(grid.left, grid.top, *grid.pixel)
    with rasterio.open(
        folder / "classes.tif", "w", crs="EPSG:32632", transform=place, **size
    ) as file:
        file.write(np.full((1, 66, 66), 4, np.uint8))


def _tables(folder: Path) -> None:
    folder.mkdir()
    lines = [pose_line(name, pose_at(k), 9) for k, name in enumerate(QUERY_NAMES)]
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    (folder / "homography.txt").write_text("1 0 0\n0 1 0\n0 0 1\n")
    pairs = [f"{name} a.jpg\n" for name in QUERY_NAMES]
    for session in ("summer-grid", "winter-grid"):
        pairs += [
            f"{session}/images/{k:06d}.jpg summer-nadir/images/000001.jpg\n" for k in range(3)
        ]
    (folder / "pairs.txt").write_text("".join(pairs))
    (folder / "slice-pairs.txt").write_text(f"{CMU_QUERY} {CMU_NAME}\n")
    rows = ["name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg"]
    rows += [f"p{k}.jpg,{4 * k},0,40,2,0,1,0,0,3.0" for k in range(3)]
    (folder / "priors.csv").write_text("\n".join(rows) + "\n")
    rows = ["name,lat,lon,alt", *(f"p{k}.jpg,47.000{k},8.0,430.0" for k in range(3))]
    (folder / "gps.csv").write_text("\n".join(rows) + "\n")
    places = [geodetic_from_enu(np.array([4.0 * k, 0, 40]), ORIGIN) for k in range(3)]
    rows = ["name,lat,lon,alt", *(f"p{k}.jpg,{a},{b},{c}" for k, (a, b, c) in enumerate(places))]
    (folder / "places.csv").write_text("\n".join(rows) + "\n")
    (folder / "reconstruction.json").write_text(json.dumps([_reconstruction()]))
    rows = ["EPSG:4326", *(f"8.00001 47.0 400 {40 + k} 30 p{k}.jpg A" for k in range(3))]
    rows += [f"8.00002 47.00001 400 {50 + k} 20 p{k}.jpg B" for k in range(3)]
    (folder / "gcp_list.txt").write_text("\n".join(rows) + "\n")


def _reconstruction() -> dict[str, object]:
    """The photographs' poses as ODM tells them: looking down, which is half a turn about east."""
    lens = {"projection_type": "perspective", "focal": 0.85, "k1": 0.0, "k2": 0.0}
    lens |= {"width": CAMERA.width, "height": CAMERA.height}
    shots = {
        f"p{k}.jpg": {
            "rotation": [np.pi, 0.0, 0.0],
            "translation": [-4.0 * k, 0.0, 40.0],
            "camera": "lens",
        }
        for k in range(3)
    }
    reference = {"latitude": 47.0, "longitude": 8.0, "altitude": 400.0}
    document: dict[str, object] = {"cameras": {"lens": lens}, "shots": shots}
    return document | {"reference_lla": reference, "frame": "topocentric"}


def _configs(folder: Path) -> None:
    READERS["configs"].make(_make(folder))
    (folder / "simulate.yaml").write_text("area: 120\nsize: 64\nspp: 1\nframes: 2\n")
    (folder / "train.yaml").write_text("steps: 1\nbatch: 1\nworkers: 0\nwidth: 0.02\n")
    (folder / "plan.yaml").write_text(
        "training: {steps: 1, batch: 1, workers: 0}\n"
        "variants: [{name: whole}, {name: none, network: {object_graph: false}}]\n"
    )
    (folder / "planned.yaml").write_text(
        "area: 120\nsize: 64\nspp: 1\norigin: {latitude: 47, longitude: 8, altitude: 400}\n"
    )
    (folder / "survey.plan").write_text(json.dumps(PLAN))


def _masks(folder: Path, names: tuple[str, ...]) -> None:
    """Two forms of one thing, for every photograph of the map."""
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[20:40, 20:50] = 1
    for name in names:
        path = folder / "labels" / Path(name).with_suffix(".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(labels).save(path)
    # Runs go down the columns, and begin with one of nothing.
    changes = np.flatnonzero(np.diff(labels.T.ravel().astype(int)))
    runs = np.diff([-1, *changes, labels.size - 1]).tolist()
    images = [{"id": k, "file_name": name} for k, name in enumerate(names)]
    size = [CAMERA.height, CAMERA.width]
    masks = [
        {"image_id": k, "segmentation": {"size": size, "counts": runs}} for k in range(len(names))
    ]
    (folder / "coco.json").write_text(json.dumps({"images": images, "annotations": masks}))


def _weights(folder: Path) -> None:
    torch.manual_seed(0)
    settings = {"width": 0.02, "pyramid": 8, "strides": [4], "dims": [8], "segments": 4}
    detector = {"stride": 4, "size": 4, "vector": 2}
    config = ObjConnectNetConfig.model_validate({**settings, "detector": detector})
    network = objconnect.ObjConnectNet(config)
    weights = _make(folder) / "net.safetensors"
    write_weights(weights, network, config.model_dump(mode="json"))
    weights.with_suffix(".md").write_text(f"# Weights of objconnect\n\n- {sha256_of(weights)}\n")


def _results(root: Path) -> None:
    """What the commands themselves write, beside a baseline of it."""
    out = ["--method", "sift", "--out", str(root / "results")]
    meadow, hamlet = str(root / "meadow"), str(root / "hamlet")
    for words in (
        ["evaluate", meadow, hamlet, *out],
        ["basin", meadow, *out, "--errors", "0m/0deg,3m/5deg"],
    ):
        done = run(words)
        assert done.code == 0, done.stderr
    shutil.copytree(root / "results", root / "baseline")


def _results_of_weights(root: Path) -> None:
    """Results as those of another method."""
    results = json.loads((root / "results/meadow/sift.json").read_text())
    results["method"]["weights_sha256"] = sha256_of(root / "weights/net.safetensors")
    path = root / "weighed" / "meadow" / "net.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(results))


def _pair(folder: Path) -> None:
    """An orthophoto large enough for the views of a map, and its surface model."""
    folder.mkdir()
    rng, projection = np.random.default_rng(0), Projection("EPSG:32632")
    side_m, corner = 188, (424_000.0, 5_205_650.0)
    fine = Grid(projection, *corner, (0.5, 0.5), 2 * side_m, 2 * side_m)
    with raster_writer(folder / "ortho.tif", "orthophoto", fine) as write:
        write(Patch(fine, rng.uniform(0, 255, (3, 2 * side_m, 2 * side_m)).astype(np.float32)))
    coarse = Grid(projection, *corner, (4.0, 4.0), side_m // 4, side_m // 4)
    with raster_writer(folder / "dsm.tif", "surface model", coarse) as write:
        write(Patch(coarse, rng.uniform(400, 409, (1, side_m // 4, side_m // 4)).astype("f4")))


def _board(root: Path) -> None:
    """A track to render, and one that records the data sets of the results."""
    made = {
        dataset: json.loads((root / "results" / dataset / "sift.json").read_text())["dataset"]
        for dataset in ("meadow", "hamlet")
    }
    places = tuple(
        TrackPlace(dataset=dataset, preset="town", seed=1, renders=(of["sha256"],))
        for dataset, of in made.items()
    )
    config = "board/tiny/place.yaml"
    lists = {"config": config, "starts": ("none",), "methods": ("sift",)}
    tiny = Track(name="tiny", title="Tiny", places=(places[0],), **lists)
    write_track(tiny, root / "board")
    write_track(tiny.model_copy(update={"name": "kept", "places": places}), root / "board")
    flown = TrackPlace(dataset="meadow", renders=places[0].renders)
    flights = Track(name="flown", title="Flown", places=(flown,), starts=("none",), methods=("a",))
    write_track(flights, root / "board")
    shutil.copytree(root / "meadow", root / "flown" / "meadow")
    (root / config).write_text("area: 120\nsize: 64\nspp: 1\nframes: 2\n")


def _run(root: Path) -> None:
    """A training that was begun."""
    config = load_config(TrainConfig, root / "configs" / "train.yaml", {})
    scenes = [_identity(Scene.open(root / "grove"))]
    run = {"config": config.model_dump(mode="json"), "method": "objconnect", "scenes": scenes}
    (_make(root / "run") / "run.json").write_text(json.dumps(run))


def _make(folder: Path) -> Path:
    folder.mkdir()
    return folder
