"""Export to OpenDroneMap and OpenSfM: ``reconstruction.json`` and ``geo.txt``.

The reconstruction holds the poses (axis-angle and translation of cam_from_world), the cameras in
units of the longer side of the picture, the map's points, and ``reference_lla``, the origin of the
east-north-up world (https://opensfm.org/docs/geometry.html). Our own field ``frame`` says that its
coordinates are east-north-up; ODM writes those of a projected system. ``geo.txt`` holds longitude,
latitude and ellipsoidal height of every camera. Photographs have their file names without folders.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.exports.flat_names import flat_names
from objconnect.scene.exports.lens import coefficients
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import geodetic_from_enu


def write(scene: Scene, sessions: Mapping[str, Frames], folder: Path, final: Path) -> None:
    """Write the two files; see ``formats.Writer``.

    Raises:
        InputError: two photographs have the same file name, a file name has white space, or a lens
            has a rational distortion (k4, k5 or k6).
    """
    from objconnect.scene.geometry.pose import so3_log

    names, origin = flat_names(sessions), scene.manifest.origin
    cameras = list(dict.fromkeys(c for frames in sessions.values() for c in frames.cameras))
    keys = {camera: f"camera {k}" for k, camera in enumerate(cameras, 1)}
    shots: dict[str, Any] = {}
    geo_lines = ["EPSG:4326\n"]
    for frames in sessions.values():
        poses = frames.poses
        vectors, centres = so3_log(poses.rotation).tolist(), poses.centre().numpy()
        for k, name in enumerate(frames.names):
            shots[names[name]] = {
                "rotation": vectors[k],
                "translation": poses.translation[k].tolist(),
                "camera": keys[frames.cameras[k]],
                "orientation": 1,
                "capture_time": 0.0 if math.isnan(frames.time[k]) else float(frames.time[k]),
            }
            geodetic = geodetic_from_enu(centres[k], origin)
            degrees = f"{geodetic.longitude:.10f} {geodetic.latitude:.10f}"
            geo_lines.append(f"{names[name]} {degrees} {geodetic.altitude:.4f}\n")
    reconstruction = {
        "cameras": {keys[camera]: _camera(camera) for camera in cameras},
        "shots": shots,
        "points": _points(scene),
        "reference_lla": {
            "latitude": origin.latitude,
            "longitude": origin.longitude,
            "altitude": origin.altitude,
        },
        "frame": "topocentric",
    }
    text = json.dumps([reconstruction]) + "\n"
    (folder / "reconstruction.json").write_text(text, "utf-8")
    (folder / "geo.txt").write_text("".join(geo_lines), "utf-8")


def _camera(camera: Camera) -> dict[str, Any]:
    """Return a camera under OpenSfM's names.

    Lengths are in units of the longer side; the principal point is relative to the image's centre.

    It uses OpenSfM's simplest model if possible, because more programs read it.

    Raises:
        InputError: the lens has a rational distortion, which no model of OpenSfM has.
    """
    longer_side = max(camera.width, camera.height)
    (fx, fy), (cx, cy) = camera.focal, camera.principal
    fisheye, lens = camera.is_fisheye, camera.distortion
    size = {"width": camera.width, "height": camera.height}
    centred = (cx, cy) == (camera.width / 2, camera.height / 2)
    if centred and fx == fy and not fisheye and not any(lens[2:]):
        kind = {"projection_type": "perspective"}
        return {**kind, **size, "focal": fx / longer_side, "k1": lens[0], "k2": lens[1]}
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "k3", "p1", "p2")
    return {
        "projection_type": "fisheye_opencv" if fisheye else "brown",
        **size,
        "focal_x": fx / longer_side,
        "focal_y": fy / longer_side,
        "c_x": (cx - camera.width / 2) / longer_side,
        "c_y": (cy - camera.height / 2) / longer_side,
        **coefficients(camera, names, "reconstruction.json of OpenSfM"),
    }


def _points(scene: Scene) -> dict[str, Any]:
    if not scene.map_path.is_dir():
        return {}
    sparse_map = scene.sparse_map()
    rows = zip(sparse_map.xyz.tolist(), sparse_map.rgb.tolist(), strict=True)
    return {str(k): {"coordinates": xyz, "color": rgb} for k, (xyz, rgb) in enumerate(rows, 1)}
