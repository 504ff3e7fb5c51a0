"""Flights of real photographs: a COLMAP map, queries, reference poses, and GPS as the prior."""

from __future__ import annotations

import os
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.identity import parts_of
from benchmark.datasets.textfiles import (
    read_cameras,
    read_gps,
    read_poses,
    read_priors,
    require_same_case,
)
from scene.errors import InputError
from scene.localizer import Prior
from scene.maps.colmap_files import read_model
from scene.maps.sparse_map import SparseMap

TRACK: Final = "flight"
SPARSE_SUFFIX: Final = "-sparse"

# Map and queries come from one flight: one season, one hour.
_CONDITION: Final = "same-flight"

# Fewer residuals than this say nothing about how good the GPS is.
_MIN_FIXES = 3
# A sigma of zero would make a prior that no measurement can move.
_MIN_SIGMA = 0.01


def is_flight(path: Path) -> bool:
    """Whether a folder looks like a flight, complete or not."""
    marks = ("queries.txt", "reference_poses.txt", "sparse")
    return any((path / mark).exists() for mark in marks)


def open_flight(path: Path, sparse: bool = False) -> list[Dataset]:
    """Open a flight and, where it has one, its hard split.

    Args:
        path: folder of the flight.
        sparse: open the hard split alone.

    Raises:
        InputError: a file is missing or wrong, a query has no reference pose or no photograph, a
            reference pose has no query, or a query is one of the map's own photographs.
    """
    name = path.resolve().name
    hard = path / "sparse" / "map_sparse"
    if sparse:
        return [_open(path, name + SPARSE_SUFFIX, hard, "_sparse")]
    datasets = [_open(path, name, path / "sparse" / "map", "")]
    if hard.exists():
        datasets.append(_open(path, name + SPARSE_SUFFIX, hard, "_sparse"))
    return datasets


def _open(path: Path, name: str, model: Path, ending: str) -> Dataset:
    query_list = path / f"queries{ending}.txt"
    pose_file = path / f"reference_poses{ending}.txt"
    cameras = read_cameras(query_list)
    references = read_poses(pose_file)
    if not cameras:
        raise InputError(f"{query_list} lists no query")
    for query in cameras.keys() - references.keys():
        raise InputError(f"{query_list}: query {query} has no reference pose in {pose_file}")
    for query in references.keys() - cameras.keys():
        raise InputError(f"{pose_file}: {query} is not a query of {query_list}")
    images = path / "images"
    for query in cameras:
        if not (images / query).is_file():
            raise InputError(f"image {images / query} does not exist, but {query_list} lists it")

    sparse_map = read_model(model)
    for query in cameras.keys() & sparse_map.images.keys():
        raise InputError(f"{query_list}: query {query} is a photograph of the map {model}")
    priors = _priors(path, sparse_map, {*cameras, *sparse_map.images})
    queries = tuple(
        BenchmarkQuery(
            query, _CONDITION, name, camera, images / query, priors.get(query), references[query]
        )
        for query, camera in cameras.items()
    )
    return Dataset(
        name=name,
        track=TRACK,
        parts=parts_of(model, images, sparse_map.names, queries),
        map_conditions=(_CONDITION,),
        model=model,
        load_map=lambda: sparse_map,
        images=images,
        queries=queries,
    )


def _priors(path: Path, sparse_map: SparseMap, photographs: Set[str]) -> dict[str, Prior]:
    """Starting information by photograph; empty where the flight has none."""
    # What stands there, and be it a link to nowhere, is meant to be read.
    if os.path.lexists(path / "priors.csv"):
        priors = read_priors(path / "priors.csv")
        require_same_case(path / "priors.csv", priors, photographs)
        return priors
    if not os.path.lexists(path / "gps.csv"):
        return {}
    fixes = read_gps(path / "gps.csv")
    require_same_case(path / "gps.csv", fixes, photographs)
    sigma = gps_sigma(fixes, sparse_map)
    return {name: Prior(position, sigma) for name, position in fixes.items()}


def gps_sigma(
    fixes: Mapping[str, NDArray[np.float64]], sparse_map: SparseMap
) -> NDArray[np.float64] | None:
    """How far GPS is from the map's own photographs: rms per axis E, N, U in metres, (3,).

    The table states no accuracy, and queries may not be asked: their poses are the answer. A
    constant offset counts, because a localizer cannot remove it either. None when fewer than three
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
    return np.asarray(np.maximum(rms, _MIN_SIGMA))
