"""The landmarks of a map: objects that its photographs show, with vectors and sizes.

A photograph gives the ray to an object's centre, and the height of the centre above the ground. The
heights of the ground come from the map's points. Near and similar objects of several photographs
are one landmark.
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
from objconnect.scene.geometry.nearest import NearestNeighbours
from objconnect.scene.geometry.pose import Pose

# Least drop of the ray to an object's foot, metres per metre of depth. Objects on flatter rays are
# left out, because these meet the ground too far away.
_MIN_DROP: Final = 0.2
# The same for an intersection with level ground.
_MIN_LEVEL_DROP: Final = 0.35
# Number of iterations that intersect a ray with uneven ground.
_ROUNDS: Final = 3
MAX_OBJECTS: Final = 256
"""Maximum number of objects of a photograph, which bounds time."""
LEAST_SCORE: Final = 0.2
"""Least probability of an object."""
# Largest distance of the objects of one landmark from its best object: the larger of this number of
# metres and this share of the best object's side.
_RADIUS_M: Final = 1.0
_RADIUS_SHARE: Final = 0.35
# Least cosine between vectors of one landmark.
_LEAST_COSINE: Final = 0.4
# Maximum number of objects, of all photographs, that are compared with the best one of a landmark.
_NEAREST: Final = 64
# A landmark must be detected in at least this number and this share of the photographs that have it
# in view. A landmark that only one photograph has in view is kept.
_LEAST_VIEWS: Final = 2
_LEAST_SHARE: Final = 0.3


class PlacedObjects(NamedTuple):
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
        sides: (M,) side of a square of the object's size, metres.
        rises: (M,) height of the centre above the ground, metres.
        scores: (M,) probability that there is an object.
        views: (M,) number of photographs in which the object was detected.
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

    def select(self, rows: NDArray[np.int64]) -> Landmarks:
        """Return the landmarks with these rows."""
        return Landmarks(*(getattr(self, name)[rows] for name in self.ARRAYS))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays of ``ARRAYS`` by name, with float32 converted to float16."""
        found = ((name, getattr(self, name)) for name in self.ARRAYS)
        return {name: v.astype(np.float16) if v.dtype == np.float32 else v for name, v in found}

    @staticmethod
    def of(arrays: Mapping[str, NDArray[Any]]) -> Landmarks:
        """Return landmarks from the result of ``arrays``.

        Raises:
            ValueError: the shapes of the arrays are not those of landmarks.
        """
        xyz, *floats, views = (arrays[name] for name in Landmarks.ARRAYS)
        vectors, sides, rises, scores = (each.astype(np.float32) for each in floats)
        if not all(len(each) == len(xyz) for each in (vectors, sides, rises, scores, views)):
            raise ValueError("the arrays of landmarks have different lengths")
        if xyz.shape != (len(xyz), 3) or vectors.ndim != 2:
            raise ValueError("xyz is not (M, 3), or vectors is not (M, V)")
        return Landmarks(xyz.astype(np.float64), vectors, sides, rises, scores, views)


class ObjectRays(NamedTuple):
    """Rays of a camera to objects; lengths are per unit of depth.

    Attributes:
        directions: (N, 3) from the camera to the centres, in the axes of the world.
        sides: (N,) sides of the objects.
        rises: (N,) heights of the centres above the objects' feet.
        drops: (N,) heights of the camera above the objects' feet; NaN for invalid rays.
    """

    directions: NDArray[np.float64]
    sides: NDArray[np.float64]
    rises: NDArray[np.float64]
    drops: NDArray[np.float64]


def object_rays(found: Detections, camera: Camera, cam_from_world: Tensor) -> ObjectRays:
    """Return the rays of a camera with a rotation (3, 3) to the objects of its photograph."""
    rays, valid = camera.unproject(found.xy.double())
    rays = rays.double() / rays[:, 2:]
    focal = float(np.mean(camera.focal))
    directions = (rays @ cam_from_world).numpy()
    rises, sides = found.rise.double().numpy() / focal, found.side.double().numpy() / focal
    drops = np.where(valid.numpy(), rises - directions[:, 2], np.nan)
    return ObjectRays(directions, sides, rises, drops)


@dataclass(frozen=True)
class ObjectLayout:
    """N objects on level ground; lengths are in units of the camera's height above it.

    Attributes:
        offset: (N, 2) from the point below the camera, to the east and north.
        rise: (N,) heights of the centres above the ground.
        side: (N,) sides.
        vectors: (N, V) of unit length.
        rows: (N,) rows of the photograph's objects.
    """

    offset: NDArray[np.float64]
    rise: NDArray[np.float64]
    side: NDArray[np.float64]
    vectors: Tensor
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.offset)


def lay_out(found: Detections, camera: Camera, cam_from_world: Tensor) -> ObjectLayout:
    """Lay the objects of a photograph out on level ground.

    Args:
        found: the objects.
        camera: camera of the photograph.
        cam_from_world: rotation (3, 3).
    """
    rays = object_rays(found, camera, cam_from_world)
    rows = np.flatnonzero(rays.drops > _MIN_LEVEL_DROP)
    depth = 1 / rays.drops[rows]
    offset = depth[:, None] * rays.directions[rows, :2]
    vectors = found.vectors[torch.from_numpy(rows)]
    return ObjectLayout(offset, rays.rises[rows] * depth, rays.sides[rows] * depth, vectors, rows)


def place_on_ground(
    found: Detections, camera: Camera, pose: Pose, ground: GroundGrid
) -> PlacedObjects:
    """Place the objects of a photograph with a pose ``cam_from_world`` on the ground."""
    rays = object_rays(found, camera, pose.rotation)
    centre = pose.centre().numpy()
    drops = np.where(rays.drops > _MIN_DROP, rays.drops, np.nan)
    height = np.full(len(drops), ground.height_at(centre[0], centre[1]))
    for _ in range(_ROUNDS):
        depth = (centre[2] - height) / drops
        xyz = centre + depth[:, None] * rays.directions
        height = np.array([ground.height_at(x, y) if x == x else 0.0 for x, y, _ in xyz.tolist()])
    return PlacedObjects(xyz, rays.sides * depth, rays.rises * depth)


class View(NamedTuple):
    """A photograph of the map with its objects, in pixels and placed on the ground."""

    name: str
    camera: Camera
    pose: Pose
    detections: Detections
    placed_objects: PlacedObjects


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
    """Merge the objects of several photographs to landmarks; return the landmarks and their tracks.

    The object with the highest score forms a group with near and similar objects of other
    photographs; then the best of the remaining objects forms the next group, and so on. A group is
    a landmark if enough of the photographs that have it in view detected it.
    """
    size = views[0].detections.vectors.shape[1] if views else 1
    rows = [np.flatnonzero(np.isfinite(view.placed_objects.xyz).all(1)) for view in views]

    def join(values: Callable[[View], NDArray[np.float64]], *shape: int) -> NDArray[np.float64]:
        parts = [values(view)[kept] for view, kept in zip(views, rows, strict=True)]
        return np.concatenate([np.empty((0, *shape)), *parts])

    xyz = join(lambda view: view.placed_objects.xyz, 3)
    vectors = join(lambda view: view.detections.vectors.numpy(), size)
    scores = join(lambda view: view.detections.score.numpy())
    sides, rises = (
        join(lambda view: view.placed_objects.sides),
        join(lambda view: view.placed_objects.rises),
    )
    photograph = np.repeat(np.arange(len(views)), [len(kept) for kept in rows])
    groups = _group_objects(xyz, vectors, scores, sides, photograph)
    centres = np.array([np.median(xyz[group], 0) for group in groups]).reshape(-1, 3)
    mean_vectors = np.array([vectors[group].mean(0) for group in groups]).reshape(-1, size)
    mean_vectors /= np.maximum(np.linalg.norm(mean_vectors, axis=1, keepdims=True), 1e-9)
    detected = np.array([len(group) for group in groups], np.int32)
    in_view = np.sum([_shows(view, centres) for view in views], 0) if views else detected
    confirmed = (detected >= _LEAST_VIEWS) & (detected >= _LEAST_SHARE * in_view)
    # An object that only one photograph has in view cannot be confirmed by another.
    kept = confirmed | (in_view <= 1)

    def medians(values: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.array([np.median(values[group]) for group in groups], np.float32)[kept]

    landmarks = Landmarks(
        centres[kept],
        mean_vectors[kept].astype(np.float32),
        medians(sides),
        medians(rises),
        medians(scores),
        detected[kept],
    )
    xy = join(lambda view: view.detections.xy.double().numpy(), 2)
    kept_groups = [group for group, keep in zip(groups, kept.tolist(), strict=True) if keep]
    observations = np.array([row for group in kept_groups for row in group], np.int64)
    landmark = np.repeat(np.arange(len(kept_groups)), [len(group) for group in kept_groups])
    names = [views[k].name for k in photograph[observations].tolist()]
    return landmarks, Tracks(landmark, names, xy[observations])


def _group_objects(
    xyz: NDArray[np.float64],
    vectors: NDArray[np.float64],
    scores: NDArray[np.float64],
    sides: NDArray[np.float64],
    photograph: NDArray[np.int64],
) -> list[list[int]]:
    """Return the rows of the objects of each group, at most one per photograph.

    Args:
        xyz: (N, 3) centres of the objects of all photographs, world metres.
        vectors: (N, V) of unit length.
        scores: (N,) probabilities that there is an object.
        sides: (N,) metres.
        photograph: (N,) index of the photograph of each object.
    """
    if not len(xyz):
        return []
    is_used = np.zeros(len(xyz), bool)
    reach = np.maximum(_RADIUS_M, _RADIUS_SHARE * sides)
    nearest = NearestNeighbours(xyz[:, :2])
    groups = []
    for first in np.argsort(-scores, kind="stable").tolist():
        if is_used[first]:
            continue
        near = nearest(xyz[first, :2], _NEAREST)
        distance = np.linalg.norm(xyz[near, :2] - xyz[first, :2], axis=1)
        is_similar = vectors[near] @ vectors[first] > _LEAST_COSINE
        near = near[~is_used[near] & (distance <= reach[first]) & is_similar]
        is_used[near] = is_used[first] = True
        _, once = np.unique(photograph[near], return_index=True)
        groups.append(sorted({first, *near[once].tolist()}))
    return groups


def _shows(view: View, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether points (M, 3) are in a photograph's view."""
    projected = view.camera.project(view.pose.transform(torch.from_numpy(xyz)))
    return (projected.valid & view.camera.contains(projected.xy)).numpy()
