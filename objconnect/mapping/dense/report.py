"""The report of ``dense``: errors of depth maps against the truth of the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.mapping.dense.workspace import Workspace
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.progress import progress_bar

RELATIVE_TOLERANCE = 0.005
"""Maximum relative error of a right depth."""

# A pixel is evaluated if at least this many photographs, including its own, see its surface.
_MIN_VIEWS = 3
# A photograph sees a point if the photograph's depth at the point's pixel differs from the point's
# depth by less than this share.
_SAME_DEPTH = 0.01
GROUPS = ("all", "ground", "small", "medium", "large")
"""Groups of pixels for which accuracy is reported: all, ground, and objects by size class."""


@dataclass(frozen=True)
class Truth:
    """Rendered ground truth in the camera of a depth map.

    Attributes:
        depth: depth (H, W), metres, 0 where there is no surface.
        instance: object ids (H, W), 0 for the ground.
        views: number (H, W) of photographs of the map that see the surface, including this one.
    """

    depth: NDArray[np.float32]
    instance: NDArray[np.uint16]
    views: NDArray[np.int16]

    @property
    def evaluable(self) -> NDArray[np.bool_]:
        """Return the mask of evaluated pixels, whose surface enough photographs see."""
        return (self.depth > 0) & (self.views >= _MIN_VIEWS)


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of the depth of a group of evaluated pixels.

    Attributes:
        pixels: number of evaluated pixels.
        complete: share of the pixels with any depth.
        right: share of the pixels with a depth within 0.5 % of the truth.
        right_of_complete: share of the pixels with a depth that are within 0.5 % of the truth.
        median_error: relative median error of the pixels with a depth; None where there are none.
    """

    pixels: int
    complete: float
    right: float
    right_of_complete: float
    median_error: float | None


@dataclass(frozen=True)
class DenseReport:
    """Statistics of a dense reconstruction.

    Attributes:
        photographs: number of photographs of the map.
        maps: number of depth maps.
        points: number of points of the fused cloud.
        cpu_seconds_per_map: processor seconds for 512 x 512 pixels of the depth maps of this run;
            None if it made none.
        accuracy: accuracy of all evaluated pixels, of pixels of the ground, and of pixels of
            objects by size class; empty where the scene has no true depth.
    """

    photographs: int
    maps: int
    points: int
    cpu_seconds_per_map: float | None
    accuracy: Mapping[str, Accuracy]

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics as a dictionary for JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return the statistics as text."""
        lines = [f"{self.maps} depth maps of {self.photographs} photographs, "
                 f"{self.points} points in the cloud"]  # fmt: skip
        if self.cpu_seconds_per_map is not None:
            lines.append(f"{self.cpu_seconds_per_map:.1f} CPU-seconds per 512 x 512 pixels")
        if self.accuracy:
            lines.append(f"of pixels seen by {_MIN_VIEWS} or more photographs:")
        for name, a in self.accuracy.items():
            middle = "" if a.median_error is None else f"median {a.median_error:.2%}, "
            lines.append(
                f"  {name:<7} {a.right:6.1%} within {RELATIVE_TOLERANCE:.1%} of the true depth "
                f"({a.right_of_complete:.1%} of the {a.complete:.1%} that have one), "
                f"{middle}{a.pixels} pixels"
            )
        return "\n".join(lines)


def read_truth(scene: Scene, sparse_map: SparseMap) -> dict[str, Truth]:
    """Return the truth of every map photograph that has rendered depth.

    It is resampled to the undistorted cameras of the map.
    """
    sampled: dict[str, tuple[NDArray[np.float32], NDArray[np.uint16]]] = {}
    for session in scene.sessions:
        frames = scene.frames(session)
        with scene.layers(session) as layers:
            if not layers.has("depth"):
                continue
            for k, name in enumerate(frames.names):
                if name in sparse_map.images:
                    pixels = _find_nearest(frames.cameras[k], sparse_map.images[name].camera)
                    depth, instance = (layers.read(w, k) for w in ("depth", "instance"))
                    sampled[name] = depth[pixels], instance[pixels]
    images = [sparse_map.images[name] for name in sampled]
    depths = {name: depth for name, (depth, _) in sampled.items()}
    truth = {}
    with progress_bar("truth", len(sampled)) as advance:
        for name, (depth, instance) in sampled.items():
            views = _count_views(sparse_map.images[name], images, depths)
            truth[name] = Truth(depth, instance, views)
            advance(len(truth))
    return truth


def _find_nearest(camera: Camera, pinhole: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the row and column in the photograph for every pixel of the pinhole picture."""
    rays, _ = pinhole.unproject(pinhole.pixel_grid())
    column, row = camera.project(rays).xy.floor().long().unbind(-1)
    return row.clamp(0, camera.height - 1).numpy(), column.clamp(0, camera.width - 1).numpy()


def _count_views(
    image: MapImage, others: Sequence[MapImage], depths: Mapping[str, NDArray[np.float32]]
) -> NDArray[np.int16]:
    depth = torch.from_numpy(depths[image.name]).double()
    rays, _ = image.camera.unproject(image.camera.pixel_grid())
    world = image.pose.inverse().transform((rays * depth[..., None]).reshape(-1, 3))
    count = torch.zeros(len(world), dtype=torch.int16)
    for other in others:
        local = other.pose.transform(world)
        projected = other.camera.project(local)
        inside = projected.valid & other.camera.contains(projected.xy)
        column = projected.xy[:, 0].long().clamp(0, other.camera.width - 1)
        row = projected.xy[:, 1].long().clamp(0, other.camera.height - 1)
        stored = torch.from_numpy(depths[other.name])[row, column]
        count += inside & ((stored - local[:, 2]).abs() < _SAME_DEPTH * stored)
    return count.reshape(depth.shape).numpy()


@dataclass(frozen=True)
class DenseCloud:
    """Depth maps and the cloud fused from them.

    Attributes:
        names: photographs that have a depth map.
        points: number of points of the cloud.
        cpu_seconds_per_map: processor seconds for 512 x 512 pixels of the depth maps; None if none
            was made.
    """

    workspace: Workspace
    names: Sequence[str]
    points: int
    cpu_seconds_per_map: float | None


def report(
    scene: Scene, photographs: int, cloud: DenseCloud, truth: Mapping[str, Truth]
) -> DenseReport:
    """Measure depth maps.

    Args:
        scene: scene whose objects have size classes.
        photographs: number of photographs of the map.
        cloud: the depth maps and their cloud.
        truth: truth by photograph, empty where there is none.
    """
    workspace, names = cloud.workspace, cloud.names
    groups = Groups(scene) if truth else None
    parts: dict[str, list[NDArray[np.float64]]] = {name: [] for name in GROUPS}
    for name in names:
        if groups is None or name not in truth:
            continue
        true = truth[name]
        depth = workspace.depth(name, "geometric")
        evaluable = true.evaluable
        error = np.where(depth > 0, np.abs(depth / np.where(evaluable, true.depth, 1) - 1), np.inf)
        group = groups.of(true.instance)[evaluable]
        parts["all"].append(error[evaluable])
        for k, label in enumerate(GROUPS[1:]):
            parts[label].append(error[evaluable][group == k])
    errors = {label: np.concatenate(arrays) for label, arrays in parts.items() if arrays}
    return DenseReport(
        photographs=photographs,
        maps=len(names),
        points=cloud.points,
        cpu_seconds_per_map=cloud.cpu_seconds_per_map,
        accuracy={label: _accuracy(error) for label, error in errors.items() if len(error)},
    )


class Groups:
    """Group numbers of pixels: 0 for the ground, then the size classes of objects in order."""

    def __init__(self, scene: Scene) -> None:
        self._table = np.zeros(1 << 16, np.uint8)
        for item in scene.objects.objects:
            self._table[item.id] = GROUPS.index(item.size_class) - 1

    def of(self, instance: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """Return the index into ``GROUPS[1:]`` of each object id."""
        return np.asarray(self._table[instance])


def _accuracy(error: NDArray[np.float64]) -> Accuracy:
    known = error[np.isfinite(error)]
    right = int((known < RELATIVE_TOLERANCE).sum())
    return Accuracy(
        pixels=len(error),
        complete=len(known) / len(error),
        right=right / len(error),
        right_of_complete=right / max(len(known), 1),
        median_error=float(np.median(known)) if len(known) else None,
    )
