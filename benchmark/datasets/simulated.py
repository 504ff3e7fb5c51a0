"""Reader of scenes.

Simulated scenes have exact reference poses and show one place under many conditions. Scenes of real
photographs have reference poses from structure from motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.flight import TRACK as FLIGHT
from benchmark.datasets.identity import parts_of
from objconnect.scene.bundle.frames import Frames
from objconnect.scene.bundle.scene import MANIFEST, Scene, is_scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.colmap_files import check_pose

TRACK: Final = "uav-sim"


def open_scene(path: Path) -> Dataset:
    """Open a scene: its map, and the queries of every session (a flight under one condition).

    Raises:
        InputError: the scene is not finished, has no map or no queries, or its lists contradict
            each other.
    """
    scene = Scene.open(path)
    queries = tuple(query for session in scene.splits.queries for query in _queries(scene, session))
    if not queries:
        raise InputError(
            f"scene {path} has no query: its splits name map frames only; make a scene with a "
            "session or photographs of role query"
        )
    sparse_map = scene.sparse_map()
    for query in queries:
        if query.name in sparse_map.images:
            raise InputError(
                f"scene {path}: query {query.name} is a photograph of the map: build the map again"
            )
    return Dataset(
        name=scene.name,
        track=TRACK if scene.manifest.reference == "exact" else FLIGHT,
        parts=parts_of(scene.map_path, scene.images_root, sparse_map.names, queries),
        map_conditions=tuple(sorted({_condition(scene, name) for name in sparse_map.images})),
        model=scene.map_path,
        load_map=scene.sparse_map,
        images=scene.images_root,
        queries=queries,
    )


class SceneReader:
    """Reads scenes; see ``benchmark.datasets.open.Reader``."""

    name = "scene"
    holds = f"{MANIFEST} (a finished scene)"

    def recognizes(self, path: Path) -> bool:
        """Return whether a path is the folder of a finished scene."""
        return is_scene(path)

    def open(self, path: Path) -> list[Dataset]:
        """Open a scene as one data set; ``open_scene`` says which errors are raised."""
        return [open_scene(path)]


READER: Final = SceneReader()


def _queries(scene: Scene, session: str) -> Iterator[BenchmarkQuery]:
    """Yield the queries of a session in the order of the scene's list."""
    frames = scene.frames(session)
    row_of = {name: row for row, name in enumerate(frames.names)}
    for name in scene.splits.queries[session]:
        if name not in row_of:
            raise InputError(
                f"scene {scene.path}: query {name} is not a frame of session {session}: remove it "
                "from splits.json"
            )
        condition = scene.sessions[session].condition
        image = scene.images_root / name
        where = f"scene {scene.path}"
        yield query_of(frames, row_of[name], image, session, condition, where)


def query_of(
    frames: Frames, row: int, image: Path, session: str, condition: str, where: str
) -> BenchmarkQuery:
    """Return a frame of a scene as a query.

    Args:
        frames: frames of a session.
        row: row of the frame.
        image: file of the photograph.
        session: name of the session.
        condition: its condition.
        where: the scene, for messages.

    Raises:
        InputError: the attitude of its prior is not a rotation, or the position is not finite.
    """
    name = frames.names[row]
    return BenchmarkQuery(
        name=name,
        condition=condition,
        group=session,
        camera=frames.cameras[row],
        image=image,
        prior=_prior(frames, row, f"{where}: prior of {name}"),
        reference=Pose.from_matrix(frames.cam_from_world[row]),
    )


def _prior(frames: Frames, row: int, what: str) -> Prior | None:
    """Return the measured position and attitude of a frame, or None without a position.

    Raises:
        InputError: the attitude is not a rotation, or the position is not finite; ``what`` names
            the prior in the message.
    """
    if not frames.has_gps[row]:
        return None
    position, sigma = frames.gps_prior[row], frames.gps_sigma[row]
    if not frames.has_attitude[row]:
        return Prior(position, sigma)
    attitude = frames.attitude_prior[row]
    check_pose(attitude, position, what)
    return Prior(
        position=position,
        position_sigma=sigma,
        cam_from_world_rotation=Pose.from_quaternion(attitude, [0, 0, 0]).rotation.numpy(),
        attitude_sigma_deg=float(frames.attitude_sigma_deg[row]),
    )


def _condition(scene: Scene, name: str) -> str:
    """Return the condition of a photograph; its session is the first part of its name."""
    session = name.split("/")[0]
    if session not in scene.sessions:
        raise InputError(
            f"scene {scene.path}: map image {name} belongs to no session: build the map again"
        )
    return scene.sessions[session].condition
