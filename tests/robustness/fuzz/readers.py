"""Every reader of files that may come from strangers, and small whole files for each."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from baselines.d2net import network as d2net
from baselines.d2net.network import D2NetNetConfig
from benchmark.datasets.cmu import open_cmu, open_slices
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.basin import load_basin
from benchmark.evaluation.starts import parse_start
from benchmark.publishing.command import publish
from benchmark.publishing.index import read_index
from benchmark.publishing.reader import QUERY_COLUMNS, frames_of
from benchmark.publishing.shards import read_shards
from benchmark.report.album import Album, Entry, Neighbour, read_album, write_album
from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from benchmark.tracks.compact import write_compact
from benchmark.tracks.description import Track
from benchmark.tracks.queries import read_queries
from benchmark.tracks.renders import Render, RenderedFrame, read_render, write_render
from objconnect.ingestion.control_points import read_control_points
from objconnect.ingestion.photographs import Flight, FlightImage, _read_image
from objconnect.ingestion.positions import _read as read_positions
from objconnect.ingestion.telemetry import read_telemetry
from objconnect.learning import pixloc_net as pixloc
from objconnect.learning.checkpoint import read_weights, write_weights
from objconnect.learning.pixloc_net import PixlocNetConfig
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import _claim, _log, _restore
from objconnect.localization.pipeline.journal import Journal
from objconnect.network import network as objconnect
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.masks import read_coco, read_label_png
from objconnect.scene.bundle.covisibility import Covisibility, read_covisibility, write_covisibility
from objconnect.scene.bundle.frames import LAYERS, dense_layers, read_frames, write_frames
from objconnect.scene.bundle.manifest import Objects, SceneObject, Surroundings, write_json
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.config import load_config
from objconnect.scene.flights.origin import read_origin
from objconnect.scene.flights.textfiles import (
    read_cameras,
    read_conditions,
    read_gps,
    read_poses,
    read_priors,
)
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geo.rasters import Box, Grid, Kind, Patch, Raster, raster_writer
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.imports.formats import read_foreign
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.depth_files import read_array, write_array
from objconnect.scene.maps.features import Features, read_features, write_features
from objconnect.scene.storage.exif import Exif
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.subtitles import Subtitle, compose_subtitles
from objconnect.scene.storage.video import decode_frames, write_video
from simulate.camera.lens import CameraConfig
from simulate.config import SimulateConfig
from simulate.flight.qgroundcontrol import read_plan
from tests.benchmark.made_data import CAMERA, pose_at, write_flight, write_model, write_scene
from tests.benchmark.report.board.made_board import write_board
from tests.objconnect.scene.bundle.test_frames import ALL, make_frames, make_layers
from tests.objconnect.scene.imports.test_imports import metashape as write_metashape
from tests.objconnect.scene.imports.test_imports import nerfstudio as write_nerfstudio
from tests.objconnect.scene.imports.test_imports import opensfm as write_opensfm
from tests.simulate.test_qgroundcontrol import PLAN, item, plan_of, survey, waypoint

ROOT = Path(__file__).parents[3]
SEED_PHOTOGRAPH = ROOT / "benchmark/gate/gate/images/map/images/000000.jpg"


Read = Callable[[Path], object]


@dataclass(frozen=True)
class Reader:
    """What is read, and from what.

    Attributes:
        make: writes whole files into an empty folder.
        files: those of the folder that are spoiled: the kind of their mutation, and what reads
            them, given the folder.
        share: of the inputs, in parts.
    """

    make: Callable[[Path], object]
    files: Mapping[str, tuple[str, Read]]
    share: float = 1.0


def each(names: Iterable[str], kind: str, read: Read) -> dict[str, tuple[str, Read]]:
    """Several files that are read together."""
    return dict.fromkeys(names, (kind, read))


def _scene(folder: Path) -> None:
    """A scene of which every list is read, as evaluate reads it."""
    scene = write_scene(folder / "scene")
    box = SceneObject(
        id=1, class_name="car", centre=(0, 0, 1), size=(4, 2, 1.5), yaw_deg=30, size_class="medium"
    )
    part = Surroundings(name="urban", outline=((0, 0), (9, 0), (9, 9)))
    objects = Objects(classes={"sky": 0, "car": 1}, objects=(box,), surroundings=(part,))
    write_json(scene / "objects.json", objects)


def _read_scene(folder: Path) -> None:
    scene = Scene.open(folder / "scene")
    scene.objects.surroundings_at(np.zeros((2, 3)))
    scene.find_changed_files()
    for dataset in open_datasets(folder / "scene"):
        dataset.load_map()
        for query in dataset.queries:
            query.load(query.prior)


def _published(folder: Path) -> None:
    """A published scene, and its queries, which no digest protects."""
    scene = write_scene(folder / "scene")
    publish([scene], folder / "published")
    shutil.move(folder / "published/data/scene/query-00000.parquet", folder / "rows-00000.parquet")
    shutil.rmtree(scene)


def _read_rows(folder: Path) -> None:
    rows = list(read_shards([folder / "rows-00000.parquet"], (*QUERY_COLUMNS, "image")))
    frames_of(folder, rows)


def _flight(folder: Path) -> None:
    write_flight(folder / "flight")
    (folder / "flight/origin.json").write_text('{"lat": 47.0, "lon": 8.0, "alt": 420.5}')


def _read_flight(folder: Path) -> None:
    read_origin(folder / "flight")
    for dataset in open_datasets(folder / "flight"):
        for query in dataset.queries:
            query.load(query.prior)


def _model(folder: Path) -> None:
    write_model(folder / "map", {f"{k}.jpg": pose_at(k) for k in range(3)}, points=5)


def _frames(folder: Path) -> None:
    write_frames(folder / "f.h5", make_frames(3), ALL, (make_layers(k) for k in range(3)))


def _read_frames(folder: Path) -> None:
    frames = read_frames(folder / "f.h5")
    with dense_layers(folder / "f.h5") as layers:
        for k in range(min(len(frames), 3)):
            for layer in LAYERS:
                layers.read(layer, k)


def _covisibility(folder: Path) -> None:
    overlap = np.array([[0, 0.4, 0.2], [0.5, 0, 0.1], [0.3, 0.2, 0]])
    write_covisibility(folder / "c.h5", Covisibility(("a", "b", "c"), overlap))


def _features(folder: Path) -> None:
    rng = np.random.default_rng(0)
    features = {
        f"s/images/{k}.jpg": Features(
            rng.uniform(0, 99, (7, 2)).astype("f4"),
            np.ones(7, "f4"),
            rng.integers(0, 255, (7, 128), dtype=np.uint8),
        )
        for k in range(2)
    }
    write_features(folder / "f.h5", features)


def _configs(folder: Path) -> None:
    shutil.copyfile(ROOT / "simulate/configs/demo.yaml", folder / "simulate.yaml")
    shutil.copyfile(ROOT / "benchmark/tracks/uav-seasons/track.yaml", folder / "track.yaml")
    (folder / "train.yaml").write_text(
        "steps: 20\nbatch: 2\nrate: 1.0e-3\nphotographs: [a, b]\nnetwork: {strides: [8, 2]}\n"
    )
    (folder / "camera.yaml").write_text(
        "model: OPENCV\nwidth: 640\nheight: 480\nparams: [500, 500, 320, 240, -0.1, 0.01, 0, 0]\n"
    )


def _results(folder: Path) -> None:
    gate = load(ROOT / "tests/data/gate-baseline/gate/sift.json")
    few = Results.of(gate.method, gate.dataset, gate.start, gate.queries[:3], 1.5, 99.0)
    few.write(folder / "results.json")
    frame = RenderedFrame(
        name="a.jpg", camera="PINHOLE", cam_from_world=(1.0,) * 12, blocks=(99.0,) * 64
    )
    write_render(folder / "render.json.xz", Render(frames=(frame,), map_points=9))
    write_compact(folder / "results.json.xz", few)
    results = json.loads((folder / "results.json").read_text())
    level = {"prior_t_m": 1, "prior_r_deg": 2, "queries": 9, "failed": 1, "fallback": 0}
    level["correct"] = {"0.25m_2deg": 1, "0.5m_5deg": 2, "5m_10deg": 3}  # type: ignore[assignment]
    basin = {"schema": 1, "seed": 0, "levels": [level, level]}
    basin |= {key: results[key] for key in ("method", "dataset", "environment")}
    (folder / "basin.json").write_text(json.dumps(basin))
    lines = ['{"key": "k"}', *(json.dumps(query) for query in results["queries"])]
    (folder / "journal").write_text("\n".join(lines) + "\n")


def _read_journal(folder: Path) -> None:
    with Journal(folder / "journal", "k", QueryResult):
        pass


def _track(folder: Path) -> None:
    write_board(folder / "tracks", 2, [("town", 1)], ("sift",), ("none",))


def _tables(folder: Path) -> None:
    write_flight(folder / "flight")
    for name in ("queries.txt", "reference_poses.txt", "gps.csv"):
        shutil.move(folder / "flight" / name, folder / name)
    shutil.rmtree(folder / "flight")
    shutil.copyfile(ROOT / "benchmark/gate/gate/priors.csv", folder / "priors.csv")
    (folder / "positions.csv").write_text("name,lat,lon,alt\na.jpg,47.1,8.1,420\nb.jpg,47,8,1\n")
    (folder / "conditions.csv").write_text("name,condition\na.jpg,summer-noon\nb.jpg,winter\n")
    (folder / "pairs.txt").write_text("# pairs\nb.jpg a.jpg\nb.jpg c.jpg\n")
    (folder / "gcp_list.txt").write_text(
        "WGS84 UTM 32N\n500000 5200000 431.5 100 200 a.jpg corner\n500010 5200000 430 1 2 b.jpg\n"
    )


def _read_control(path: Path) -> None:
    images = [
        FlightImage(name, f"flight/images/{name}", name, Exif(None, None), (4000, 3000))
        for name in ("a.jpg", "b.jpg")
    ]
    read_control_points(path, Flight(tuple(images), {}), 1600)


def _foreign(folder: Path) -> None:
    write_metashape(folder, "<k1>-0.1</k1><k2>0.02</k2><k3>-0.006</k3>")
    write_nerfstudio(folder)
    write_opensfm(folder, focal=0.8, k1=-0.1)
    entry = '"id":0,"img_name":"a","position":[1,2,50],"rotation":[[1,0,0],[0,-1,0],[0,0,-1]]'
    (folder / "cameras.json").write_text(f"[{{{entry}}}]")
    (folder / "tum.txt").write_text("# comment\n1.5 1 2 3 1 0 0 0\n2.5 1 2 4 0 0 0 1\n")
    (folder / "places.csv").write_text("name,lat,lon,alt\na.jpg,47.1,8.1,420\nb.jpg,47,8,1\n")


def _photographs(folder: Path) -> None:
    (folder / "photos").mkdir()
    with Image.open(SEED_PHOTOGRAPH) as image:
        exif = image.info["exif"]
        small = image.resize((24, 18))
    xmp = (
        b'<x drone-dji:GimbalYawDegree="+12.3" a:GimbalPitchDegree="-90.0" GimbalRollDegree="0" '
        b'RtkFlag="50" RtkStdLon="0.01" RtkStdLat="0.01" AbsoluteAltitude="+400" '
        b'DewarpData="2018-03-13;20,20,0.5,0.5,-0.27,0.12,0,0,-0.04"><RtkStdHgt>0.02</RtkStdHgt></x>'
    )
    for name in ("a.jpg", "b.jpg"):
        small.save(folder / "photos" / name, exif=exif, xmp=xmp)


def _videos(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    noise = np.random.default_rng(6).integers(0, 256, (4, CAMERA.height, CAMERA.width, 3))
    write_video(folder / "flight.mp4", list(noise.astype(np.uint8)), 2.0)
    fields = "[latitude: 47.0001] [longitude: 8.0001] [rel_alt: 40.0 abs_alt: 440.0]"
    texts = (
        f"2024-03-08 10:12:34.123\n{fields} [gb_yaw: 9.0 gb_pitch: -90.0 gb_roll: 0.0]",
        "HOME(8.5410,47.3770) 2017.8.5 14:11:51\nGPS(8.5411,47.3771,16) BAROMETER:60.1",
        "GPS(W: 97.621475, S: 30.214199, 174.21m)",
        "F/6.3, RTK (8.5, 47.3, 28), H 76.19m, G.PRY (-40.0°, 0.5°, 28.2°)",
    )
    said = [Subtitle(k / 2, (k + 1) / 2, text) for k, text in enumerate(texts)]
    (folder / "telemetry.srt").write_text(compose_subtitles(said), "utf-8")


def _masks(folder: Path) -> None:
    labels = np.random.default_rng(0).integers(0, 9, (6, 8))
    Image.fromarray(labels.astype(np.uint8)).save(folder / "l.png")
    Image.fromarray(labels.astype(np.uint16)).save(folder / "l16.png")
    segmentations: list[dict[str, object]] = [
        {"size": [6, 8], "counts": [10, 20, 18]},
        {"size": [6, 8], "counts": ":d0b0"},
    ]
    coco = {
        "images": [{"id": 1, "file_name": "a.jpg"}],
        "annotations": [{"image_id": 1, "segmentation": s} for s in segmentations],
    }
    (folder / "coco.json").write_text(json.dumps(coco))


def _plans(folder: Path) -> None:
    (folder / "a.plan").write_text(json.dumps(PLAN))
    flown = plan_of(survey(None), waypoint(0, 0, 40), item(206, 5, 0, 1), waypoint(40, 0, 40))
    (folder / "b.plan").write_text(json.dumps(flown))


def _read_plan(path: Path) -> None:
    def flat(x: Any, y: Any) -> Any:
        return np.zeros(np.shape(x))

    read_plan(path, Geodetic(47.0, 8.0, 450.0), 200.0, flat, -90.0)


def _networks() -> dict[str, tuple[Any, Any]]:
    """Small networks and their configurations by the name of their file."""
    torch.manual_seed(0)
    described = {
        "d2net": (d2net.D2Net, D2NetNetConfig(width=0.02)),
        "pixloc": (pixloc.PixlocNet, PixlocNetConfig.model_validate(_little(PixlocNetConfig))),
        "objconnect": (
            objconnect.ObjConnectNet,
            ObjConnectNetConfig.model_validate(
                {"width": 0.02, "pyramid": 8, "strides": [4], "dims": [8], "segments": 4}
            ),
        ),
    }
    return {name: (network(config), config) for name, (network, config) in described.items()}


def _little(config: type[PixlocNetConfig]) -> dict[str, Any]:
    return {"width": 0.02} if "width" in config.model_fields else {}


def _weights(folder: Path) -> None:
    _claim(folder, {"config": CONFIG}, 0)
    for name, (network, config) in _networks().items():
        write_weights(folder / f"{name}.safetensors", network, config.model_dump(mode="json"))
    tensors = {"a.weight": torch.ones(3, 2), "b": torch.arange(4)}
    torch.save({"model": tensors, "epoch": 3, "score": np.float64(0.5)}, folder / "w.pth")
    optimizer = torch.optim.AdamW([torch.nn.Parameter(torch.ones(3))], lr=0.1)
    state = {
        "network": {"weight": torch.ones(2, 2)},
        "optimizer": optimizer.state_dict(),
        "done": 3,
    }
    torch.save(state, folder / "checkpoint.pt")
    (folder / "log.jsonl").write_text('{"step": 0, "loss": 1.5}\n{"step": 1, "loss": 1.25}\n')


CONFIG = TrainConfig().model_dump(mode="json")


def _read_checkpoint(folder: Path) -> None:
    network = torch.nn.Linear(2, 2, bias=False)
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.1)
    _restore(folder / "checkpoint.pt", network, optimizer, torch.device("cpu"))


def _read_log(folder: Path) -> None:
    with _log(folder / "log.jsonl", 1, 0) as write:
        write(1, {"loss": 1.0})


CMU_NAME = "img_00119_c0_1303398474779439us.jpg"
CMU_QUERY = "img_00120_c1_1287503474779439us.jpg"


def _cmu(folder: Path) -> None:
    part = folder / "cmu/slice2"
    for name in ("database", "query", "camera-poses", "sparse"):
        (part / name).mkdir(parents=True)
    write_model(part / "sparse", {CMU_NAME: pose_at(0)}, points=4)
    (folder / "cmu/intrinsics.txt").write_text(f"# cameras\nc0 {CAMERA}\nc1 {CAMERA}\n")
    small = Image.new("RGB", (CAMERA.width, CAMERA.height))
    small.save(part / "query" / CMU_QUERY)
    small.save(part / "database" / CMU_NAME)
    (part / "camera-poses/slice-2-gt-query-images-20101019.txt").write_text(
        f"{CMU_QUERY} 0.0 1.0 0.0 0.0 1.5 2.5 40.0\n"
    )


def _read_cmu(folder: Path) -> None:
    for dataset in open_cmu(folder / "cmu"):
        for query in dataset.queries:
            query.load()
    for part in open_slices(folder / "cmu"):
        for name in part.queries:
            part.camera(name)


def _arrays(folder: Path) -> None:
    write_array(folder / "a.bin", np.ones((3, 4, 5), "f4"))
    _album(folder / "album.h5")


def _album(path: Path) -> None:
    photograph, xy = bytes(range(9)), np.ones((4, 2))
    entry = Entry(CAMERA, photograph, "a.jpg", np.ones((4, 3)), xy, xy)
    write_album(path, Album("x", {"b.jpg": entry}, {"a.jpg": Neighbour(4, 3, photograph)}))


def _rasters(folder: Path) -> None:
    """An orthophoto with an alpha band and a surface model, of a few metres."""
    grid = Grid(Projection("EPSG:32632"), 424_000.0, 5_205_650.0, (0.5, 0.5), 40, 30)
    rng = np.random.default_rng(0)
    kinds: tuple[Kind, Kind] = ("orthophoto", "surface model")
    for kind, name, bands in zip(kinds, ("ortho.tif", "dsm.tif"), (3, 1), strict=True):
        with raster_writer(folder / name, kind, grid) as put:
            values = (400 if bands == 1 else 0) + rng.uniform(0, 99, (bands, 30, 40))
            put(Patch(grid, np.broadcast_to(values, (bands, 30, 40)).astype("f4")))


def _read_raster(path: Path, kind: Kind) -> None:
    raster = Raster.open(path, kind)
    raster.patch(Box(424_001, 5_205_640, 424_009, 5_205_648), 1.0)
    for _ in raster.strips():
        pass


_NETWORKS = {"d2net": d2net, "pixloc": pixloc, "objconnect": objconnect}

READERS: dict[str, Reader] = {
    "colmap": Reader(
        _model,
        each(
            (f"map/{part}.bin" for part in ("cameras", "images", "points3D")),
            "bytes",
            lambda folder: read_model(folder / "map").sha256,
        ),
        6,
    ),
    "scene": Reader(
        _scene,
        {
            **each(
                (f"scene/{name}.json" for name in ("scene", "objects", "splits")),
                "json",
                _read_scene,
            ),
            "scene/sessions/summer-grid/frames.h5": ("hdf5", _read_scene),
            "scene/map/images.bin": ("bytes", _read_scene),
        },
        0.15,
    ),
    "manifests": Reader(
        _scene,
        {
            "scene/scene.json": ("json", lambda f: Scene.open(f / "scene")),
            "scene/objects.json": ("json", lambda f: Scene.open(f / "scene").objects),
            "scene/splits.json": ("json", lambda f: Scene.open(f / "scene").splits),
        },
        4,
    ),
    "frames": Reader(_frames, {"f.h5": ("hdf5", _read_frames)}, 1),
    "covisibility": Reader(
        _covisibility, {"c.h5": ("hdf5", lambda f: read_covisibility(f / "c.h5"))}, 1
    ),
    "features": Reader(_features, {"f.h5": ("hdf5", lambda f: read_features(f / "f.h5"))}, 1),
    "configs": Reader(
        _configs,
        {
            "simulate.yaml": ("text", lambda f: SimulateConfig.load(f / "simulate.yaml", {})),
            "track.yaml": ("text", lambda f: load_config(Track, f / "track.yaml", {})),
            "train.yaml": ("text", lambda f: load_config(TrainConfig, f / "train.yaml", {})),
            "camera.yaml": (
                "text",
                lambda f: load_config(CameraConfig, f / "camera.yaml", {}).build(512),
            ),
        },
        1,
    ),
    "results": Reader(
        _results,
        {
            "results.json": ("json", lambda f: load(f / "results.json")),
            "results.json.xz": ("bytes", lambda f: load(f / "results.json.xz")),
            "render.json.xz": ("bytes", lambda f: read_render(f / "render.json.xz")),
            "basin.json": ("json", lambda f: load_basin(f / "basin.json").text()),
            "journal": ("text", _read_journal),
        },
        4,
    ),
    "tracks": Reader(
        _track,
        {
            "tracks/uav-seasons/queries/town-1.csv": (
                "text",
                lambda f: read_queries(f / "tracks/uav-seasons/queries/town-1.csv"),
            ),
        },
        2,
    ),
    "tables": Reader(
        _tables,
        {
            "queries.txt": ("text", lambda f: read_cameras(f / "queries.txt")),
            "reference_poses.txt": ("text", lambda f: read_poses(f / "reference_poses.txt", True)),
            "gps.csv": ("text", lambda f: read_gps(f / "gps.csv")),
            "priors.csv": ("text", lambda f: read_priors(f / "priors.csv")),
            "conditions.csv": ("text", lambda f: read_conditions(f / "conditions.csv")),
            "positions.csv": ("text", lambda f: read_positions(f / "positions.csv")),
            "gcp_list.txt": ("text", lambda f: _read_control(f / "gcp_list.txt")),
            "pairs.txt": ("text", lambda f: parse_start(f"pairs={f / 'pairs.txt'}")),
        },
        8,
    ),
    "flight": Reader(
        _flight,
        {
            "flight/queries.txt": ("text", _read_flight),
            "flight/reference_poses.txt": ("text", _read_flight),
            "flight/gps.csv": ("text", _read_flight),
            "flight/origin.json": ("json", lambda f: read_origin(f / "flight")),
            "flight/images/b.jpg": ("jpeg", _read_flight),
        },
        0.5,
    ),
    "published": Reader(
        _published,
        {
            "published/published.json": ("json", lambda f: read_index(f / "published")),
            "rows-00000.parquet": ("bytes", _read_rows),
        },
        0.5,
    ),
    "foreign": Reader(
        _foreign,
        {
            "cameras.json": ("json", lambda f: read_foreign(f / "cameras.json")),
            "cameras.xml": ("text", lambda f: read_foreign(f / "cameras.xml")),
            "transforms.json": ("json", lambda f: read_foreign(f / "transforms.json")),
            "reconstruction.json": ("json", lambda f: read_foreign(f / "reconstruction.json")),
            "tum.txt": ("text", lambda f: read_foreign(f / "tum.txt")),
            "places.csv": ("text", lambda f: read_foreign(f / "places.csv")),
        },
        4,
    ),
    "photographs": Reader(
        _photographs,
        {
            "photos/a.jpg": ("jpeg", lambda f: read_rgb(f / "photos/a.jpg")),
            "photos/b.jpg": ("jpeg", lambda f: _read_image(f, "photos/b.jpg", "")),
        },
        6,
    ),
    "videos": Reader(
        _videos,
        {
            "telemetry.srt": ("text", lambda f: read_telemetry(f / "telemetry.srt")),
            "flight.mp4": ("bytes", lambda f: list(decode_frames(f / "flight.mp4", 1.0))),
        },
        2,
    ),
    "masks": Reader(
        _masks,
        {
            "l.png": ("png", lambda f: read_label_png(f / "l.png", 16)),
            "l16.png": ("png", lambda f: read_label_png(f / "l16.png", 16)),
            "coco.json": ("json", lambda f: read_coco(f / "coco.json", "a.jpg", 16)),
        },
        4,
    ),
    "plans": Reader(
        _plans,
        {
            "a.plan": ("json", lambda f: _read_plan(f / "a.plan")),
            "b.plan": ("json", lambda f: _read_plan(f / "b.plan")),
        },
        1,
    ),
    "weights": Reader(
        _weights,
        {
            "objconnect.safetensors": (
                "safetensors",
                lambda f: read_weights(f / "objconnect.safetensors"),
            ),
            "w.pth": ("torch", lambda f: read_weights(f / "w.pth")),
        },
        2,
    ),
    "networks": Reader(
        _weights,
        {
            f"{name}.safetensors": (
                "safetensors",
                lambda f, name=name, module=module: module.read_network(f / f"{name}.safetensors"),
            )
            for name, module in _NETWORKS.items()
        },
        0.05,
    ),
    "checkpoints": Reader(
        _weights,
        {
            "checkpoint.pt": ("torch", _read_checkpoint),
            "log.jsonl": ("text", _read_log),
            "run.json": ("json", lambda f: _claim(f, {"config": CONFIG}, 0)),
        },
        1,
    ),
    "cmu": Reader(
        _cmu,
        each(
            (
                "cmu/intrinsics.txt",
                "cmu/slice2/camera-poses/slice-2-gt-query-images-20101019.txt",
                "cmu/slice2/sparse/images.bin",
            ),
            "text",
            _read_cmu,
        ),
        1,
    ),
    "arrays": Reader(
        _arrays,
        {
            "a.bin": ("bytes", lambda f: read_array(f / "a.bin", 3)),
            "album.h5": ("hdf5", lambda f: read_album(f / "album.h5", "x")),
        },
        1,
    ),
    "rasters": Reader(
        _rasters,
        {
            "ortho.tif": ("bytes", lambda f: _read_raster(f / "ortho.tif", "orthophoto")),
            "dsm.tif": ("bytes", lambda f: _read_raster(f / "dsm.tif", "surface model")),
        },
        1,
    ),
}
