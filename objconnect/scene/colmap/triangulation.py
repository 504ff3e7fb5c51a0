"""Triangulation: maps from photographs with known poses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import pycolmap

from objconnect.scene.colmap.database import MappingJob, match_with_poses, write_database
from objconnect.scene.colmap.models import add_map_points, make_model, write_model
from objconnect.scene.colmap.native import MIN_FREE_BYTES, SEED, Progress
from objconnect.scene.colmap.sift import read_features
from objconnect.scene.errors import NoPointsError
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.scratch import scratch


def triangulate(
    job: MappingJob, out: Path, on_progress: Progress | None = None
) -> tuple[SparseMap, dict[str, Features]]:
    """Build a map by triangulating SIFT matches with known poses, and write the model to ``out``.

    Args:
        job: photographs; their poses are fixed.
        out: existing folder for the model.
        on_progress: called with the number of images and pairs done.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: an image is missing, damaged or not of its camera's size.
        NoPointsError: no point could be triangulated.
    """
    with scratch(out) as folder:
        database = job.database or folder / "database.db"
        posed, features = match_with_poses(job, database, on_progress)
        return _triangulate(posed, database, job.root, out), features


def _triangulate(
    posed: pycolmap.Reconstruction, database: Path, root: Path, out: Path
) -> SparseMap:
    result = pycolmap.triangulate_points(
        posed, database, root, out, clear_points=True, options=pipeline_options()
    )
    if not result.num_points3D():
        raise NoPointsError(
            f"no point could be triangulated from the {posed.num_images()} images of {root}: "
            "they need overlap and texture"
        )
    write_model(result, out)
    return read_model(out)


def triangulate_again(
    root: Path,
    images: Sequence[PosedImage],
    database: Path,
    out: Path,
    known: SparseMap | None = None,
) -> tuple[SparseMap, dict[str, Features]]:
    """Triangulate a selection of the images of a filled database again; their poses are fixed.

    Args:
        root: folder that the names are relative to.
        images: some of the images of ``database``; matches with others are ignored.
        database: file filled by ``match_photographs`` or ``match_new``.
        out: existing folder for the model.
        known: map of some of the images, with the same poses and keypoints. Its points change only
            if an image that the map lacks observes them.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        NoPointsError: no point could be triangulated.
    """
    features = read_features(database, root)
    selected = {image.name: features[image.name] for image in images}
    # A keypoint in a database is six float32.
    size = sum(24 * len(item.xy) for item in selected.values())
    with scratch(out, MIN_FREE_BYTES + 2 * size) as folder:
        new_database = folder / "database.db"
        posed, ids = make_model(images, {name: item.xy for name, item in selected.items()})
        write_database(new_database, posed)
        with pycolmap.Database.open(database) as db, pycolmap.Database.open(new_database) as new_db:
            old_ids = {image.name: image.image_id for image in db.read_all_images()}
            for name, item in selected.items():
                new_db.write_keypoints(ids[name], item.xy)
            for a, b in combinations(selected, 2):
                if db.exists_two_view_geometry(old_ids[a], old_ids[b]):
                    geometry = db.read_two_view_geometry(old_ids[a], old_ids[b])
                    new_db.write_two_view_geometry(ids[a], ids[b], geometry)
        if known is None:
            return _triangulate(posed, new_database, root, out), selected
        add_map_points(posed, {name: ids[name] for name in known.names}, known)
        added = {image_id: name for name, image_id in ids.items() if name not in known.images}
        _triangulate_added(posed, new_database, set(added))
        for image_id, name in added.items():
            posed.extract_colors_for_image(image_id, root / name)
        posed.update_point_3d_errors()
        write_model(posed, out)
        return read_model(out), selected


def _triangulate_added(model: pycolmap.Reconstruction, database: Path, added: set[int]) -> None:
    """Triangulate the points of images that were added to a map.

    It triangulates once, then extends, merges, adjusts and filters points in rounds, as COLMAP does
    for a whole map.

    Args:
        model: all images with their poses, and the points of the map.
        database: database of keypoints and matches.
        added: identifiers of the added images.
    """
    options = pipeline_options()
    cache_options = pycolmap.DatabaseCacheOptions()
    cache_options.min_num_matches = options.min_num_matches
    with pycolmap.Database.open(database) as db:
        graph = pycolmap.DatabaseCache.create(db, cache_options).correspondence_graph
    manager = pycolmap.ObservationManager(model, graph)
    triangulator = pycolmap.IncrementalTriangulator(graph, model, manager)
    original_xyz = {point_id: point.xyz.copy() for point_id, point in model.points3D.items()}
    for image_id in sorted(added):
        triangulator.triangulate_image(options.triangulation, image_id)
    ever_observed = _find_observed_ids(model, added)
    for _ in range(options.ba_global_max_refinements):
        changed = triangulator.complete_tracks(
            options.triangulation, _find_observed_ids(model, added)
        )
        changed += triangulator.merge_tracks(
            options.triangulation, _find_observed_ids(model, added)
        )
        observed = _find_observed_ids(model, added)
        if not observed:
            break
        ever_observed |= observed
        _adjust_points(model, observed)
        changed += manager.filter_points3D(
            options.mapper.filter_max_reproj_error, options.mapper.filter_min_tri_angle, observed
        )
        if changed <= options.ba_global_max_refinement_change * len(observed):
            break
    # Restore points whose observations by added images were all filtered.
    for point_id in (ever_observed - _find_observed_ids(model, added)) & original_xyz.keys():
        if model.exists_point3D(point_id):
            model.point3D(point_id).xyz = original_xyz[point_id]


def _find_observed_ids(model: pycolmap.Reconstruction, images: set[int]) -> set[int]:
    """Return the identifiers of the points that at least one of the images observes."""
    return {
        point.point3D_id
        for image_id in images
        for point in model.image(image_id).points2D
        if point.has_point3D()
    }


def _adjust_points(model: pycolmap.Reconstruction, points: set[int]) -> None:
    """Adjust the given points of a model and keep everything else fixed."""
    config = pycolmap.BundleAdjustmentConfig()
    for point_id in points:
        config.add_variable_point(point_id)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_focal_length = options.refine_extra_params = False
    options.ceres.solver_options.num_threads = 1
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def pipeline_options() -> pycolmap.IncrementalPipelineOptions:
    """Return the options of COLMAP's mapper: seeded, on one thread, with fixed calibration."""
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.random_seed = pipeline.triangulation.random_seed = SEED
    pipeline.mapper.random_seed = SEED
    pipeline.num_threads = 1  # with more threads rounding is not reproducible
    pipeline.ba_refine_focal_length = False
    pipeline.ba_refine_extra_params = False
    # Otherwise the first image of every camera would change its calibration.
    pipeline.mapper.abs_pose_refine_focal_length = False
    pipeline.mapper.abs_pose_refine_extra_params = False
    return pipeline
