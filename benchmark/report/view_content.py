"""The content of a scene's page and picture: points, objects, and queries with estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.geometry.rectangle import rectangle


@dataclass(frozen=True)
class Cloud:
    """The points of one kind.

    Attributes:
        layer: "sparse", "added", "landmarks" or "dense".
        xyz: (M, 3) world coordinates, metres.
        rgb: (M, 3) colours.
    """

    layer: str
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]


@dataclass(frozen=True)
class MapObject:
    """An object in the map's photographs, and whether the map has a point on it.

    Attributes:
        item: entry of ``objects.json``.
        before: whether it has a point of the map before ``supplement`` added any.
        after: whether it has a point of the map with the added ones.
    """

    item: SceneObject
    before: bool
    after: bool

    @property
    def corners(self) -> NDArray[np.float64]:
        """Return the corners (4, 2) of the object's box seen from above, metres."""
        return rectangle(self.item.centre[:2], self.item.size[:2], np.radians(self.item.yaw_deg))


@dataclass(frozen=True)
class QueryEstimate:
    """The estimate of a method for one query.

    Attributes:
        name: name of the photograph.
        truth: (3,) true camera centre, metres.
        centre: (3,) estimated camera centre, metres; None without a pose.
        error: distance between the two, metres; None without a pose.
        angle: rotation error, degrees; None without a pose.
        status: value of ``objconnect.scene.localizer.Status``.
        found: whether the status is ok and the errors are at most 5 m and 10 degrees.
    """

    name: str
    truth: NDArray[np.float64]
    centre: NDArray[np.float64] | None
    error: float | None
    angle: float | None
    status: str
    found: bool


@dataclass(frozen=True)
class MethodEstimates:
    """The estimates of one results file, with the name of its method."""

    name: str
    queries: tuple[QueryEstimate, ...]


@dataclass(frozen=True)
class ViewContent:
    """Everything that is shown of a scene besides its cameras.

    Attributes:
        clouds: clouds of points; the picture leaves the dense one out.
        objects: objects; the picture shows only small ones.
        query_paths: (K, 3) true camera centres of the queries of each session, metres.
        methods: methods with their estimates.
    """

    clouds: Sequence[Cloud]
    objects: Sequence[MapObject]
    query_paths: Sequence[NDArray[np.float64]]
    methods: Sequence[MethodEstimates]
