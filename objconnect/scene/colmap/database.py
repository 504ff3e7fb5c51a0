"""COLMAP's database of features and verified matches; filling it is resumable."""

from __future__ import annotations

import sqlite3
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.models import empty_model, extend_model, lens_ids, make_model
from objconnect.scene.colmap.native import MIN_FREE_BYTES, SEED, Progress, native_camera
from objconnect.scene.colmap.options import (
    EPIPOLAR_PX,
    GUESSED_EPIPOLAR_PX,
    MAX_RATIO,
    SiftOptions,
)
from objconnect.scene.colmap.sift import IMAGES_PER_CALL, extract_sift, read_features
from objconnect.scene.maps.features import Features, unit_descriptors
from objconnect.scene.maps.matching import match
from objconnect.scene.maps.photographs import Photograph, PosedImage
from objconnect.scene.runtime.cluster import worker_pool
from objconnect.scene.storage.atomic import atomic_write, write_text
from objconnect.scene.storage.files import require_disk_space
from objconnect.scene.storage.images import check_photographs

# Number of images per task on a cluster.
_IMAGES_PER_TASK = 4

# Number of pairs per chunk; finished chunks survive an interruption.
_PAIR_CHUNK = 32


@dataclass(frozen=True)
class MatchingJob:
    """Photographs to match, and the options of the detector.

    Attributes:
        root: folder that the photographs' names are relative to.
        pairs: pairs of names to match.
        sift: options of the detector.
        cluster: address of the cluster that extracts the features, see ``worker_pool``; ``root``
            has the same path on its nodes. None extracts them in this process.
    """

    root: Path
    pairs: Sequence[tuple[str, str]]
    sift: SiftOptions
    cluster: str | None = None


@dataclass(frozen=True, kw_only=True)
class MappingJob(MatchingJob):
    """Photographs with known poses to match and map.

    Attributes:
        images: photographs with their poses.
        database: file for features and matches, new or of an interrupted call with an equal job;
            None uses a temporary file.
    """

    images: Sequence[PosedImage]
    database: Path | None = None


def match_photographs(
    job: MatchingJob,
    photographs: Sequence[Photograph],
    database: Path,
    on_progress: Progress | None = None,
) -> None:
    """Fill a database with features and verified matches.

    Repeating an interrupted call with the same arguments resumes it.

    Args:
        job: pairs and options.
        photographs: all photographs; each must be readable and have the size of its camera.
        database: file, new or of an interrupted call.
        on_progress: called with the number of photographs and pairs done.

    Raises:
        InputError: a photograph is missing or damaged, or the file cannot be written.
    """
    ids = {photograph.name: k for k, photograph in enumerate(photographs, 1)}
    camera_ids = lens_ids(photographs)
    cameras = {p.lens: native_camera(p.camera, camera_ids[p.lens]) for p in photographs}
    for photograph in photographs:
        cameras[photograph.lens].has_prior_focal_length = photograph.focal_known
    model = empty_model(cameras.values())
    for photograph in photographs:
        native = pycolmap.Image(
            name=photograph.name,
            camera_id=camera_ids[photograph.lens],
            image_id=ids[photograph.name],
        )
        model.add_image_with_trivial_frame(native)
    ensure_database(database, model)
    fill_database(database, ids, job, GUESSED_EPIPOLAR_PX, on_progress)


def match_with_poses(
    job: MappingJob, database: Path, on_progress: Progress | None
) -> tuple[pycolmap.Reconstruction, dict[str, Features]]:
    """Fill a database with verified matches of posed images.

    Returns:
        The posed images as a model with keypoints and without points, and their features by name.

    Raises:
        InputError: a photograph is missing, damaged or not of its camera's size, or the file cannot
            be written.
    """
    images = job.images
    check_photographs(job.root, {image.name: image.camera for image in images})
    empty, ids = make_model(images, {image.name: np.zeros((0, 2)) for image in images})
    ensure_database(database, empty)
    fill_database(database, ids, job, EPIPOLAR_PX, on_progress)
    features = read_features(database, job.root)
    return make_model(images, {name: item.xy for name, item in features.items()})[0], features


def fill_database(
    database: Path,
    ids: Mapping[str, int],
    job: MatchingJob,
    max_error: float,
    on_progress: Progress | None,
) -> None:
    """Extract, match and verify everything that a database of images lacks.

    Args:
        database: file that holds the images.
        ids: identifiers of the images in the database, by name.
        job: pairs and options.
        max_error: inlier threshold of the verification, pixels.
        on_progress: called with the number of images and pairs done.
    """
    root, pairs = job.root, job.pairs

    def report(done: int) -> None:
        if on_progress is not None:
            on_progress(done)

    with pycolmap.Database.open(database) as db:
        missing = [name for name in ids if not db.exists_keypoints(ids[name])]
        done = len(ids) - len(missing)
        with closing(_extract_features(job, missing, database.parent)) as chunks:
            for features in chunks:
                require_disk_space(database, MIN_FREE_BYTES + 2 * _count_bytes(features))
                _write_features(db, ids, features)
                done += len(features)
                report(done)
    descriptors = {
        name: unit_descriptors(item.descriptors)
        for name, item in read_features(database, root).items()
    }
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    verification.ransac.max_error = max_error
    pair_list = database.with_suffix(".pairs")
    for start in range(0, len(pairs), _PAIR_CHUNK):
        chunk_of_pairs = pairs[start : start + _PAIR_CHUNK]
        with pycolmap.Database.open(database) as db:
            missing_pairs = [
                (a, b) for a, b in chunk_of_pairs if not db.exists_two_view_geometry(ids[a], ids[b])
            ]
            for a, b in missing_pairs:
                require_disk_space(database, MIN_FREE_BYTES)
                if not db.exists_matches(ids[a], ids[b]):
                    matches = match(descriptors[a], descriptors[b], MAX_RATIO)
                    db.write_matches(ids[a], ids[b], matches.astype(np.uint32))
        if missing_pairs:
            require_disk_space(database, MIN_FREE_BYTES)
            write_text(pair_list, "".join(f"{a} {b}\n" for a, b in missing_pairs))
            pycolmap.verify_matches(database, pair_list, verification)
        report(len(ids) + start + len(chunk_of_pairs))
    pair_list.unlink(missing_ok=True)


def _count_bytes(features: Mapping[str, Features]) -> int:
    """Return the bytes that features take in a database; a keypoint is six float32."""
    return sum(item.descriptors.nbytes + 24 * len(item.xy) for item in features.values())


def _write_features(
    db: pycolmap.Database, ids: Mapping[str, int], features: Mapping[str, Features]
) -> None:
    """Write the features of images in one transaction; COLMAP stores a scale as a 2x2 matrix."""
    with pycolmap.DatabaseTransaction(db):
        for name, item in features.items():
            sift = pycolmap.FeatureExtractorType.SIFT
            native = pycolmap.FeatureDescriptors(sift, item.descriptors)
            db.write_descriptors(ids[name], native)
            shape = item.scale[:, None] * np.eye(2, dtype=np.float32).reshape(1, 4)
            db.write_keypoints(ids[name], np.hstack([item.xy, shape]))


def write_matches(
    path: Path,
    images: Sequence[PosedImage],
    features: Mapping[str, Features],
    matches: Sequence[tuple[str, str, NDArray[np.int64]]],
    photographs: Sequence[Photograph] = (),
) -> None:
    """Write a database of posed images with features and verified matches.

    Args:
        path: new file.
        images: images in the order of their identifiers, as for ``models.write_with_poses``.
        features: features of some of them, by name.
        matches: names of two images and their matching keypoints, (K, 2).
        photographs: further images without pose, features and matches.

    Raises:
        WriteError: the disk has no space.
    """
    keypoints = {image.name: np.zeros((0, 2)) for image in images}
    model, ids = extend_model(images, keypoints, photographs)
    # A match is two uint32; it is stored as a match and as an inlier.
    match_bytes = 2 * sum(8 * len(rows) for _, _, rows in matches)
    require_disk_space(path, MIN_FREE_BYTES + 2 * (_count_bytes(features) + match_bytes))
    write_database(path, model)
    with pycolmap.Database.open(path) as db:
        _write_features(db, ids, features)
        with pycolmap.DatabaseTransaction(db):
            for a, b, rows in matches:
                native = rows.astype(np.uint32)
                first, second = model.image(ids[a]), model.image(ids[b])
                geometry = pycolmap.TwoViewGeometry()
                geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                geometry.cam2_from_cam1 = second.cam_from_world() * first.cam_from_world().inverse()
                geometry.E = pycolmap.essential_matrix_from_pose(geometry.cam2_from_cam1)
                geometry.inlier_matches = native
                db.write_matches(ids[a], ids[b], native)
                db.write_two_view_geometry(ids[a], ids[b], geometry)


def _extract_features(
    job: MatchingJob, names: Sequence[str], parent: Path
) -> Generator[dict[str, Features], None, None]:
    """Yield the SIFT features of many images, a chunk at a time.

    Temporary files lie in ``parent``, or on a cluster in the temporary folder of each node.
    """
    size = IMAGES_PER_CALL if job.cluster is None else _IMAGES_PER_TASK
    chunks = [names[start : start + size] for start in range(0, len(names), size)]
    threads, temporary = (-1, parent) if job.cluster is None else (1, None)
    extract = partial(_extract_chunk, job.root, job.sift, threads, temporary)
    with worker_pool(job.cluster if chunks else None, extract) as workers:
        yield from workers.map(chunks)


def _extract_chunk(
    root: Path, options: SiftOptions, threads: int, parent: Path | None, names: Sequence[str]
) -> Iterator[dict[str, Features]]:
    yield extract_sift(root, names, options, threads=threads, parent=parent)


def ensure_database(database: Path, model: pycolmap.Reconstruction) -> None:
    """Write a database of the model's images unless a sound one exists."""
    if not is_sound(database):
        for journal in ("-journal", "-wal", "-shm"):
            database.with_name(database.name + journal).unlink(missing_ok=True)
        require_disk_space(database, MIN_FREE_BYTES)
        write_database(database, model)


def is_sound(database: Path) -> bool:
    """Return whether a database exists and is sound; COLMAP ends the process on a damaged one."""
    if not database.is_file():
        return False
    try:
        with closing(sqlite3.connect(database)) as connection:
            return connection.execute("PRAGMA quick_check").fetchall() == [("ok",)]
    except sqlite3.DatabaseError:
        return False


def write_database(path: Path, model: pycolmap.Reconstruction) -> None:
    """Write a database of the model's images with the model's own identifiers.

    COLMAP's extractor would number images in the order in which it finishes them, and identifiers
    decide the order of all later steps.
    """
    with atomic_write(path) as unfinished, pycolmap.Database.open(unfinished) as db:
        for camera in model.cameras.values():
            db.write_camera(camera, use_camera_id=True)
        for rig in model.rigs.values():
            db.write_rig(rig, use_rig_id=True)
        for frame in model.frames.values():
            db.write_frame(frame, use_frame_id=True)
        for image in model.images.values():
            db.write_image(image, use_image_id=True)
