"""Build the sparse map of a scene from known poses or by structure from motion."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from objconnect.mapping.class_coverage import class_coverage
from objconnect.mapping.options import MapOptions
from objconnect.mapping.report import MapReport, ObjectTruth, report
from objconnect.scene.bundle.object_points import objects_of_points
from objconnect.scene.bundle.pictures import draw_pictures
from objconnect.scene.bundle.scene import FEATURES, MAP_FILES, Scene, finish_scene
from objconnect.scene.bundle.supplement import SUPPLEMENT
from objconnect.scene.colmap.database import MappingJob
from objconnect.scene.colmap.native import PYCOLMAP_VERSION
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.structure_from_motion import ADJUSTMENTS, reconstruct
from objconnect.scene.colmap.triangulation import triangulate
from objconnect.scene.errors import InputError, NoPointsError
from objconnect.scene.maps.features import features_key, write_features
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX, atomic_folder
from objconnect.scene.storage.digests import digest_of, digests_in
from objconnect.scene.storage.leftovers import remove_partial
from objconnect.scene.storage.locks import resumable_file, write_lock

_WORK = f"{TEMPORARY_PREFIX}mapping"
_SIFT = SiftOptions()
Method = Literal["triangulate", "sfm"]
_DEFAULTS: Final = MapOptions()

log = logging.getLogger(__name__)


def build_map(
    path: Path,
    method: Method = "triangulate",
    cluster: str | None = None,
    options: MapOptions = _DEFAULTS,
) -> MapReport:
    """Build the map of a finished scene from its map frames, and record it in ``scene.json``.

    The model is in world metres, and its features are stored beside it. An existing map is replaced
    when the new one is complete. After an interruption, a second call reuses the finished features
    and matches and builds the same map.

    Args:
        path: folder of the scene.
        method: "triangulate" with the exact poses, or "sfm", structure from motion whose poses are
            then aligned to the exact ones.
        cluster: cluster that extracts the features, see ``worker_pool``. Its nodes must see the
            scene at the same path.
        options: choice of the pairs to match.

    Returns:
        The map's errors against the truth.

    Raises:
        InputError: the scene is not finished, is being written by another run, has a damaged
            photograph, or its photographs cannot be mapped.
    """
    scene = Scene.open(path)
    with write_lock(path):
        return build_locked(scene, method, cluster, options)


def build_locked(
    scene: Scene, method: Method, cluster: str | None, options: MapOptions = _DEFAULTS
) -> MapReport:
    """Build the map of a scene whose lock the caller holds; see ``build_map``.

    Raises:
        InputError: for the reasons of ``build_map``.
        NoPointsError: the photographs show too little texture, or overlap too little.
    """
    path = scene.path
    images, ids_in_view = _map_frames(scene)
    names = [image.name for image in images]
    flights = [name.partition("/")[0] for name in names]
    chosen = choose_pairs(scene.covisibility.select(names).mutual, flights, options)
    pairs = [(names[i], names[j]) for i, j in chosen]
    if not pairs:
        raise NoPointsError(f"the map frames of {path} do not overlap: fly with more overlap")
    build, steps = {
        "triangulate": (triangulate, len(images) + len(pairs)),
        "sfm": (reconstruct, 2 * len(images) + len(pairs) + ADJUSTMENTS),
    }[method]
    remove_partial(path)
    had_supplement = (scene.map_path / SUPPLEMENT).exists()
    digest = _digest(scene.images_root, images, pairs)
    with resumable_file(path / _WORK, f"{digest}.db") as database:
        with (
            atomic_folder(scene.map_path, MAP_FILES) as folder,
            progress_bar("map", steps) as advance,
        ):
            job = MappingJob(
                scene.images_root,
                pairs,
                _SIFT,
                cluster,
                images=images,
                database=database,
            )
            sparse_map, features = build(job, folder, advance)
            photographs = digests_in(scene.images_root, sparse_map.names)
            write_features(folder / FEATURES, features, features_key(photographs, str(_SIFT)))
        scene = finish_scene(path, scene.manifest)
        if had_supplement:
            log.warning("the new map of %s lacks the points that 'supplement' had added", path)
        is_rendered = scene.manifest.preset is not None
        if is_rendered:
            draw_pictures(scene)
    instances = scene.layers_of_map(sparse_map, "instance")
    owners = objects_of_points(
        len(sparse_map.xyz), ((image, layers["instance"]) for image, layers in instances)
    )
    kinds = class_coverage(scene, sparse_map, features) if is_rendered else {}
    in_view = [item for item in scene.objects.objects if item.id in ids_in_view]
    objects = ObjectTruth(in_view, owners)
    return report(sparse_map, images, objects, len(pairs), kinds, options.model_dump(mode="json"))


def _digest(
    root: Path,
    images: Sequence[PosedImage],
    pairs: Sequence[tuple[str, str]],
) -> str:
    """Return a digest of the inputs of features and matches."""
    photographs = digests_in(root, (image.name for image in images), "missing")
    cameras = [image.camera for image in images]
    return digest_of(PYCOLMAP_VERSION, _SIFT, pairs, cameras, photographs)[:16]


def choose_pairs(
    overlap: NDArray[np.float64], flights: Sequence[str], options: MapOptions = _DEFAULTS
) -> list[tuple[int, int]]:
    """Choose the pairs of frames to match, each once: neighbours in space and in time.

    Args:
        overlap: symmetric (N, N) shares (0 to 1) of the surface in one frame that the other shows.
        flights: flight of each frame; frames of one flight are sorted by time.
        options: minimum overlap, and number of neighbours of each frame.
    """
    pairs = set()
    for i, shares in enumerate(overlap):
        best = np.argsort(-shares, kind="stable")[: options.max_neighbours].tolist()
        pairs |= {(min(i, j), max(i, j)) for j in best if shares[j] > options.min_overlap}
        following = range(i + 1, min(i + 1 + options.following, len(flights)))
        pairs |= {(i, j) for j in following if flights[j] == flights[i] and shares[j] > 0}
    return sorted(pairs)


def _map_frames(scene: Scene) -> tuple[list[PosedImage], set[int]]:
    """Return the map photographs and the identifiers of the objects they show."""
    wanted = set(scene.splits.map)
    images = []
    object_ids: set[int] = set()
    for session in scene.sessions:
        frames = scene.frames(session)
        with scene.layers(session) as layers:
            for k, name in enumerate(frames.names):
                if name in wanted:
                    camera, pose = frames.cameras[k], frames.cam_from_world[k]
                    images.append(PosedImage(name, camera, pose))
                    if layers.has("instance"):
                        object_ids |= set(np.unique(layers.read("instance", k)).tolist())
    if not images:
        raise InputError(f"{scene.path} has no map frames: its splits.json lists none")
    return images, object_ids
