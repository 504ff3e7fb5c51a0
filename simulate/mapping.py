"""The sparse map of a scene, with its known poses or by structure from motion."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scene.bundle import FEATURES, Scene, finish
from scene.colmap import PosedImage, SiftOptions, reconstruct, triangulate
from scene.errors import InputError
from scene.features import write_features
from scene.files import folder_written_whole
from scene.progress import progress_bar
from simulate.map_report import MapReport, report
from simulate.pictures import draw_pictures

Method = Literal["triangulate", "sfm"]

# A pair is worth matching when this share of one picture is seen in the other, ...
_MIN_OVERLAP = 0.2
# ... and each picture is matched with at most so many others, those of largest overlap.
_MAX_NEIGHBOURS = 20


def build_map(path: Path, method: Method = "triangulate") -> MapReport:
    """Build the map of a finished scene from its map frames and record it in the manifest.

    An older map is replaced once the new one is whole. The model is in world metres; the features
    it was built from lie beside it.

    Args:
        path: of the scene.
        method: triangulation with the exact poses, or structure from motion that finds its own and
            is then aligned to them.

    Returns:
        The map's figures against the truth.

    Raises:
        InputError: not a finished scene, a photograph is damaged, or no map came of it.
    """
    scene = Scene.open(path)
    images, seen = _map_frames(scene)
    names = [image.name for image in images]
    pairs = [(names[i], names[j]) for i, j in choose_pairs(scene.covisibility.of(names).mutual)]
    if not pairs:
        raise InputError(f"the map frames of {path} do not overlap: fly more of them")
    build, steps = {
        "triangulate": (triangulate, len(images) + len(pairs)),
        "sfm": (reconstruct, 2 * len(images) + len(pairs)),
    }[method]
    with (
        folder_written_whole(scene.map_path) as folder,
        progress_bar("map", steps) as advance,
    ):
        sparse_map, features = build(
            scene.images_root, images, pairs, folder, SiftOptions(), advance
        )
        write_features(folder / FEATURES, features)
    scene = finish(path, scene.manifest)
    if scene.manifest.preset is not None:
        draw_pictures(scene)
    return report(sparse_map, images, scene.objects.objects, seen)


def choose_pairs(overlap: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of frames worth matching, each once, from their overlap (N, N)."""
    pairs = set()
    for i, shares in enumerate(overlap):
        best = np.argsort(-shares, kind="stable")[:_MAX_NEIGHBOURS].tolist()
        pairs |= {(min(i, j), max(i, j)) for j in best if shares[j] > _MIN_OVERLAP}
    return sorted(pairs)


def _map_frames(scene: Scene) -> tuple[list[PosedImage], set[int]]:
    """The map's photographs and the objects they show."""
    wanted = set(scene.splits.map)
    images = []
    seen: set[int] = set()
    for session in scene.sessions:
        frames = scene.frames(session)
        with scene.dense(session) as dense:
            for k, name in enumerate(frames.names):
                if name in wanted:
                    camera, pose = frames.cameras[k], frames.cam_from_world[k]
                    images.append(PosedImage(name, camera, pose))
                    if dense.has("instance"):
                        seen |= set(np.unique(dense.read("instance", k)).tolist())
    if not images:
        raise InputError(f"{scene.path} has no map frames: its splits.json lists none")
    return images, seen
