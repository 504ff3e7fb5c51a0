"""The command ``validate``, which checks the conventions of scenes and flights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.scoring.score import FALSE_FIX
from objconnect.methods import create
from objconnect.scene.bundle.scene import is_scene
from objconnect.scene.checks.conventions import (
    MAX_RESIDUAL_RATIO,
    OUR_CONVENTION,
    POSE_CONVENTIONS,
    Convention,
)
from objconnect.scene.checks.map_check import check_map, check_principal_points
from objconnect.scene.checks.report import Check, Report
from objconnect.scene.checks.validate import validate as validate_scene
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import SparseMap

# Number of queries whose reference poses are compared with poses that SIFT finds.
_PROBES = 5


def validate(path: Path, cache: Path | None = None) -> Report:
    """Check the conventions of a scene or a flight.

    Args:
        path: folder of the scene or flight. Other data sets of ``open_datasets`` are checked like
            flights.
        cache: folder for the features of a flight's map; None keeps none.

    Raises:
        InputError: the path is no data set, or a file cannot be read.
    """
    if is_scene(path):
        return validate_scene(path)
    return Report(str(path), tuple(c for d in open_datasets(path) for c in _checks(d, cache)))


def _checks(dataset: Dataset, cache: Path | None) -> Iterator[Check]:
    """Yield the checks of a data set that is not a scene."""
    sparse_map = dataset.load_map()
    cameras = [query.camera for query in dataset.queries]
    for check in (
        check_map(sparse_map),
        check_principal_points(sparse_map, cameras),
        _check_reference_poses(dataset, sparse_map, cache),
    ):
        yield replace(check, name=f"{dataset.name}: {check.name}")


def _check_reference_poses(dataset: Dataset, sparse_map: SparseMap, cache: Path | None) -> Check:
    """Localize a few queries and find the convention in which their reference poses agree."""
    name = "reference poses agree with the photographs"
    localizer = create("sift", {})
    localizer.prepare(sparse_map, dataset.images, cache)
    chosen = np.linspace(0, len(dataset.queries) - 1, min(_PROBES, len(dataset.queries)))
    localized, stated = [], []
    for query in (dataset.queries[int(k)] for k in chosen):
        pose = localizer.localize(query.load()).cam_from_world
        if pose is not None:
            localized.append(pose)
            stated.append(query.reference.matrix().numpy())
    if not localized:
        return Check(name, True, "not decided: SIFT localizes none of the queries tried")
    matrices = np.stack(stated)
    metres, degrees = _difference(localized, matrices, OUR_CONVENTION)
    figures = {"median_m": metres, "median_deg": degrees, "queries": float(len(localized))}
    # The rotation of a camera that looks straight down is nearly its own transpose, so that several
    # conventions may fit; the best one decides.
    alternatives = [
        (sum(_difference(localized, matrices, convention)), convention)
        for convention in POSE_CONVENTIONS
    ]
    best, convention = min(alternatives, key=lambda item: item[0])
    if best < MAX_RESIDUAL_RATIO * (metres + degrees):
        return Check(name, False, convention.fault, figures)
    detail = f"median {metres:.2f} m, {degrees:.2f}° from where SIFT finds {len(localized)} queries"
    ok = metres < FALSE_FIX.metres and degrees < FALSE_FIX.degrees
    return Check(name, ok, detail, figures)


def _difference(
    localized: Sequence[Pose], stated: NDArray[np.float64], convention: Convention
) -> tuple[float, float]:
    """Return the median distance (m) and angle (deg) between two lists of poses.

    Args:
        localized: poses ``cam_from_world`` that SIFT found.
        stated: (N, 4, 4) matrices of the data set.
        convention: convention by which the matrices are read.
    """
    converted = [Pose.from_matrix(matrix) for matrix in convention.poses(stated)]
    errors = [pose.error_to(other) for pose, other in zip(localized, converted, strict=True)]
    metres, degrees = np.median(np.array([[float(m), float(d)] for m, d in errors]), axis=0)
    return float(metres), float(degrees)
