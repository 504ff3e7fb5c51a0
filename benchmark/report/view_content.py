"""The content of a scene's page and picture: points, objects, and queries with estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scene.bundle.manifest import SceneObject
from scene.geometry.rectangle import rectangle


@dataclass(frozen=True)
class Cloud:
    """Points of one kind.

    Attributes:
        layer: "sparse", "added" or "dense".
        xyz: (M, 3) world metres.
        rgb: (M, 3).
    """

    layer: str
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]


@dataclass(frozen=True)
class Thing:
    """An object in the map's photographs, and whether a point of the map lies on it.

    Attributes:
        item: the object as ``objects.json`` describes it.
        before: whether a point lies on it that was not added.
        after: whether any point lies on it.
    """

    item: SceneObject
    before: bool
    after: bool

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners of the object's box seen from above, (4, 2) world metres."""
        return rectangle(self.item.centre[:2], self.item.size[:2], np.radians(self.item.yaw_deg))


@dataclass(frozen=True)
class Found:
    """A query as a method found it.

    Attributes:
        name: of the photograph.
        truth: (3,) true camera centre, world metres.
        centre: (3,) estimated camera centre, or None.
        error: distance of the estimate from the truth in metres, or None.
        angle: error of the rotation in degrees, or None.
        status: a value of ``scene.localizer.Status``.
    """

    name: str
    truth: NDArray[np.float64]
    centre: NDArray[np.float64] | None
    error: float | None
    angle: float | None
    status: str


@dataclass(frozen=True)
class Method:
    """The queries of one results file."""

    name: str
    queries: tuple[Found, ...]
