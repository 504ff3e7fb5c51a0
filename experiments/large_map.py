"""Cost of a query in maps of any size: seconds, and the memory of the process.

    python -m experiments.large_map FOLDER [--method NAME] [--photographs N...] [--set K=V...]

A flight of 100 small photographs over a textured plane is repeated, with its points, all over a
large area. The features of the 100 photographs are computed once and repeated too. Everything else
is as for any map, in its own process: COLMAP's files are read and prepared, and queries localized.
Queries are spread over the map, so that their data is in memory only if the whole map is.
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from benchmark.cli.arguments import parse_settings
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.matching.sift import Sift
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.methods import create
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.localizer import Localizer, Prior, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import Features
from objconnect.scene.runtime.memory import peak_megabytes, reset_peak, resident_bytes
from objconnect.scene.runtime.tuning import ProcessTuning

# Distances between photographs and between repetitions, height above the ground, side of a texel.
SPACING_M, REPEAT_M, HEIGHT_M, TEXEL_M = 20.0, 400.0, 80.0, 0.5
# Photographs along each side of a flight.
SIDE: Final = 10
CAMERA: Final = Camera("SIMPLE_PINHOLE", 128, 128, (128.0, 64.0, 64.0))
# Keypoints in the same square cell of the ground, of this side, show one point.
_CELL_M: Final = 0.5
# Rotation of a camera that looks down with its top to the north.
_DOWN: Final = np.diag([1.0, -1.0, -1.0])
# Texture beyond the outermost cameras.
_MARGIN_M: Final = 60.0
QUERIES: Final = 50


class Flight(NamedTuple):
    """A hundred photographs: positions (100, 2) of the cameras, pixels, and features."""

    places: NDArray[np.float64]
    pictures: list[NDArray[np.uint8]]
    features: list[Features]


def ground() -> NDArray[np.uint8]:
    """Return a texture with details of every size."""
    rng = np.random.default_rng(0)
    side = round((SIDE * SPACING_M + 2 * _MARGIN_M) / TEXEL_M)
    total = np.zeros((side, side, 3), np.float32)
    for cells in (10, 40, 160, 320):
        noise = rng.uniform(-1, 1, (cells, cells, 3)).astype(np.float32)
        total += cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(128 + 60 * total, 0, 255), np.uint8)


def photograph(texture: NDArray[np.uint8], place: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return a nadir photograph of the plane; north is up, at the texture's first row."""
    metres = HEIGHT_M / CAMERA.params[0]
    north = SIDE * SPACING_M + _MARGIN_M
    column, row = (place[0] + _MARGIN_M) / TEXEL_M, (north - place[1]) / TEXEL_M
    scale = metres / TEXEL_M
    shift = np.array([column, row]) - scale * CAMERA.width / 2 - 0.5 + scale / 2
    inverse = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(texture, inverse, (CAMERA.width, CAMERA.height), flags=flags))


def fly(texture: NDArray[np.uint8]) -> Flight:
    """Photograph the plane on a grid, and extract features."""
    rows, columns = np.divmod(np.arange(SIDE**2), SIDE)
    places = SPACING_M * np.stack([columns, rows], -1).astype(float)
    pictures = [photograph(texture, place) for place in places]
    extract = Sift(8192)
    return Flight(places, pictures, [extract(picture) for picture in pictures])


def write_map(folder: Path, flight: Flight, repetitions: int) -> None:
    """Write COLMAP's three files, and photographs that are links to the first hundred."""
    per_row = int(np.ceil(repetitions**0.5))
    metres = HEIGHT_M / CAMERA.params[0]
    # In one flight: the ground position of every keypoint, and a point for every cell, their mean.
    on_ground = []
    for place, found in zip(flight.places, flight.features, strict=True):
        offset = (found.xy.astype(float) - CAMERA.width / 2) * [metres, -metres]
        on_ground.append(place + offset)
    all_xy = np.concatenate(on_ground)
    _, point, track = np.unique(
        np.floor(all_xy / _CELL_M).astype(int), axis=0, return_inverse=True, return_counts=True
    )
    point = point.ravel()
    xy = np.stack([np.bincount(point, all_xy[:, k]) / track for k in range(2)], -1)
    ends = np.cumsum([len(each) for each in on_ground])
    model, images = folder / "sparse" / "map", folder / "images"
    model.mkdir(parents=True)
    camera = struct.pack("<QIiQQ3d", 1, 1, 0, CAMERA.width, CAMERA.height, *CAMERA.params)
    (model / "cameras.bin").write_bytes(camera)
    with (model / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", repetitions * len(on_ground)))
        for block in range(repetitions):
            block_offset = REPEAT_M * np.array(divmod(block, per_row))
            (images / f"{block:03d}").mkdir(parents=True)
            for k, points in enumerate(np.split(point, ends[:-1])):
                name = f"{block:03d}/{k:02d}.png"
                first = images / "000" / f"{k:02d}.png"
                if block:
                    os.link(first, images / name)
                else:
                    Image.fromarray(flight.pictures[k]).save(first)
                t = -_DOWN @ np.array([*(flight.places[k] + block_offset), HEIGHT_M])
                number = block * len(on_ground) + k + 1
                file.write(struct.pack("<I4d3dI", number, 0, 1, 0, 0, *t, 1))
                file.write(name.encode() + b"\0" + struct.pack("<Q", len(points)))
                table = np.zeros(len(points), [("xy", "<f8", 2), ("point", "<u8")])
                table["xy"] = flight.features[k].xy
                table["point"] = points + block * len(xy) + 1
                file.write(table.tobytes())
    layout = [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("n", "<u8")]
    with (model / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", repetitions * len(xy)))
        for block in range(repetitions):
            table = np.zeros(len(xy), layout)
            table["id"] = np.arange(len(xy)) + block * len(xy) + 1
            table["xyz"][:, :2] = xy + REPEAT_M * np.array(divmod(block, per_row))
            table["n"] = track
            for row, length in zip(table, track, strict=True):
                file.write(row.tobytes() + bytes(8 * int(length)))


def queries(texture: NDArray[np.uint8], repetitions: int, count: int) -> list[Query]:
    """Return queries all over the map, with priors that are wrong by a metre."""
    rng = np.random.default_rng(1)
    per_row = int(np.ceil(repetitions**0.5))
    found = []
    for number in range(count):
        place = rng.uniform(0, SPACING_M * (SIDE - 1), 2)
        block_offset = REPEAT_M * np.array(divmod(int(rng.integers(repetitions)), per_row))
        prior = Prior(
            np.array([*(place + block_offset + [1, 0]), HEIGHT_M]), np.full(3, 3.0), _DOWN, 1.0
        )
        found.append(Query(f"{number}", photograph(texture, place), CAMERA, prior))
    return found


def localizer_of(folder: Path, flight: Flight, method: str, options: dict[str, Any]) -> Localizer:
    """Return a prepared method that extracted features of the first hundred photographs only."""
    localizer = create(method, options)
    if isinstance(localizer, StructureLocalizer):
        known = {f"{k:02d}.png": item for k, item in enumerate(flight.features)}
        localizer._extractor.extract_photographs = (  # type: ignore[method-assign]
            lambda _, names, *__: {name: known[name.split("/")[1]] for name in names}
        )
    if isinstance(localizer, FeaturemetricLocalizer):
        localizer._extract = _CachingExtractor(localizer._extract)  # type: ignore[assignment]
    localizer.prepare(read_model(folder / "sparse" / "map"), folder / "images", folder / "cache")
    return localizer


class _CachingExtractor:
    """An extractor that caches the first hundred views."""

    def __init__(self, extract: MapExtractor) -> None:
        self._extract = extract
        self._seen: dict[Any, Any] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._extract, name)

    def __call__(self, rgb: NDArray[np.uint8], camera: Camera, *how: float) -> Any:
        key = (rgb.tobytes(), how)
        if key in self._seen:
            return self._seen[key]
        found = self._extract(rgb, camera, *how)
        if len(self._seen) < SIDE**2:
            self._seen[key] = found
        return found


def measure(folder: Path, repetitions: int, method: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return the cost of preparing and of queries in this process."""
    torch.set_num_threads(1)
    texture = ground()
    flight = fly(texture)
    if not (folder / "sparse").is_dir():
        write_map(folder, flight, repetitions)
    reset_peak()
    before, began = resident_bytes(), time.process_time()
    localizer = localizer_of(folder, flight, method, options)
    prepared, prepare_s = resident_bytes(), time.process_time() - began
    seconds, found = [], 0
    for query in queries(texture, repetitions, QUERIES):
        began = time.process_time()
        estimate = localizer.localize(query)
        seconds.append(time.process_time() - began)
        found += estimate.status is Status.OK
    return {
        "photographs": repetitions * SIDE**2,
        "prepare_s": round(prepare_s, 1),
        "query_s": round(float(np.median(seconds[QUERIES // 5 :])), 4),
        "found": f"{found} of {QUERIES}",
        "before_mb": round(before / 1e6),
        "prepared_mb": round(prepared / 1e6),
        "asked_mb": round(resident_bytes() / 1e6),
        "peak_mb": round(peak_megabytes() or 0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", default="sift")
    parser.add_argument("--photographs", type=int, nargs="+", default=[100, 10_000])
    parser.add_argument("--set", action="append", metavar="KEY=VALUE", help="memory_mb=1024")
    parser.add_argument("--one", action="store_true", help="measure here, in this process")
    args = parser.parse_args()
    settings = args.set or ["memory_mb=1024"]
    options = parse_settings(settings)
    if args.one:
        (count,) = args.photographs
        folder = args.folder / str(count)
        print(json.dumps(measure(folder, count // SIDE**2, args.method, options)), flush=True)
        return
    for count in args.photographs:
        # The second run reads the cache that the first one wrote.
        for _ in range(2):
            arguments = ["--method", args.method, "--photographs", str(count), "--one"]
            command = [sys.executable, "-m", "experiments.large_map", str(args.folder)]
            for setting in settings:
                arguments += ["--set", setting]
            subprocess.run([*command, *arguments], check=True)


if __name__ == "__main__":
    with ProcessTuning():  # as the command line
        main()
