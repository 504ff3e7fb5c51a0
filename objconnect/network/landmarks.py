"""The objects of a map: centres that several photographs see, with vectors and sizes.

A photograph gives the direction of a centre, and its height above the ground. The ground is that of
the map's points. Centres of several photographs that lie together and look alike are one landmark.
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

# Numerical guard: flatter rays meet the ground too far away, as a share of the distance.
_FLATTEST: Final = 0.2
# Rounds in which a ray's place on the ground and the height of the ground there agree.
_ROUNDS: Final = 3


COUNT: Final = 256
"""Most objects of a photograph, which bounds time."""
LEAST_SCORE: Final = 0.2
"""Objects of a lower probability are left out."""
# Centres this near may be one landmark: metres, and a share of the side of large objects.
_RADIUS_M: Final = 1.0
_RADIUS_SHARE: Final = 0.35
# Vectors that differ more are not of one landmark.
_LEAST_COSINE: Final = 0.4
# Nearest objects of all photographs among which one looks for those of a landmark.
_CROWD: Final = 64
# Photographs that must show a landmark, where more than one shows its place, and their share.
_LEAST_VIEWS: Final = 2
_LEAST_SHARE: Final = 0.3


class Placed(NamedTuple):
    """Objects of a photograph on the ground, N of them.

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
    """The objects of a map, M of them.

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
        """Return some of the landmarks."""
        return Landmarks(*(getattr(self, name)[rows] for name in self.ARRAYS))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the landmarks by the names of ``ARRAYS``; all but centres in half precision."""
        found = ((name, getattr(self, name)) for name in self.ARRAYS)
        return {name: v.astype(np.float16) if v.dtype == np.float32 else v for name, v in found}

    @staticmethod
    def of(arrays: Mapping[str, NDArray[Any]]) -> Landmarks:
        """Return the landmarks that ``arrays`` was called of. Others raise ``ValueError``."""
        xyz, *floats, views = (arrays[name] for name in Landmarks.ARRAYS)
        vectors, sides, rises, scores = (each.astype(np.float32) for each in floats)
        if not all(len(each) == len(xyz) for each in (vectors, sides, rises, scores, views)):
            raise ValueError("its lists are of different lengths")
        if xyz.shape != (len(xyz), 3) or vectors.ndim != 2:
            raise ValueError("its lists have other shapes than landmarks")
        return Landmarks(xyz.astype(np.float64), vectors, sides, rises, scores, views)


class ObjectRays(NamedTuple):
    """Rays of a camera to objects, at a depth of one.

    Attributes:
        along: (N, 3) from the camera to the centres, in the axes of the world.
        sides: (N,) of the objects.
        rises: (N,) heights of the centres above their foot.
        falls: (N,) how far below the camera the foot lies; NaN where the lens has no such ray.
    """

    along: NDArray[np.float64]
    sides: NDArray[np.float64]
    rises: NDArray[np.float64]
    falls: NDArray[np.float64]


def object_rays(found: Detections, camera: Camera, cam_from_world: Tensor) -> ObjectRays:
    """Return the rays of a camera with a rotation (3, 3) to the objects of its photograph."""
    rays, valid = camera.unproject(found.xy.double())
    rays = rays.double() / rays[:, 2:]
    focal = float(np.mean(camera.focal))
    along = (rays @ cam_from_world).numpy()
    rises, sides = found.rise.double().numpy() / focal, found.side.double().numpy() / focal
    falls = np.where(valid.numpy(), rises - along[:, 2], np.nan)
    return ObjectRays(along, sides, rises, falls)


def on_ground(found: Detections, camera: Camera, pose: Pose, ground: GroundGrid) -> Placed:
    """Place the objects of a photograph on the ground.

    Args:
        found: the objects.
        camera: of the photograph.
        pose: ``cam_from_world``.
        ground: of the map.
    """
    rays = object_rays(found, camera, pose.rotation)
    centre = pose.centre().numpy()
    falls = np.where(rays.falls > _FLATTEST, rays.falls, np.nan)
    height = np.full(len(falls), ground.height_at(centre[0], centre[1]))
    for _ in range(_ROUNDS):
        depth = (centre[2] - height) / falls
        xyz = centre + depth[:, None] * rays.along
        height = np.array([ground.height_at(x, y) if x == x else 0.0 for x, y, _ in xyz.tolist()])
    return Placed(xyz, rays.sides * depth, rays.rises * depth)


class View(NamedTuple):
    """A photograph of the map with its objects.

    Attributes:
        name: of the photograph.
        camera: of the photograph.
        pose: ``cam_from_world``.
        found: its objects.
        placed: the same on the ground.
    """

    name: str
    camera: Camera
    pose: Pose
    found: Detections
    placed: Placed


class Tracks(NamedTuple):
    """Which photographs show landmarks, and where; K observations in order of their landmarks.

    Attributes:
        landmark: (K,) row of the landmark.
        name: (K,) names of the photographs.
        xy: (K, 2) pixels.
    """

    landmark: NDArray[np.int64]
    name: list[str]
    xy: NDArray[np.float64]


def merge(views: Sequence[View]) -> tuple[Landmarks, Tracks]:
    """Return the landmarks that the objects of several photographs are of, and their tracks.

    The surest object takes those of other photographs that lie near and look alike; then the next.
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
    """Return the rows of the objects of each landmark, one of a photograph at most."""
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
    """Return whether a photograph shows places (M, 3)."""
    projected = view.camera.project(view.pose.transform(torch.from_numpy(xyz)))
    return (projected.valid & view.camera.contains(projected.xy)).numpy()
