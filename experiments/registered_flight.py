"""Build a flight data set from two registered aerial pictures, one for the map, one for queries.

    python -m experiments.registered_flight MAP QUERIES OUT [--metres 0.2] [--number 24]
        [--seed 0] [--look 0.4]

MAP and QUERIES are nadir pictures of the same size, of one site at two dates. MAP becomes an
orthophoto on level ground, mapped like ``objconnect map --ortho``. The queries are rendered from
QUERIES at exact poses, with a tilt of at most 30 degrees and any heading. ``--look`` is the
strength of random changes of their colours, light, sharpness, snow, haze and noise.
"""

from __future__ import annotations

import argparse
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from objconnect.ingestion.virtual.command import photograph_orthophoto
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.mapping.build import build_map
from objconnect.scene.geometry.pose import Pose

Picture = NDArray[np.uint8]
Array = NDArray[np.float64]

# Reference system, and easting, northing and height (m) of the middle of the picture.
_CRS: Final = "EPSG:25832"
_EAST, _NORTH, _HEIGHT = 500_000.0, 5_300_000.0, 100.0
# Metres of the grid per metre on earth, on the central meridian of UTM.
_GRID_SCALE: Final = 0.9996
# Side and focal length of the photographs, px.
_SIDE: Final = 384
_FOCAL: Final = 384.0
_MAX_TILT_DEG: Final = 30.0
# Range of the ratio of a photograph's pixel on the ground to the picture's.
_PIXEL_RATIOS: Final = (0.7, 1.5)
# Minimum share of a photograph that the picture must fill.
_MIN_FILLED: Final = 0.8
# Pixels of the level ground are this many times as wide as those of the picture.
_GROUND_PIXEL_RATIO: Final = 8
# Maximum number of poses that are drawn per photograph.
_MAX_TRIES: Final = 100


def change_look(picture: Picture, rng: np.random.Generator, strength: float) -> Picture:
    """Return a picture with random colours, light, sharpness, snow, haze and noise."""
    x = picture.astype(np.float32) / 255
    x = x ** np.exp(rng.normal(0, 0.35 * strength))
    x = np.clip(x @ (np.eye(3) + rng.normal(0, 0.12 * strength, (3, 3))).T, 0, 1)
    clouds = rng.normal(0, 1, (5, 5)).astype(np.float32)
    clouds = cv2.resize(clouds, x.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    x = x * np.exp(0.25 * strength * clouds)[..., None]
    if rng.random() < 0.5:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.3, 1.2) * max(strength, 0.3))
    if rng.random() < 0.4 * strength:
        grey = x.mean(-1)
        bright = grey - np.quantile(grey, rng.uniform(0.3, 0.7))
        snow = 0.8 / (1 + np.exp(-bright / 0.04))[..., None]
        x = x * (1 - snow) + 0.9 * snow
    if rng.random() < 0.3 * strength:
        x = 0.6 * x + 0.4 * rng.uniform(0.5, 0.8)
    x = x + rng.normal(0, 0.03 * strength, x.shape)
    return np.asarray(np.clip(x, 0, 1) * 255, np.uint8)


def camera_pose(rng: np.random.Generator, extent: Array, metres: float) -> Pose:
    """Draw a pose ``cam_from_world`` over the middle of the picture, world metres.

    Args:
        rng: random numbers.
        extent: (2,) width and height of the picture, metres.
        metres: side of a pixel of the picture on the ground.
    """
    height = rng.uniform(*_PIXEL_RATIOS) * metres * _FOCAL
    tilt = math.radians(rng.uniform(0, _MAX_TILT_DEG))
    heading, tilt_direction = rng.uniform(0, math.tau, 2)
    centre = np.array([*rng.uniform(-0.42, 0.42, 2) * extent, height])
    forward = [
        math.sin(tilt) * math.cos(tilt_direction),
        math.sin(tilt) * math.sin(tilt_direction),
        -math.cos(tilt),
    ]
    right = np.cross(forward, [math.cos(heading), math.sin(heading), 0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = [right, np.cross(forward, right), forward]
    matrix[:3, 3] = -matrix[:3, :3] @ centre
    return Pose.from_matrix(matrix)


def photograph(picture: Picture, pose: Pose, metres: float) -> Picture | None:
    """Render level ground at a pose; None if the picture does not fill the view."""
    rows, columns = picture.shape[:2]
    rotation, translation = pose.rotation.numpy(), pose.translation.numpy()
    lens = np.array([[_FOCAL, 0, _SIDE / 2], [0, _FOCAL, _SIDE / 2], [0, 0, 1]])
    from_ground = lens @ np.stack([rotation[:, 0], rotation[:, 1], translation], 1)
    pixel = metres / _GRID_SCALE
    to_picture = np.array([[1 / pixel, 0, columns / 2], [0, -1 / pixel, rows / 2], [0, 0, 1]])
    centres = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # OpenCV: origin at a pixel centre
    warp = centres @ to_picture @ np.linalg.inv(from_ground) @ np.linalg.inv(centres)
    size, flags = (_SIDE, _SIDE), cv2.WARP_INVERSE_MAP
    whole = np.ones((rows, columns), np.uint8)
    filled = cv2.warpPerspective(whole, warp, size, flags=flags | cv2.INTER_NEAREST)
    if filled.mean() < _MIN_FILLED:
        return None
    scale = float(pose.centre()[2]) / _FOCAL / metres
    sharp = cv2.GaussianBlur(picture, (0, 0), 0.5 * scale) if scale > 1 else picture
    view = cv2.warpPerspective(sharp, warp, size, flags=flags | cv2.INTER_LINEAR)
    return np.asarray(view, np.uint8)


def make(args: argparse.Namespace) -> None:
    """Map one picture, photograph the other, and write the flight."""
    map_picture, query_picture = (
        cv2.imread(str(path))[..., ::-1] for path in (args.map, args.queries)
    )
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene"
        rasters = _rasters(Path(folder), np.ascontiguousarray(map_picture), args.metres)
        photograph_orthophoto(*rasters, scene, options=ViewOptions(overlap=0.65))
        build_map(scene)
        shutil.copytree(scene / "map", args.out / "sparse" / "map")
        shutil.copytree(scene / "sessions" / "virtual", args.out / "images" / "virtual")
    rng = np.random.default_rng(args.seed)
    extent = np.array(map_picture.shape[1::-1]) * args.metres
    cameras: list[str] = []
    poses: list[str] = []
    for _ in range(_MAX_TRIES * args.number):
        if len(cameras) == args.number:
            break
        pose = camera_pose(rng, extent, args.metres)
        view = photograph(np.ascontiguousarray(query_picture), pose, args.metres)
        if view is None:
            continue
        name = f"q{len(cameras):03d}.jpg"
        view = change_look(view, rng, args.look)
        cv2.imwrite(str(args.out / "images" / name), view[..., ::-1])
        lens = f"{_FOCAL} {_FOCAL} {_SIDE / 2} {_SIDE / 2}"
        cameras.append(f"{name} PINHOLE {_SIDE} {_SIDE} {lens}\n")
        numbers = (*pose.quaternion().tolist(), *pose.translation.tolist())
        poses.append(f"{name} {' '.join(map(str, numbers))}\n")
    (args.out / "queries.txt").write_text("".join(cameras))
    (args.out / "reference_poses.txt").write_text("".join(poses))


def _rasters(folder: Path, picture: Picture, metres: float) -> tuple[Path, Path]:
    """Write a picture and level ground as GeoTIFF."""
    rows, columns = picture.shape[:2]
    west, north = _EAST - columns * metres / 2, _NORTH + rows * metres / 2
    shared: dict[str, Any] = {"driver": "GTiff", "crs": _CRS}
    place = from_origin(west, north, metres, metres)
    size = {"width": columns, "height": rows, "count": 3, "dtype": "uint8", "photometric": "RGB"}
    with rasterio.open(folder / "ortho.tif", "w", transform=place, **size, **shared) as file:
        file.write(picture.transpose(2, 0, 1))
    wide, high = math.ceil(columns / _GROUND_PIXEL_RATIO), math.ceil(rows / _GROUND_PIXEL_RATIO)
    ground = np.full((1, high, wide), _HEIGHT, np.float32)
    place = from_origin(west, north, _GROUND_PIXEL_RATIO * metres, _GROUND_PIXEL_RATIO * metres)
    size = {"width": wide, "height": high, "count": 1, "dtype": "float32"}
    with rasterio.open(folder / "dsm.tif", "w", transform=place, **size, **shared) as file:
        file.write(ground)
    return folder / "ortho.tif", folder / "dsm.tif"


def main() -> None:
    """Make a flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("map", "queries", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--metres", type=float, default=0.2, help="side of a pixel on the ground")
    parser.add_argument("--number", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--look", type=float, default=0.4)
    make(parser.parse_args())


if __name__ == "__main__":
    main()
