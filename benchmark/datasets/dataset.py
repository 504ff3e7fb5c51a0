"""The types of a data set: a map, and queries whose poses are known or withheld (*sealed*).

The readers beside this module build them from the files of each kind of data set.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.courses import find_courses
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.names import is_utf8

if TYPE_CHECKING:  # pose.py loads torch
    from objconnect.scene.geometry.pose import Pose


@dataclass(frozen=True)
class TaskQuery:
    """A query without its reference pose.

    Attributes:
        name: unique within the data set.
        condition: season and light, or another property that divides the data set.
        group: flight or drive that the query belongs to; errors within a flight are correlated.
        camera: calibrated camera of the photograph.
        image: file of the photograph.
        prior: starting information, or None where the data set has none for this query.
    """

    name: str
    condition: str
    group: str
    camera: Camera
    image: Path
    prior: Prior | None

    def load(self, prior: Prior | None = None, references: tuple[str, ...] | None = None) -> Query:
        """Read the photograph and return the query as a localizer gets it.

        Args:
            prior: starting information that the localizer is given.
            references: map photographs that the localizer has to use.

        Raises:
            InputError: the photograph is missing, damaged, or not of the camera's size.
        """
        image = read_rgb(self.image, self.camera)
        return Query(self.name, image, self.camera, prior, references)


@dataclass(frozen=True)
class BenchmarkQuery(TaskQuery):
    """A query and its reference pose, which no localizer sees.

    Attributes:
        reference: ``cam_from_world`` that an estimate is scored against.
    """

    reference: Pose

    def without_reference(self) -> TaskQuery:
        """Return the query without its reference pose."""
        values = vars(self)
        return TaskQuery(**{each.name: values[each.name] for each in fields(TaskQuery)})


@dataclass(frozen=True)
class Task:
    """A map and queries, which a method can localize, without the reference poses.

    Attributes:
        name: name of the data set and of the folder of its results.
        track: what the data set can show: "uav-sim" (changed season and light), "flight"
            (photographs of one flight) or "cmu" (photographs from a car through a year; "cmu-sim"
            if they are simulated).
        parts: digests of everything the data set is made of, by descriptive names (see
            ``benchmark.datasets.identity``).
        map_conditions: conditions under which the map's photographs were taken.
        model: folder of the map's files.
        load_map: reads the map.
        images: folder that the map's image names are relative to.
        queries: never empty, in the order of the data set's own list.
    """

    name: str
    track: str
    parts: Mapping[str, str]
    map_conditions: tuple[str, ...]
    model: Path
    load_map: Callable[[], SparseMap]
    images: Path
    queries: tuple[TaskQuery, ...]

    def __post_init__(self) -> None:
        """Check that a results file can hold every name.

        Raises:
            InputError: a name is not UTF-8.
        """
        for name in (self.name, *(query.name for query in self.queries)):
            if not is_utf8(name):
                raise InputError(f"{for_terminal(name)!r}: this name is not UTF-8: rename it")

    @cached_property
    def sha256(self) -> str:
        """Digest of all parts, their names and their order; one changed byte changes it."""
        return digest_of_parts(self.parts)


@dataclass(frozen=True)
class Dataset(Task):
    """A map, and queries with reference poses.

    Attributes:
        unjudged: thresholds for which the reference poses are too inexact, such as ``0.25 m 2°``;
            ``1 m`` is the position error above which an answer counts as wrong.
    """

    queries: tuple[BenchmarkQuery, ...]
    unjudged: tuple[str, ...] = ()

    @cached_property
    def courses(self) -> dict[str, str]:
        """Name of each flight's path (course) by the group of its queries, see ``find_courses``."""
        centres: dict[str, list[NDArray[np.float64]]] = {}
        for query in self.queries:
            centres.setdefault(query.group, []).append(query.reference.centre().numpy())
        return find_courses({group: np.stack(rows) for group, rows in centres.items()})


def digest_of_parts(parts: Mapping[str, str]) -> str:
    """Return the digest of a data set from the digests of its parts."""
    return sha256(json.dumps(list(parts.items())))
