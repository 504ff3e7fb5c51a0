"""Registration of photographs in a map with fixed poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.database import MatchingJob, fill_database, is_sound, write_matches
from objconnect.scene.colmap.models import extend_model, write_model, write_with_poses
from objconnect.scene.colmap.native import MIN_FREE_BYTES, Progress
from objconnect.scene.colmap.options import GUESSED_EPIPOLAR_PX
from objconnect.scene.colmap.structure_from_motion import adjust_robustly
from objconnect.scene.colmap.triangulation import pipeline_options
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import FeatureFile
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.scratch import scratch


@dataclass(frozen=True)
class KnownMap:
    """A map in which photographs are registered.

    Attributes:
        images: its photographs with their poses, in a fixed order.
        sparse_map: the map; its keypoints are those of ``features``.
        features: features of the map by name.
        matches: names of two of its photographs and their matching keypoints, (K, 2).
    """

    images: Sequence[PosedImage]
    sparse_map: SparseMap
    features: FeatureFile
    matches: Sequence[tuple[str, str, NDArray[np.int64]]]


def match_new(
    known: KnownMap,
    photographs: Sequence[Photograph],
    job: MatchingJob,
    database: Path,
    on_progress: Progress | None = None,
) -> None:
    """Fill a database with the features and matches of a map and of photographs to register.

    Features and matches of the map are copied. Repeating an interrupted call with the same
    arguments resumes it.

    Args:
        known: the map.
        photographs: photographs to register; each must be readable and have its camera's size.
        job: pairs to match, each with a new photograph; without pairs it only extracts features.
        database: file, new or of an interrupted call.
        on_progress: called with the number of images and pairs done.

    Raises:
        InputError: a photograph is missing or damaged, or the file cannot be written.
    """
    if not is_sound(database):
        with atomic_write(database) as partial:
            write_matches(partial, known.images, known.features, known.matches, photographs)
    names = [image.name for image in known.images] + [p.name for p in photographs]
    ids = {name: k for k, name in enumerate(names, 1)}
    fill_database(database, ids, job, GUESSED_EPIPOLAR_PX, on_progress)


def register_photographs(
    root: Path,
    known: KnownMap,
    photographs: Sequence[Photograph],
    database: Path,
    out: Path,
    on_progress: Progress | None = None,
) -> SparseMap:
    """Register photographs in a map by incremental structure from motion.

    Poses and cameras of the map are fixed. The distortion of uncalibrated cameras is adjusted, and
    their focal length too if it is unknown. If only some focal lengths are unknown, cameras with a
    known one stay fixed.

    Args:
        root: folder that the names are relative to.
        known: the map.
        photographs: photographs to register.
        database: file filled by ``match_new`` with the same map and photographs.
        out: existing folder for the model.
        on_progress: called with the number of photographs registered.

    Returns:
        The map and the photographs that could be registered.
    """
    empty = np.zeros((0, 2))
    model, ids = extend_model(known.images, {i.name: empty for i in known.images}, photographs)
    cameras = {name: model.image(k).camera_id for name, k in ids.items()}
    refine_focal = not all(p.focal_known for p in photographs)
    fixed = {cameras[image.name] for image in known.images} | {
        cameras[p.name] for p in photographs if p.calibrated or (refine_focal and p.focal_known)
    }
    pipeline = pipeline_options()
    pipeline.ba_refine_focal_length = refine_focal
    pipeline.mapper.abs_pose_refine_focal_length = refine_focal
    pipeline.ba_refine_extra_params = True
    pipeline.fix_existing_frames = pipeline.mapper.fix_existing_frames = True
    pipeline.constant_cameras = pipeline.mapper.constant_cameras = fixed
    pipeline.multiple_models = False
    registered = 0

    def on_image() -> None:
        nonlocal registered
        registered += 1
        if on_progress is not None:
            on_progress(registered)

    with scratch(out, MIN_FREE_BYTES) as folder:
        start = folder / "known"
        start.mkdir()
        write_with_poses(known.images, known.sparse_map, start)
        models = pycolmap.incremental_mapping(
            database, root, folder, pipeline, input_path=start, next_image_callback=on_image
        )
        # COLMAP returns no model if it registers no photograph.
        largest = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
        if largest is None:
            largest = pycolmap.Reconstruction(start)
        adjust_robustly(largest, {image.name for image in known.images})
        write_model(largest, out)
    return read_model(out)
