"""Write the files of an ingested scene: frames, map, split into map and queries, covisibility."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.adjustment import (
    NO_ALTITUDE_SIGMA_M,
    AdjustedModel,
    find_missing_altitudes,
)
from objconnect.ingestion.attitude import read_attitudes
from objconnect.ingestion.georegister import MIN_SIGMA_M, rms_of
from objconnect.ingestion.photographs import SESSION, FlightImage
from objconnect.ingestion.picture import PICTURE
from objconnect.ingestion.report import REPORT, residuals
from objconnect.scene.bundle.covisibility import Covisibility, visible_share, write_covisibility
from objconnect.scene.bundle.frames import Frames, write_frames
from objconnect.scene.bundle.manifest import Objects, Splits, write_json
from objconnect.scene.bundle.scene import COVISIBILITY, FEATURES, MAP_FILES
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.registration import KnownMap
from objconnect.scene.colmap.triangulation import triangulate_again
from objconnect.scene.maps.features import features_key, write_features
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.digests import digests_in

FRAMES = "frames.h5"
"""The file of poses, cameras and priors (measured poses) in the folder of a session (flight)."""

COVISIBILITY_POINTS: Final = 200
"""Number of points of each photograph on which covisibility is measured, to a few percent."""


def write_measurements(
    path: Path,
    adjusted: AdjustedModel,
    images: Sequence[FlightImage],
    fixes: Mapping[str, NDArray[np.float64]],
    queries: set[str],
) -> dict[str, float]:
    """Write the poses of the model and the GPS positions and attitudes of its photographs.

    The sigmas are measured on the map photographs, or on the queries if only these have fixes.

    Args:
        path: file ``frames.h5`` of a session.
        adjusted: the model in the world.
        images: photographs of the session, all of them in the model.
        fixes: measured positions (3,) by name, world metres.
        queries: names of the queries.

    Returns:
        By file, the error in degrees of each attitude that was not used.
    """
    model, georegistration = adjusted.model, adjusted.georegistration
    names = tuple(image.name for image in images)
    poses = np.stack([model.images[name].cam_from_world for name in names])
    measured = [name for name in names if name in fixes and name not in georegistration.blunders]
    sample = [name for name in measured if name not in queries] or measured
    rms = rms_of(residuals(model, fixes, sample)) if sample else np.zeros(3)
    sigma = np.clip(rms, MIN_SIGMA_M, NO_ALTITUDE_SIGMA_M)
    unknown = np.full(3, np.nan)
    # An unknown altitude becomes the cameras' median height, with a sigma of kilometres.
    without_altitude = find_missing_altitudes({name: fixes[name] for name in measured})
    height = float(np.median([model.images[name].centre[2] for name in model.names]))
    sigma_without_altitude = np.array([*sigma[:2], NO_ALTITUDE_SIGMA_M])
    priors = {name: fixes[name] for name in measured}
    priors |= {name: np.array([*fixes[name][:2], height]) for name in without_altitude}
    attitude, attitude_sigma, wrong = read_attitudes(images, poses, queries)
    times = [image.exif.time.timestamp() if image.exif.time else np.nan for image in images]
    frames = Frames(
        names=names,
        cameras=tuple(model.images[name].camera for name in names),
        cam_from_world=poses,
        time=np.array(times),
        gps_prior=np.array([priors.get(name, unknown) for name in names]),
        gps_sigma=np.array(
            [
                (sigma_without_altitude if n in without_altitude else sigma)
                if n in priors
                else unknown
                for n in names
            ]
        ),
        attitude_prior=attitude,
        attitude_sigma_deg=attitude_sigma,
    )
    write_frames(path, frames, (), iter([{}] * len(names)))
    return wrong


def list_own_files(images: Sequence[FlightImage], session: str) -> set[str]:
    """Return the files that ``ingest`` writes into the folder of a scene, for ``remove_owned``."""
    copies = [f"sessions/{image.name}" for image in images]
    lists = ["splits.json", "objects.json", COVISIBILITY, REPORT.name, PICTURE.as_posix()]
    return {
        *copies,
        f"sessions/{session}/{FRAMES}",
        *lists,
        *(f"map/{file}" for file in MAP_FILES),
    }


def write_map(
    out: Path,
    model: SparseMap,
    queries: set[str],
    database: Path,
    known: KnownMap | None = None,
) -> SparseMap:
    """Triangulate the map of a scene from its own photographs, and write it with its features.

    Args:
        out: folder of the scene.
        model: the poses and cameras of map photographs and queries.
        queries: names of the queries, which are left out of the map.
        database: features and verified matches of the photographs.
        known: existing map of some of the photographs; points that no new photograph observes do
            not change.

    Raises:
        InputError: no point could be triangulated.
    """
    images = [
        PosedImage(name, model.images[name].camera, model.images[name].cam_from_world)
        for name in model.names
        if name not in queries
    ]
    with atomic_folder(out / "map", MAP_FILES) as folder:
        root, known_map = out / "sessions", None if known is None else known.sparse_map
        sparse_map, features = triangulate_again(root, images, database, folder, known_map)
        # Features of a known map are copied: the file gets a key only if the known map's features
        # have the key of these photographs and options.
        has_key = known is None or known.features.inputs_digest == _sift_key(
            root, known.sparse_map.names
        )
        key = _sift_key(root, sparse_map.names) if has_key else ""
        write_features(folder / FEATURES, features, key)
    return sparse_map


def _sift_key(root: Path, names: Sequence[str]) -> str:
    """Return a digest of the inputs of SIFT features: photographs and options."""
    return features_key(digests_in(root, names), str(SiftOptions()))


def write_lists(
    out: Path,
    model: SparseMap,
    images: Sequence[FlightImage],
    queries: set[str],
) -> None:
    """Write the list of queries, an empty list of objects and the covisibility of the photographs.

    Covisibility is measured on at most ``COVISIBILITY_POINTS`` points of each photograph.
    """
    names = tuple(image.name for image in images)
    query_names = tuple(name for name in names if name in queries)
    splits = Splits(
        map=tuple(name for name in names if name not in queries),
        queries={SESSION: query_names} if query_names else {},
    )
    write_json(out / "splits.json", splits)
    write_json(out / "objects.json", Objects(classes={}, objects=()))
    write_covisibility(out / COVISIBILITY, _covisibility(model, names))


def _covisibility(model: SparseMap, names: tuple[str, ...]) -> Covisibility:
    """Measure covisibility on observed points, without testing for occlusion."""
    points = np.stack([sample_points(model, name, COVISIBILITY_POINTS) for name in names])
    images = [model.images[name] for name in names]
    poses = np.stack([image.cam_from_world for image in images])
    return Covisibility(names, visible_share([image.camera for image in images], poses, points))


def sample_points(model: SparseMap, name: str, number: int) -> NDArray[np.float64]:
    """Return points that a photograph of a model observes, (number, 3); NaN where it has fewer."""
    rows = model.images[name].point_rows
    return sample_evenly(model.xyz[rows[rows >= 0]], number)


def sample_evenly(points: NDArray[np.float64], number: int) -> NDArray[np.float64]:
    """Return ``number`` of the points (N, 3), evenly spread over their order, padded with NaN.

    The result has the shape (number, 3).
    """
    chosen = np.linspace(0, len(points) - 1, min(number, len(points))).astype(int)
    padded = np.full((number, 3), np.nan)
    padded[: len(chosen)] = points[chosen]
    return padded
