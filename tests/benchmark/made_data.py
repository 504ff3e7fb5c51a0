"""Small artificial data sets, and a localizer with predetermined answers."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from benchmark.results.query_result import QueryResult
from objconnect.scene.bundle.frames import Frames, write_frames
from objconnect.scene.bundle.manifest import Manifest, Session, Splits, write_json
from objconnect.scene.bundle.scene import finish_scene
from objconnect.scene.config import Config
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Query, Status
from objconnect.scene.maps.sparse_map import SparseMap

CAMERA = Camera("SIMPLE_RADIAL", 96, 64, (80.0, 48.0, 32.0, 0.01))
MAP_NAMES = ("a.jpg", "c.jpg", "e.jpg", "g.jpg")
QUERY_NAMES = ("b.jpg", "d.jpg", "f.jpg")


def pose_at(index: int) -> Pose:
    """A camera 40 m up that looks down, 4 m further east for every index."""
    down = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=torch.float64)
    centre = torch.tensor([4.0 * index - 12, 1.0, 40.0], dtype=torch.float64)
    return Pose(down, -(down @ centre))


def move(pose: Pose, metres: float) -> Pose:
    """The camera moved east."""
    step = torch.tensor([metres, 0, 0], dtype=torch.float64)
    return Pose(pose.rotation, pose.translation - pose.rotation @ step)


def write_jpeg(path: Path, seed: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(seed).integers(0, 255, (64, 96, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path, quality=90)


def write_model(folder: Path, poses: Mapping[str, Pose], points: int = 60) -> None:
    """A COLMAP binary model whose points lie on the ground and are seen by every image."""
    folder.mkdir(parents=True, exist_ok=True)
    xyz = np.random.default_rng(1).uniform([-30, -15, -1], [30, 15, 1], (points, 3))
    (folder / "cameras.bin").write_bytes(
        struct.pack("<QIiQQ4d", 1, 1, 2, CAMERA.width, CAMERA.height, *CAMERA.params)
    )
    images = struct.pack("<Q", len(poses))
    for number, (name, pose) in enumerate(poses.items(), 1):
        pixels = CAMERA.project(pose.transform(torch.from_numpy(xyz))).xy.tolist()
        images += struct.pack(
            "<I4d3dI", number, *pose.quaternion().tolist(), *pose.translation.tolist(), 1
        )
        images += name.encode() + b"\0" + struct.pack("<Q", points)
        images += b"".join(struct.pack("<ddQ", *xy, k + 1) for k, xy in enumerate(pixels))
    (folder / "images.bin").write_bytes(images)
    cloud = struct.pack("<Q", points)
    for k, point in enumerate(xyz):
        cloud += struct.pack("<Q3d3BdQ", k + 1, *point, 90, 120, 60, 0.5, len(poses))
        cloud += b"".join(struct.pack("<II", n + 1, k) for n in range(len(poses)))
    (folder / "points3D.bin").write_bytes(cloud)


def write_flight(path: Path) -> Path:
    """A flight of seven photographs: four build the map, three are queries."""
    order = sorted(MAP_NAMES + QUERY_NAMES)
    poses = {name: pose_at(k) for k, name in enumerate(order)}
    for k, name in enumerate(order):
        write_jpeg(path / "images" / name, k)
    write_model(path / "sparse" / "map", {name: poses[name] for name in MAP_NAMES})
    (path / "queries.txt").write_text("".join(f"{name} {CAMERA}\n" for name in QUERY_NAMES))
    lines = ["# name qw qx qy qz tx ty tz"]
    for name in QUERY_NAMES:
        numbers = [*poses[name].quaternion().tolist(), *poses[name].translation.tolist()]
        lines.append(" ".join([name, *(repr(x) for x in numbers)]))
    (path / "reference_poses.txt").write_text("\n".join(lines) + "\n")
    rows = ["name,split,lat,lon,alt,e,n,u"]
    for name in order:
        e, n, u = (poses[name].centre() + torch.tensor([0.3, -0.4, 2.0])).tolist()
        split = "map" if name in MAP_NAMES else "query"
        rows.append(f"{name},{split},0,0,0,{e},{n},{u}")
    (path / "gps.csv").write_text("\n".join(rows) + "\n")
    return path


def write_scene(path: Path) -> Path:
    """A scene with a summer map and queries in summer and in winter."""
    sessions = {
        "summer-nadir": Session(condition="summer-noon", flight="nadir", role="map"),
        "summer-grid": Session(condition="summer-noon", flight="grid", role="query"),
        "winter-grid": Session(condition="winter-dusk", flight="grid", role="query"),
    }
    names = {session: [f"{session}/images/{k:06d}.jpg" for k in range(3)] for session in sessions}
    for number, (session, frames) in enumerate(names.items()):
        poses = [pose_at(k + number) for k in range(len(frames))]
        for k, name in enumerate(frames):
            write_jpeg(path / "sessions" / name, 10 * number + k)
        quaternions = np.array([pose.quaternion().tolist() for pose in poses])
        write_frames(
            path / "sessions" / session / "frames.h5",
            Frames(
                names=tuple(frames),
                cameras=(CAMERA,) * len(frames),
                cam_from_world=np.array([pose.matrix().numpy() for pose in poses]),
                time=np.arange(len(frames), dtype=np.float64),
                gps_prior=np.array([pose.centre().numpy() + 1 for pose in poses]),
                gps_sigma=np.full((len(frames), 3), 1.5),
                attitude_prior=quaternions,
                attitude_sigma_deg=np.full(len(frames), 2.0),
            ),
            (),
            iter(()),
        )
    write_model(path / "map", {name: pose_at(k) for k, name in enumerate(names["summer-nadir"])})
    write_json(
        path / "splits.json",
        Splits(
            map=tuple(names["summer-nadir"]),
            queries={s: tuple(names[s]) for s in ("summer-grid", "winter-grid")},
        ),
    )
    manifest = Manifest(
        versions={},
        preset="town",
        seed=7,
        config={},
        origin=Geodetic(47.0, 8.0, 400.0),
        sessions=sessions,
        sha256={},
    )
    finish_scene(path, manifest)
    return path


def make_scored_query(
    name: str,
    metres: float | None,
    condition: str = "summer",
    status: Status | None = None,
    **more: Any,
) -> QueryResult:
    """A scored query so far off; None is a failure."""
    located = metres is not None
    figures: dict[str, Any] = {
        "group": "flight",
        "altitude_m": 70.0,
        "reason": "" if located else "lost",
        "r_err_deg": 0.5 if located else None,
        "sigma_t_m": None,
        "nees": None,
        "iterations": 0,
        "inliers": 0,
        "seconds": {"total": 0.25},
    }
    return QueryResult(
        name=name,
        condition=condition,
        status=status or (Status.OK if located else Status.FAILED),
        t_err_m=metres,
        cam_from_world=(1, 0, 0, 0, 0, 0, 0) if located else None,
        **figures | more,
    )


class FakeConfig(Config):
    """Options of the fake localizer."""

    strength: float = 1.0


class FakeLocalizer:
    """Answers from a table; a query that is not in it gets its prior as a fallback."""

    name = "fake"
    weights_sha256 = None

    def __init__(self, answers: Mapping[str, Estimate | Exception | KeyboardInterrupt]) -> None:
        self.config = FakeConfig()
        self.answers = answers
        self.seen: list[Query] = []

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        assert all((images / name).is_file() for name in sparse_map.names)

    def localize(self, query: Query) -> Estimate:
        self.seen.append(query)
        answer = self.answers.get(query.name)
        if isinstance(answer, BaseException):
            raise answer
        return answer or Estimate(Status.FAILED, reason="nothing found")
