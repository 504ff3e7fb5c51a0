"""The sparse map of a scene, by triangulation with its known poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scene.bundle import Scene, finish
from scene.colmap import PosedImage, SiftOptions, triangulate
from scene.covisibility import overlap_matrix, surface_points
from scene.errors import InputError
from scene.features import write_features
from scene.files import folder_written_whole
from scene.progress import progress_bar
from scene.sparse_map import SparseMap
from simulate.pictures import draw_pictures

FEATURES = "features.h5"

# A pair is worth matching when this share of one picture is seen in the other, ...
_MIN_OVERLAP = 0.2
# ... and each picture is matched with at most so many others, those of largest overlap.
_MAX_NEIGHBOURS = 20


def build_map(path: Path) -> SparseMap:
    """Triangulate the map of a finished scene from its map frames and record it in the manifest.

    An older map is replaced once the new one is whole. The model is in world metres; the features
    it was built from lie beside it.

    Raises:
        InputError: not a finished scene, a photograph is damaged, or nothing could be triangulated.
    """
    scene = Scene.open(path)
    images, overlap = _map_frames(scene)
    pairs = [(images[i].name, images[j].name) for i, j in choose_pairs(overlap)]
    if not pairs:
        raise InputError(f"the map frames of {path} do not overlap: fly more of them")
    with (
        folder_written_whole(scene.map_path) as folder,
        progress_bar("map", len(images) + len(pairs)) as advance,
    ):
        sparse_map, features = triangulate(
            scene.images_root, images, pairs, folder, SiftOptions(), advance
        )
        write_features(folder / FEATURES, features)
    draw_pictures(finish(path, scene.manifest))
    return sparse_map


def choose_pairs(overlap: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of frames worth matching, each once, from their overlap (N, N)."""
    pairs = set()
    for i, shares in enumerate(overlap):
        best = np.argsort(-shares, kind="stable")[:_MAX_NEIGHBOURS].tolist()
        pairs |= {(min(i, j), max(i, j)) for j in best if shares[j] > _MIN_OVERLAP}
    return sorted(pairs)


def _map_frames(scene: Scene) -> tuple[list[PosedImage], NDArray[np.float64]]:
    """The map's photographs, N of them, and their overlap (N, N)."""
    wanted = set(scene.splits.map)
    images, points = [], []
    for session in scene.sessions:
        frames = scene.frames(session)
        with scene.dense(session) as dense:
            for k, name in enumerate(frames.names):
                if name in wanted:
                    camera, pose = frames.cameras[k], frames.cam_from_world[k]
                    images.append(PosedImage(name, camera, pose))
                    points.append(surface_points(camera, pose, dense.read("depth", k)))
    if not images:
        raise InputError(f"{scene.path} has no map frames: its splits.json lists none")
    poses = np.stack([image.cam_from_world for image in images])
    return images, overlap_matrix([image.camera for image in images], poses, np.stack(points))
