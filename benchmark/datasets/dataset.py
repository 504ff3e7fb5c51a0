"""The types of a data set: a map, and queries whose poses are known.

The readers beside this module build them from the files of each kind of data set.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior, Query
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.names import is_utf8


@dataclass(frozen=True)
class BenchmarkQuery:
    """A query and its reference pose, which no localizer sees.

    Attributes:
        name: unique within the data set.
        condition: season and light, or another property that divides the data set.
        group: flight or drive that the query belongs to; errors within one are correlated.
        camera: calibrated.
        image: file of the photograph.
        prior: starting information, or None where the data set has none for this query.
        reference: ``cam_from_world`` that an estimate is scored against.
    """

    name: str
    condition: str
    group: str
    camera: Camera
    image: Path
    prior: Prior | None
    reference: Pose

    def load(self, prior: Prior | None = None, references: tuple[str, ...] | None = None) -> Query:
        """Read the photograph and return the query as a localizer gets it.

        Args:
            prior: starting information that the localizer is given.
            references: map photographs that the localizer is told to use.

        Raises:
            InputError: the photograph is missing, damaged, or not of the camera's size.
        """
        image = read_rgb(self.image, self.camera)
        return Query(self.name, image, self.camera, prior, references)


@dataclass(frozen=True)
class Dataset:
    """A map, and queries with reference poses.

    Attributes:
        name: name of the data set and of the folder of its results.
        track: what the data set can show: "uav-sim" (changed season and light), "flight"
            (photographs of one flight) or "cmu" (photographs from a car through a year; "cmu-sim"
            when they are simulated).
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
    queries: tuple[BenchmarkQuery, ...]

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
        return sha256(json.dumps(list(self.parts.items())))
