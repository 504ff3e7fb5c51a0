"""The list of points that were added to a map, by which they can be removed again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, FiniteFloat

from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_point_ids
from objconnect.scene.storage.records import Record

SUPPLEMENT = "supplement.json"
"""The file beside a map that lists its added points."""

ADDED_FEATURES = "supplement.h5"
"""The file with the keypoints of added points and their descriptors, by photograph, in the order
of the points."""


class AddedPoint(Record):
    """One point that was added.

    Attributes:
        id: identifier of the point in COLMAP's files.
        object: number of the object that the point lies on; ``add_to_map`` assigns a new number to
            each point.
        confidence: 0..1, from the method that found the point.
    """

    id: int = Field(ge=0)
    object: int
    confidence: FiniteFloat


class Supplement(Record):
    """``supplement.json``: the added points of the map beside it.

    Attributes:
        points: added points.
        map_sha256: ``SparseMap.sha256`` of the map without the added points.
    """

    model_config = ConfigDict(populate_by_name=True)

    schema_version: Literal[1] = Field(default=1, alias="schema")
    points: tuple[AddedPoint, ...]
    map_sha256: str = Field(alias="from")


def read_supplement(folder: Path) -> Supplement | None:
    """Read the list of points added to the map of a folder; None without such a list.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / SUPPLEMENT
    return read_json(path, Supplement, "list of added points") if os.path.lexists(path) else None


def is_added_point(folder: Path, points: int) -> NDArray[np.bool_]:
    """Return which points of the map in a folder were added, in the order of ``SparseMap.xyz``.

    Args:
        folder: folder of the model.
        points: number M of points of the map.

    Returns:
        (M,) bool.

    Raises:
        InputError: the list is damaged, or names a point that the map does not have.
    """
    supplement = read_supplement(folder)
    if supplement is None:
        return np.zeros(points, bool)
    ids = read_point_ids(folder)
    listed = np.array([point.id for point in supplement.points], np.uint64)
    unknown = listed[~np.isin(listed, ids)]
    if len(unknown):
        raise InputError(
            f"{folder / SUPPLEMENT} lists point {unknown[0]}, which the map beside it does not "
            "have: the list belongs to another map; build the map again"
        )
    return np.isin(ids, listed)
