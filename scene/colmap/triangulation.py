"""Triangulation: maps from photographs with known poses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import pycolmap

from scene.colmap.database import MappingJob, match_posed, write_database
from scene.colmap.models import posed_model, write_model
from scene.colmap.native import ROOM, SEED, Progress
from scene.colmap.sift import read_features
from scene.errors import InputError
from scene.maps.colmap_files import read_model
from scene.maps.features import Features
from scene.maps.photographs import PosedImage
from scene.maps.sparse_map import SparseMap
from scene.storage.scratch import scratch


def triangulate(
    job: MappingJob, out: Path, on_progress: Progress | None = None
) -> tuple[SparseMap, dict[str, Features]]:
    """Build a map by triangulating SIFT matches with known poses, and write the model to ``out``.

    Args:
        job: photographs; their poses are exact and do not change.
        out: existing folder for the model.
        on_progress: called with the number of images and pairs done.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: an image is missing, damaged or not of its camera's size, or no point could be
            triangulated.
    """
    with scratch(out) as folder:
        database = job.database or folder / "database.db"
        posed, features = match_posed(job, database, on_progress)
        return _triangulate(posed, database, job.root, out), features


def _triangulate(
    posed: pycolmap.Reconstruction, database: Path, root: Path, out: Path
) -> SparseMap:
    result = pycolmap.triangulate_points(
        posed, database, root, out, clear_points=True, options=pipeline_options()
    )
    if not result.num_points3D():
        raise InputError(
            f"no point could be triangulated from the {posed.num_images()} images of {root}: "
            "they need overlap and texture"
        )
    write_model(result, out)
    return read_model(out)


def triangulate_matched(
    root: Path, images: Sequence[PosedImage], database: Path, out: Path
) -> tuple[SparseMap, dict[str, Features]]:
    """Triangulate some of the images of a filled database again; their poses do not change.

    Args:
        root: folder that the names are relative to.
        images: some of the images of ``database``; matches with others are ignored.
        database: file filled by ``match_photographs``.
        out: existing folder for the model.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: no point could be triangulated.
    """
    features = read_features(database, root)
    wanted = {image.name: features[image.name] for image in images}
    size = sum(24 * len(item.xy) for item in wanted.values())
    with scratch(out, ROOM + 2 * size) as folder:
        part = folder / "database.db"
        posed, ids = posed_model(images, {name: item.xy for name, item in wanted.items()})
        write_database(part, posed)
        with pycolmap.Database.open(database) as db, pycolmap.Database.open(part) as copy:
            old = {image.name: image.image_id for image in db.read_all_images()}
            for name, item in wanted.items():
                copy.write_keypoints(ids[name], item.xy)
            for a, b in combinations(wanted, 2):
                if db.exists_two_view_geometry(old[a], old[b]):
                    geometry = db.read_two_view_geometry(old[a], old[b])
                    copy.write_two_view_geometry(ids[a], ids[b], geometry)
        return _triangulate(posed, part, root, out), wanted


def pipeline_options() -> pycolmap.IncrementalPipelineOptions:
    """Return the options of COLMAP's mapper: seeded, on one thread, with fixed calibration."""
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.random_seed = pipeline.triangulation.random_seed = SEED
    pipeline.mapper.random_seed = SEED
    pipeline.num_threads = 1  # with more threads sums are rounded differently from run to run
    pipeline.ba_refine_focal_length = False
    pipeline.ba_refine_extra_params = False
    # Otherwise the first image of every camera would change its calibration.
    pipeline.mapper.abs_pose_refine_focal_length = False
    pipeline.mapper.abs_pose_refine_extra_params = False
    return pipeline
