"""Cameras with a known truth, and files of other programs that state them in random conventions."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pyproj
from scipy.spatial.transform import Rotation

from objconnect.scene.geometry.colmap_models import MODEL_IDS
from objconnect.scene.geometry.geodesy import Geodetic, ecef_from_geodetic, enu_axes

Array = Any
WIDTH, HEIGHT = 1200, 900


@dataclass
class Truth:
    """N cameras that look down, in metres east, north and up, and what a file says of them.

    ``lens`` is COLMAP's model with its parameters. ``fields`` name what in the file is unknown,
    contradicts itself or is not supported: an error must name one of them.
    """

    names: list[str]
    world_from_cam: Array
    origin: Geodetic
    lens: tuple[str, list[float]]
    fields: list[str] = field(default_factory=list)
    placed: bool = False

    def ray(self) -> Array:
        return np.array([0.21, -0.13, 1.0])

    def pixel(self) -> Array:
        model, params = self.lens
        camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
        return camera.img_from_cam(self.ray()[None])[0]


def make_truth(rng: np.random.Generator) -> Truth:
    count = int(rng.integers(4, 9))
    matrices = np.tile(np.eye(4), (count, 1, 1))
    down = np.diag([1.0, -1.0, -1.0])
    for matrix in matrices:
        tilt = Rotation.from_euler("zx", [rng.uniform(0, 360), rng.uniform(-25, 25)], degrees=True)
        matrix[:3, :3] = tilt.as_matrix() @ down
        matrix[:3, 3] = [*rng.uniform(-150, 150, 2), rng.uniform(60, 90)]
    origin = Geodetic(
        rng.choice([-1, 1]) * rng.uniform(5, 65), rng.uniform(-179, 179), rng.uniform(0, 500)
    )
    names = [f"DJI_{k:04d}.JPG" for k in range(count)]
    return Truth(names, matrices, origin, ("PINHOLE", [900.0, 910.0, 605.0, 447.0]))


def brown(rng: np.random.Generator) -> tuple[str, list[float]]:
    """A lens with two radial coefficients or three."""
    bent = [rng.uniform(-0.1, 0.1), rng.uniform(-0.02, 0.02), *rng.uniform(-2e-3, 2e-3, 2)]
    third = rng.uniform(-0.02, 0.02) if rng.random() < 0.5 else 0.0
    return "FULL_OPENCV", [900.0, 910.0, 605.0, 447.0, *bent, third, 0.0, 0.0, 0.0]


def coefficients(truth: Truth, fish: bool) -> dict[str, float]:
    """The coefficients by OpenCV's names."""
    names = ("k1", "k2", "k3", "k4") if fish else ("k1", "k2", "p1", "p2", "k3")
    return dict(zip(names, truth.lens[1][4:], strict=False))


def fisheye(rng: np.random.Generator) -> tuple[str, list[float]]:
    return "OPENCV_FISHEYE", [700.0, 710.0, 605.0, 447.0, *rng.uniform(-0.02, 0.02, 4)]


def write_colmap(rng: np.random.Generator, folder: Path) -> tuple[Path, Truth]:
    truth = make_truth(rng)
    number = int(rng.integers(0, 18))
    model = MODEL_IDS[number]
    native = pycolmap.Camera.create_from_model_name(1, model, 900.0, WIDTH, HEIGHT)
    params = [float(value) for value in native.params]
    names = [word.strip() for word in native.params_info.split(",")]
    tail = rng.random() < 0.3
    if number == 6:
        params[4:] = [*rng.uniform(-0.02, 0.02, 8)] if tail else [0.05, -0.01, 1e-3, 2e-3, *4 * [0]]
        params = [float(value) for value in params]
    ours = ("k", "k1", "k2") if number not in (7, 12, 13) else ()
    for k, name in enumerate(names):
        if number == 6:
            break
        if name in ours or (tail and name not in ("f", "fx", "fy", "cx", "cy", "w", "h")):
            params[k] = float(rng.uniform(0.001, 0.02))
    truth.lens = (model, params)
    if number > 6:
        truth.fields = [model]
    (folder / "cameras.bin").write_bytes(
        struct.pack("<QIiQQ", 1, 1, number, WIDTH, HEIGHT)
        + struct.pack(f"<{len(params)}d", *params)
    )
    data = struct.pack("<Q", len(truth.names))
    for k, (name, pose) in enumerate(zip(truth.names, truth.world_from_cam, strict=True), 1):
        turn = Rotation.from_matrix(pose[:3, :3].T)
        x, y, z, w = turn.as_quat()
        sign = rng.choice([-1.0, 1.0])
        shift = -pose[:3, :3].T @ pose[:3, 3]
        data += struct.pack("<I4d3dI", k, *(sign * np.array([w, x, y, z])), *shift, 1)
        data += name.encode() + b"\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(data)
    point = struct.pack("<Q3d3BdQ", 1, 0.0, 0.0, 0.0, 1, 2, 3, 0.5, 0)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 1) + point)
    if rng.random() < 0.1:
        (folder / "cameras.bin").rename(folder / "cameras.txt")
        truth.fields = ["text model"]
    return folder, truth


def _rotation_vector(world_from_cam: Array) -> list[float]:
    return Rotation.from_matrix(world_from_cam[:3, :3].T).as_rotvec().tolist()


def _shots(truth: Truth, matrices: Array, measured: Array | None) -> dict[str, Any]:
    shots = {}
    for k, (name, pose) in enumerate(zip(truth.names, matrices, strict=True)):
        shots[name] = {
            "rotation": _rotation_vector(pose),
            "translation": (-pose[:3, :3].T @ pose[:3, 3]).tolist(),
            "camera": "c",
        }
        if measured is not None:
            shots[name]["gps_position"] = measured[k].tolist()
    return shots


def move_of_odm(origin: Geodetic, zone: int) -> tuple[Array, Array, str]:
    """The map of export_geocoords, (3, 3) and (3,), and the header of coords.txt."""
    south = origin.latitude < 0
    system = pyproj.Proj(proj="utm", zone=zone, south=south, datum="WGS84")
    points = np.vstack([np.zeros(3), np.eye(3)])
    seen = []
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    for point in points:
        ecef = ecef_from_geodetic(origin) + enu_axes(origin).T @ point
        longitude, latitude, altitude = geodetic.transform(*ecef)
        seen.append([*system(longitude, latitude), altitude])
    seen = np.array(seen)
    return (seen[1:] - seen[0]).T, seen[0], f"WGS84 UTM {zone}{'S' if south else 'N'}"


def project_points(matrices: Array, linear: Array, shift: Array) -> Array:
    """Poses as export_geocoords writes them."""
    left, _, right = np.linalg.svd(linear)
    moved = matrices.copy()
    moved[:, :3, :3] = (left @ right) @ matrices[:, :3, :3]
    moved[:, :3, 3] = matrices[:, :3, 3] @ linear.T + shift
    return moved


def plain_project(folder: Path) -> None:
    """What OpenSfM has around its reconstruction, and ODM has not: photographs in it."""
    for name in ("images", "exif"):
        (folder / name).mkdir()
    (folder / "camera_models.json").write_text("{}")


def write_opensfm(rng: np.random.Generator, folder: Path) -> tuple[Path, Truth]:
    truth = make_truth(rng)
    truth.placed = True
    kind = rng.choice(["brown", "fisheye_opencv", "fisheye", "perspective", "spherical"])
    fish = kind.startswith("fisheye")
    truth.lens = fisheye(rng) if fish else brown(rng)
    params = truth.lens[1]
    if kind in ("fisheye", "perspective"):
        params[1], params[2:4], params[6:8] = params[0], [WIDTH / 2, HEIGHT / 2], [0.0, 0.0]
    if kind == "spherical":
        truth.fields.append("projection 'spherical'")
    fx, fy, cx, cy = params[:4]
    lens: dict[str, Any] = {"projection_type": str(kind), "width": WIDTH, "height": HEIGHT}
    if kind in ("fisheye", "perspective"):
        lens["focal"] = fx / WIDTH
    else:
        lens |= {"focal_x": fx / WIDTH, "focal_y": fy / WIDTH}
        lens |= {"c_x": (cx - WIDTH / 2) / WIDTH, "c_y": (cy - HEIGHT / 2) / WIDTH}
    lens |= coefficients(truth, fish)
    reference = dict(zip(("latitude", "longitude", "altitude"), truth.origin, strict=True))
    noise = rng.choice([0.0, 0.05, 2.0])
    there = truth.world_from_cam[:, :3, 3]
    measured = there + rng.normal(0, 1, there.shape) * noise

    def write(path: Path, matrices: Array, gps: bool) -> None:
        shots = _shots(truth, matrices, measured if gps else None)
        own: dict[str, Any] = {"cameras": {"c": lens}, "shots": shots, "points": {}}
        if rng.random() < 0.8 or not beside_reference:
            own["reference_lla"] = reference
        path.write_text(json.dumps([own]))

    project = folder / "opensfm"
    project.mkdir()
    path = project / "reconstruction.json"
    beside_reference = rng.random() < 0.5
    if beside_reference:
        (project / "reference_lla.json").write_text(json.dumps(reference))
    case = rng.choice(["plain", "both", "coords", "alone"])
    if case == "plain":
        write(path, truth.world_from_cam, bool(rng.random() < 0.5))
        whole = rng.random() < 0.7
        if whole:
            plain_project(project)
        # Nothing but gps_position tells the frame of a file alone, and it may look turned.
        truth.fields += ["gps_position"] if noise > 1 or not whole else []
        return path, truth
    zone = int((truth.origin.longitude + 180) // 6) + 1
    linear, shift, header = move_of_odm(truth.origin, zone)
    offset = np.floor(shift[:2] + rng.uniform(-20, 20, 2))
    moved = project_points(truth.world_from_cam, linear, shift - [*offset, 0.0])
    if rng.random() < 0.2:
        moved = truth.world_from_cam  # an older ODM left it in the first frame
    write(path, moved, bool(rng.random() < 0.7))
    coords = folder / "odm_georeferencing"
    if case == "both":
        write(project / "reconstruction.topocentric.json", truth.world_from_cam, True)
    if case != "alone":
        coords.mkdir()
        (coords / "coords.txt").write_text(f"{header}\n{offset[0]:.0f} {offset[1]:.0f}\n0 0 0\n")
    truth.fields += ["projected", "gps_position"]
    return path, truth


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def write_metashape(rng: np.random.Generator, folder: Path) -> tuple[Path, Truth]:
    truth = make_truth(rng)
    truth.placed = bool(rng.random() < 0.7)
    fish = rng.random() < 0.3
    truth.lens = fisheye(rng) if fish else brown(rng)
    fx, fy, cx, cy = truth.lens[1][:4]
    values = {"f": fy, "cx": cx - WIDTH / 2, "cy": cy - HEIGHT / 2, "b1": fx - fy}
    bent = coefficients(truth, fish)
    other = {"p1": "p2", "p2": "p1"}
    values |= {other.get(name, name): value for name, value in bent.items()}
    kind = "fisheye" if fish else "frame"
    size, own_size, own_kind = f'width="{WIDTH}" height="{HEIGHT}"', "", kind
    fault = rng.choice([*[""] * 8, "size", "type", "p3", "rotation", "scale", "component", "chunk"])
    own_size = 'width="600" height="450"' if fault == "size" else size
    if fault == "type":
        own_kind = rng.choice(["spherical", "rpc", "fisheye" if kind == "frame" else "frame"])
    if fault == "p3":
        values["p3"] = 0.01
    text = "".join(f"<{name}>{value!r}</{name}>" for name, value in values.items())
    empty = '<sensor id="9" type="frame"><calibration type="frame" class="adjusted"/></sensor>'
    sensors = (
        f'{empty if rng.random() < 0.5 else ""}<sensor id="0" label="s" type="{own_kind}">'
        f"<resolution {own_size}/><calibration type='{kind}' class='initial'><resolution {size}/>"
        f"<f>1</f></calibration><calibration type='{kind}' class='adjusted'><resolution {size}/>"
        f"{text}</calibration></sensor>"
    )
    world = np.eye(4)
    if truth.placed:
        world[:3, :3] = enu_axes(truth.origin).T
        world[:3, 3] = ecef_from_geodetic(truth.origin)
    count = 2 if fault == "component" or (truth.placed and rng.random() < 0.3) else 1
    components, cameras = "", ""
    for number in range(count):
        spin, scale = Rotation.random(random_state=rng).as_matrix(), rng.uniform(0.1, 30)
        shift = world[:3, 3] + rng.uniform(-9, 9, 3)
        parts = {"rotation": _words(spin), "translation": _words(shift), "scale": repr(scale)}
        if fault in ("rotation", "scale"):
            del parts[fault]
        inner = "".join(f"<{part}>{said}</{part}>" for part, said in parts.items())
        if fault == "component" and number == 1:
            inner = ""
        components += f'<component id="{number}"><transform>{inner}</transform></component>'
        for k in range(number, len(truth.names), count):
            pose = world @ truth.world_from_cam[k]
            pose[:3, :3] = spin.T @ pose[:3, :3]
            pose[:3, 3] = spin.T @ (pose[:3, 3] - shift) / scale
            cameras += (
                f'<camera id="{k}" sensor_id="0" component_id="{number}" label="{truth.names[k]}">'
                f"<transform>{_words(pose)}</transform></camera>"
            )
    cameras += '<camera id="98" sensor_id="9" label="not aligned"/>'
    other = ""
    if fault == "chunk":
        matrix = _words(np.eye(4))
        other = f"<chunk><camera label='x'><transform>{matrix}</transform></camera></chunk>"
    truth.fields = {
        "size": ["resolution"],
        "type": ["type"],
        "p3": ["p3"],
        "rotation": ["rotation"],
        "scale": ["scale"],
        "component": ["component"],
        "chunk": ["chunks"],
    }.get(str(fault), [])
    path = folder / "cameras.xml"
    path.write_text(
        f"<document><chunk><sensors>{sensors}</sensors><components>{components}</components>"
        f"<cameras>{cameras}</cameras></chunk>{other}</document>"
    )
    return path, truth


def write_nerfstudio(rng: np.random.Generator, folder: Path) -> tuple[Path, Truth]:
    truth = make_truth(rng)
    fish = rng.random() < 0.5
    truth.lens = fisheye(rng) if fish else brown(rng)
    fx, fy, cx, cy = truth.lens[1][:4]
    number = rng.choice([int, float])
    lens: dict[str, Any] = {"w": number(WIDTH), "h": number(HEIGHT), "fl_x": fx, "fl_y": fy}
    lens |= {"cx": cx, "cy": cy, **coefficients(truth, fish)}
    model = "OPENCV_FISHEYE" if fish else "OPENCV"
    if rng.random() < 0.5:
        flag = [fish, str(fish), str(fish).lower(), int(fish)][int(rng.integers(4))]
        lens["is_fisheye"] = flag
    if rng.random() < 0.4 or (fish and "is_fisheye" not in lens):
        lens["camera_model"] = [model, model.lower()][int(rng.integers(2))]
    if rng.random() < 0.5:
        own = fish and rng.random() < 0.5
        lens["camera_angle_x"] = WIDTH / fx if own else 2 * np.arctan(WIDTH / 2 / fx)
    fault = rng.choice([*[""] * 8, "angle", "flag", "model", "key", "row", "relative"])
    if fault == "angle":
        lens["camera_angle_x"] = 2 * np.arctan(WIDTH / fx)
        truth.fields = ["camera_angle_x"]
    if fault == "flag":
        lens |= {"camera_model": model, "is_fisheye": not fish}
        truth.fields = ["is_fisheye"]
    if fault == "model":
        lens["camera_model"] = rng.choice(["EQUIRECTANGULAR", "VR180_L", "PINHOLE", "RADIAL"])
        truth.fields = ["camera_model"]
    if fault == "key":
        key, value = [("k5", 0.1), ("ftheta_p0", 3.0), ("rolling_shutter", [0, 0, 0.1, 0])][
            int(rng.integers(3))
        ]
        lens[key] = value
        truth.fields = [key]
    if fault == "relative":
        lens |= {"cx": cx / WIDTH, "cy": cy / HEIGHT}
        truth.fields = ["cx"]
    document: dict[str, Any] = {"aabb_scale": 16, "frames": []}
    matrices = truth.world_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0])
    if rng.random() < 0.5:
        applied = np.eye(4)
        applied[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        applied[:3, 3] = rng.uniform(-9, 9, 3)
        matrices = applied @ matrices
        document["applied_transform"] = applied[: int(rng.integers(3, 5))].tolist()
        if rng.random() < 0.5:
            document["applied_scale"] = 0.1
            matrices[:, :3, 3] *= 0.1
    if fault == "row":
        matrices = matrices.transpose(0, 2, 1)
        truth.fields = ["transform_matrix"]
    per_frame = rng.random() < 0.3
    for name, matrix in zip(truth.names, matrices, strict=True):
        frame = {"file_path": name, "transform_matrix": matrix.tolist(), "sharpness": 9.0}
        document["frames"].append(frame | (lens if per_frame else {}))
    if not per_frame:
        document |= lens
    path = folder / "transforms.json"
    path.write_text(json.dumps(document))
    return path, truth


WRITERS = {
    "colmap": write_colmap,
    "opensfm": write_opensfm,
    "metashape": write_metashape,
    "nerfstudio": write_nerfstudio,
}
