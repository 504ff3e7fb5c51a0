"""The landmarks of a map: objects that several photographs show, with vectors and sizes.

A photograph gives the ray to an object's centre and its height above the ground, which comes from
the map's points. Near and similar objects of several photographs are one landmark.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.localization.coarse.grid import GroundGrid
from objconnect.network.detector import Detections
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.nearest import Nearest
from objconnect.scene.geometry.pose import Pose

# Least drop of the ray to an object's foot, per unit of depth, for an intersection with the map's
# ground: flatter rays meet it too far away.
_MIN_DROP: Final = 0.2
# Iterations of the intersection of a ray with uneven ground.
_ROUNDS: Final = 3
COUNT: Final = 256
"""Maximum number of objects of a photograph, which bounds time."""
LEAST_SCORE: Final = 0.2
"""Least probability of an object."""
# Largest distance of objects of one landmark: metres, and a share of the side of large objects.
_RADIUS_M: Final = 1.0
_RADIUS_SHARE: Final = 0.35
# Least cosine between vectors of one landmark.
_LEAST_COSINE: Final = 0.4
# Number of nearest objects of all photographs that may join a landmark.
_CROWD: Final = 64
# Least number and share of the photographs with a landmark in view that must detect it.
_LEAST_VIEWS: Final = 2
_LEAST_SHARE: Final = 0.3


class Placed(NamedTuple):
    """N objects of a photograph, placed on the ground.

    Attributes:
        xyz: (N, 3) centres, world metres; NaN where the ray does not meet the ground.
        sides: (N,) metres.
        rises: (N,) heights of the centres above the ground, metres.
    """

    xyz: NDArray[np.float64]
    sides: NDArray[np.float64]
    rises: NDArray[np.float64]


@dataclass(frozen=True)
class Landmarks:
    """The M landmarks of a map.

    Attributes:
        xyz: (M, 3) centres, world metres.
        vectors: (M, V) float32, of unit length.
        sides: (M,) side of a square of its size, metres.
        rises: (M,) height of the centre above the ground, metres.
        scores: (M,) probability that there is an object.
        views: (M,) number of photographs that show it.
    """

    ARRAYS: ClassVar = ("xyz", "vectors", "sides", "rises", "scores", "views")

    xyz: NDArray[np.float64]
    vectors: NDArray[np.float32]
    sides: NDArray[np.float32]
    rises: NDArray[np.float32]
    scores: NDArray[np.float32]
    views: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.xyz)

    def some(self, rows: NDArray[np.int64]) -> Landmarks:
        """Return the landmarks of some rows."""
        return Landmarks(*(getattr(self, name)[rows] for name in self.ARRAYS))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the landmarks by the names of ``ARRAYS``; all but centres in half precision."""
        found = ((name, getattr(self, name)) for name in self.ARRAYS)
        return {name: v.astype(np.float16) if v.dtype == np.float32 else v for name, v in found}

    @staticmethod
    def of(arrays: Mapping[str, NDArray[Any]]) -> Landmarks:
        """Return the landmarks of ``arrays``.

        Raises:
            ValueError: the arrays have other shapes.
        """
        xyz, *floats, views = (arrays[name] for name in Landmarks.ARRAYS)
        vectors, sides, rises, scores = (each.astype(np.float32) for each in floats)
        if not all(len(each) == len(xyz) for each in (vectors, sides, rises, scores, views)):
            raise ValueError("its arrays have different lengths")
        if xyz.shape != (len(xyz), 3) or vectors.ndim != 2:
            raise ValueError("its arrays have not the shapes of landmarks")
        return Landmarks(xyz.astype(np.float64), vectors, sides, rises, scores, views)


class ObjectRays(NamedTuple):
    """Rays of a camera to objects; lengths are per unit of depth.

    Attributes:
        along: (N, 3) from the camera to the centres, in the axes of the world.
        sides: (N,) sides of the objects.
        rises: (N,) heights of the centres above the objects' feet.
        drops: (N,) heights of the camera above the objects' feet; NaN for invalid rays.
    """

    along: NDArray[np.float64]
    sides: NDArray[np.float64]
    rises: NDArray[np.float64]
    drops: NDArray[np.float64]


def object_rays(found: Detections, camera: Camera, cam_from_world: Tensor) -> ObjectRays:
    """Return the rays of a camera with a rotation (3, 3) to the objects of its photograph."""
    rays, valid = camera.unproject(found.xy.double())
    rays = rays.double() / rays[:, 2:]
    focal = float(np.mean(camera.focal))
    along = (rays @ cam_from_world).numpy()
    rises, sides = found.rise.double().numpy() / focal, found.side.double().numpy() / focal
    drops = np.where(valid.numpy(), rises - along[:, 2], np.nan)
    return ObjectRays(along, sides, rises, drops)


def place_on_ground(found: Detections, camera: Camera, pose: Pose, ground: GroundGrid) -> Placed:
    """Place the objects of a photograph with a pose ``cam_from_world`` on the ground."""
    rays = object_rays(found, camera, pose.rotation)
    centre = pose.centre().numpy()
    drops = np.where(rays.drops > _MIN_DROP, rays.drops, np.nan)
    height = np.full(len(drops), ground.height_at(centre[0], centre[1]))
    for _ in range(_ROUNDS):
        depth = (centre[2] - height) / drops
        xyz = centre + depth[:, None] * rays.along
        height = np.array([ground.height_at(x, y) if x == x else 0.0 for x, y, _ in xyz.tolist()])
    return Placed(xyz, rays.sides * depth, rays.rises * depth)


class View(NamedTuple):
    """A photograph of the map with its objects, in pixels and placed on the ground."""

    name: str
    camera: Camera
    pose: Pose
    found: Detections
    placed: Placed


class Tracks(NamedTuple):
    """K observations of landmarks in photographs, sorted by landmark.

    Attributes:
        landmark: (K,) row of the landmark.
        name: (K,) names of the photographs.
        xy: (K, 2) pixels.
    """

    landmark: NDArray[np.int64]
    name: list[str]
    xy: NDArray[np.float64]


def merge(views: Sequence[View]) -> tuple[Landmarks, Tracks]:
    """Merge the objects of several photographs to landmarks; return these and their tracks.

    The object with the highest score takes near and similar ones of other photographs; then the
    next.
    """
    size = views[0].found.vectors.shape[1] if views else 1
    rows = [np.flatnonzero(np.isfinite(view.placed.xyz).all(1)) for view in views]

    def join(of: Callable[[View], NDArray[np.float64]], *shape: int) -> NDArray[np.float64]:
        parts = [of(view)[kept] for view, kept in zip(views, rows, strict=True)]
        return np.concatenate([np.empty((0, *shape)), *parts])

    xyz = join(lambda view: view.placed.xyz, 3)
    vectors = join(lambda view: view.found.vectors.numpy(), size)
    scores = join(lambda view: view.found.score.numpy())
    sides, rises = join(lambda view: view.placed.sides), join(lambda view: view.placed.rises)
    photograph = np.repeat(np.arange(len(views)), [len(kept) for kept in rows])
    groups = _groups(xyz, vectors, scores, sides, photograph)
    centres = np.array([np.median(xyz[group], 0) for group in groups]).reshape(-1, 3)
    looks = np.array([vectors[group].mean(0) for group in groups]).reshape(-1, size)
    looks /= np.maximum(np.linalg.norm(looks, axis=1, keepdims=True), 1e-9)
    number = np.array([len(group) for group in groups], np.int32)
    shown = np.sum([_shows(view, centres) for view in views], 0) if views else number
    enough = (number >= _LEAST_VIEWS) & (number >= _LEAST_SHARE * shown)
    kept = enough | (shown <= 1)

    def middle(values: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.array([np.median(values[group]) for group in groups], np.float32)[kept]

    landmarks = Landmarks(
        centres[kept],
        looks[kept].astype(np.float32),
        middle(sides),
        middle(rises),
        middle(scores),
        number[kept],
    )
    xy = join(lambda view: view.found.xy.double().numpy(), 2)
    members = [group for group, keep in zip(groups, kept.tolist(), strict=True) if keep]
    shown_in = np.array([row for group in members for row in group], np.int64)
    landmark = np.repeat(np.arange(len(members)), [len(group) for group in members])
    names = [views[k].name for k in photograph[shown_in].tolist()]
    return landmarks, Tracks(landmark, names, xy[shown_in])


def _groups(
    xyz: NDArray[np.float64],
    vectors: NDArray[np.float64],
    scores: NDArray[np.float64],
    sides: NDArray[np.float64],
    photograph: NDArray[np.int64],
) -> list[list[int]]:
    """Return the rows of the objects of each landmark, at most one per photograph."""
    if not len(xyz):
        return []
    taken = np.zeros(len(xyz), bool)
    reach = np.maximum(_RADIUS_M, _RADIUS_SHARE * sides)
    nearest = Nearest(xyz[:, :2])
    groups = []
    for first in np.argsort(-scores, kind="stable").tolist():
        if taken[first]:
            continue
        near = nearest(xyz[first, :2], _CROWD)
        away = np.linalg.norm(xyz[near, :2] - xyz[first, :2], axis=1)
        alike = vectors[near] @ vectors[first] > _LEAST_COSINE
        near = near[~taken[near] & (away <= reach[first]) & alike]
        taken[near] = taken[first] = True
        _, once = np.unique(photograph[near], return_index=True)
        groups.append(sorted({first, *near[once].tolist()}))
    return groups


def _shows(view: View, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether points (M, 3) are in a photograph's view."""
    projected = view.camera.project(view.pose.transform(torch.from_numpy(xyz)))
    return (projected.valid & view.camera.contains(projected.xy)).numpy()
