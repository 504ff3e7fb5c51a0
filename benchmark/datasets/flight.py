"""Reader of flights: real photographs with a COLMAP map, queries, reference poses and GPS."""

from __future__ import annotations

import os
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.identity import parts_of
from benchmark.scoring.score import list_unjudged
from objconnect.scene.errors import InputError
from objconnect.scene.flights.origin import read_origin
from objconnect.scene.flights.priors import AssumedSigmas, MapFrame, PriorTable
from objconnect.scene.flights.reference_error import read_reference_error
from objconnect.scene.flights.textfiles import (
    read_cameras,
    read_conditions,
    read_gps,
    read_poses,
    read_priors,
    require_same_case,
)
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import SparseMap

TRACK: Final = "flight"
SPARSE_SUFFIX: Final = "-sparse"

# Condition of all photographs of a flight without a table of conditions: map and queries are then
# taken as photographs of one flight, under the same season and light.
_DEFAULT_CONDITION: Final = "same-flight"

# With fewer residuals than this, the accuracy of the GPS is unknown.
_MIN_FIXES = 3
# A sigma of zero would make a prior that no measurement can move.
_MIN_SIGMA_M = 0.01


def is_flight(path: Path) -> bool:
    """Return whether a folder looks like a flight, complete or not."""
    marks = ("queries.txt", "reference_poses.txt", "sparse")
    return any((path / mark).exists() for mark in marks)


def open_flight(path: Path, hard_only: bool = False) -> list[Dataset]:
    """Open a flight and, where it has one, its hard split, which has a sparser map.

    Args:
        path: folder of the flight.
        hard_only: open the hard split alone.

    Raises:
        InputError: a file is missing or wrong, a query has no reference pose or no photograph, a
            reference pose has no query, or a query is a photograph of the map.
    """
    name = path.resolve().name
    hard = path / "sparse" / "map_sparse"
    if hard_only:
        return [_open_split(path, name + SPARSE_SUFFIX, hard, "_sparse")]
    datasets = [_open_split(path, name, path / "sparse" / "map", "")]
    if hard.exists():
        datasets.append(_open_split(path, name + SPARSE_SUFFIX, hard, "_sparse"))
    return datasets


class FlightReader:
    """Reads flights; see ``benchmark.datasets.open.Reader``."""

    name = "flight"
    holds = "queries.txt, reference_poses.txt and sparse/map (a flight)"

    def recognizes(self, path: Path) -> bool:
        """Return whether a path is a flight's folder, or that folder with the ending "-sparse"."""
        if path.is_dir():
            return is_flight(path)
        folder = _strip_suffix(path)
        return folder != path and is_flight(folder)

    def open(self, path: Path) -> list[Dataset]:
        """Open a flight; ``open_flight`` says which errors are raised."""
        if path.is_dir():
            return open_flight(path)
        datasets = open_flight(_strip_suffix(path), hard_only=True)
        return [dataset for dataset in datasets if dataset.name == path.name]


READER: Final = FlightReader()


def _strip_suffix(path: Path) -> Path:
    """Return a path without the ending "-sparse" that names the hard split."""
    return path.with_name(path.name.removesuffix(SPARSE_SUFFIX)) if path.name else path


def _open_split(path: Path, name: str, model: Path, ending: str) -> Dataset:
    """Open one split of a flight.

    Args:
        path: folder of the flight.
        name: name of the data set.
        model: folder of the split's map.
        ending: ending of the names of the split's lists, before ".txt".
    """
    query_list = path / f"queries{ending}.txt"
    pose_file = path / f"reference_poses{ending}.txt"
    cameras = read_cameras(query_list)
    references = read_poses(pose_file)
    if not cameras:
        raise InputError(f"{query_list} lists no query: add lines NAME MODEL WIDTH HEIGHT PARAMS")
    for query in cameras.keys() - references.keys():
        raise InputError(
            f"{query_list}: query {query} has no reference pose in {pose_file}: add the pose, or "
            "remove the query"
        )
    for query in references.keys() - cameras.keys():
        raise InputError(
            f"{pose_file}: {query} is not a query of {query_list}: add the query, or remove the "
            "pose"
        )
    images = path / "images"
    for query in cameras:
        if not (images / query).is_file():
            raise InputError(
                f"image {images / query} does not exist, but {query_list} lists it: add the image, "
                "or remove the query"
            )

    sparse_map = read_model(model)
    for query in cameras.keys() & sparse_map.images.keys():
        raise InputError(
            f"{query_list}: query {query} is a photograph of the map {model}: remove the query"
        )
    priors = _read_priors(path, sparse_map, {*cameras, *sparse_map.images})
    conditions = photograph_conditions(path, sparse_map.images.keys(), cameras.keys())
    queries = tuple(
        BenchmarkQuery(
            query,
            conditions[query],
            name,
            camera,
            images / query,
            priors.get(query),
            references[query],
        )
        for query, camera in cameras.items()
    )
    return Dataset(
        name=name,
        track=TRACK,
        parts=parts_of(model, images, sparse_map.names, queries),
        map_conditions=tuple(dict.fromkeys(conditions[image] for image in sparse_map.names)),
        model=model,
        load_map=lambda: sparse_map,
        images=images,
        queries=queries,
        unjudged=_list_unjudged(path),
    )


def _list_unjudged(path: Path) -> tuple[str, ...]:
    """Return the thresholds for which the reference poses of a flight are too inexact."""
    error = read_reference_error(path)
    return () if error is None else list_unjudged(error)


def photograph_conditions(path: Path, map_names: Set[str], queries: Set[str]) -> dict[str, str]:
    """Return the condition of each photograph of the map and of each query.

    Args:
        path: folder of the flight.
        map_names: names of the map's photographs.
        queries: names of the queries.

    Raises:
        InputError: the table of conditions is wrong, or lacks one of them.
    """
    photographs, table = sorted({*map_names, *queries}), path / "conditions.csv"
    if not os.path.lexists(table):
        return dict.fromkeys(photographs, _DEFAULT_CONDITION)
    conditions = read_conditions(table)
    require_same_case(table, conditions, photographs)
    for name in photographs:
        if name not in conditions:
            raise InputError(f"{table} has no condition for {name}: add a row for it")
    return conditions


def _read_priors(path: Path, sparse_map: SparseMap, photographs: Set[str]) -> dict[str, Prior]:
    """Return the prior of each photograph that has one."""
    # lexists is true of a broken link, which is then an error instead of a missing file.
    if os.path.lexists(path / "priors.csv"):
        table = read_priors(path / "priors.csv")
        require_same_case(path / "priors.csv", table.rows, photographs)
        frame = MapFrame.of(sparse_map, read_origin(path))
        return table.priors(frame, photographs, _assume_sigmas(table, frame, sparse_map))
    if not os.path.lexists(path / "gps.csv"):
        return {}
    fixes = read_gps(path / "gps.csv")
    require_same_case(path / "gps.csv", fixes, photographs)
    sigma = gps_sigma(fixes, sparse_map)
    return {name: Prior(position, sigma) for name, position in fixes.items()}


def _assume_sigmas(table: PriorTable, frame: MapFrame, sparse_map: SparseMap) -> AssumedSigmas:
    """Return the standard deviations to assume for priors whose table states none."""
    if table.states_all_sigmas:
        return AssumedSigmas()
    sigma = gps_sigma(table.positions(frame, sparse_map.images), sparse_map)
    return AssumedSigmas(sigma, sigma_m_source="they are measured on the photographs of the map")


def gps_sigma(
    fixes: Mapping[str, NDArray[np.float64]], sparse_map: SparseMap
) -> NDArray[np.float64] | None:
    """Measure the accuracy of GPS on the map's photographs.

    The queries are not used, because their poses are the answer. A constant offset counts as error,
    because a localizer cannot remove it either.

    Args:
        fixes: (3,) east, north, up in metres by photograph.
        sparse_map: the map.

    Returns:
        (3,) root mean square difference per axis E, N, U in metres, or None if fewer than three
        photographs of the map have a GPS row.
    """
    residuals = [
        fixes[name] - image.centre
        for name, image in sorted(sparse_map.images.items())
        if name in fixes
    ]
    if len(residuals) < _MIN_FIXES:
        return None
    rms = np.sqrt(np.square(np.stack(residuals)).mean(0))
    return np.asarray(np.maximum(rms, _MIN_SIGMA_M))
