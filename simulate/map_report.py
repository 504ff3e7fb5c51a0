"""How good a map is, against the truth of the scene it was built in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene.colmap import PosedImage
from scene.manifest import SceneObject
from scene.pose import Pose
from scene.sparse_map import SparseMap
from simulate.class_spread import KindShare

# A point belongs to the object whose box, grown by this much, holds it: triangulation is not exact.
_MARGIN_M = 0.25


@dataclass(frozen=True)
class ObjectCoverage:
    """Objects of one size class: how many were seen, how many have a point, and their points."""

    seen: int
    with_points: int
    points: int


@dataclass(frozen=True)
class MapReport:
    """Figures of a map.

    Attributes:
        images: photographs given.
        registered: of them in the map.
        points: triangulated.
        reprojection_error_px: mean over observations.
        track_length: mean number of photographs that observe a point.
        position_rms_m: of the camera centres from the truth.
        position_max_m: the worst.
        rotation_rms_deg: of the rotations from the truth.
        rotation_max_deg: the worst.
        objects: by size class, of those seen in the map's photographs.
        spread: over kinds of surfaces.
    """

    images: int
    registered: int
    points: int
    reprojection_error_px: float
    track_length: float
    position_rms_m: float
    position_max_m: float
    rotation_rms_deg: float
    rotation_max_deg: float
    objects: Mapping[str, ObjectCoverage]
    spread: Mapping[str, KindShare]

    def as_dict(self) -> dict[str, Any]:
        """For a program."""
        return asdict(self)

    def text(self) -> str:
        """For a person."""
        lines = [
            f"{self.registered} of {self.images} images, {self.points} points, "
            f"{self.reprojection_error_px:.2f} px mean reprojection error, "
            f"tracks of {self.track_length:.1f} images",
            f"poses from the truth: {self.position_rms_m:.3f} m rms, "
            f"{self.position_max_m:.3f} m at most; "
            f"{self.rotation_rms_deg:.3f}° rms, {self.rotation_max_deg:.3f}° at most",
        ]
        lines += [
            f"{name} objects: {c.with_points} of {c.seen} seen have a point, {c.points} points"
            for name, c in self.objects.items()
        ]
        lines += [
            f"{name}: {s.pixels:.1%} of pixels, {s.keypoints:.1%} of keypoints, "
            f"{s.points:.1%} of points"
            for name, s in self.spread.items()
        ]
        return "\n".join(lines)


def report(
    sparse_map: SparseMap,
    truth: Sequence[PosedImage],
    objects: Sequence[SceneObject],
    seen: set[int],
    spread: Mapping[str, KindShare],
) -> MapReport:
    """Measure a map.

    Args:
        sparse_map: built from the images of ``truth``, or from some of them.
        truth: every photograph given, with its exact pose.
        objects: of the scene.
        seen: identifiers of the objects in the photographs.
        spread: see ``simulate.class_spread``.
    """
    mapped = [image for image in truth if image.name in sparse_map.images]
    estimated = np.stack([sparse_map.images[image.name].cam_from_world for image in mapped])
    exact = np.stack([image.cam_from_world for image in mapped])
    metres, degrees = Pose.from_matrix(estimated).error_to(Pose.from_matrix(exact))
    return MapReport(
        images=len(truth),
        registered=len(mapped),
        points=len(sparse_map.xyz),
        reprojection_error_px=sparse_map.reprojection_error(),
        track_length=float(sparse_map.track_length.mean()),
        position_rms_m=_rms(metres.numpy()),
        position_max_m=float(metres.max()),
        rotation_rms_deg=_rms(degrees.numpy()),
        rotation_max_deg=float(degrees.max()),
        objects=_coverage(sparse_map.xyz, [item for item in objects if item.id in seen]),
        spread=spread,
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


def _coverage(
    xyz: NDArray[np.float64], objects: Sequence[SceneObject]
) -> dict[str, ObjectCoverage]:
    result = {}
    for name in ("small", "medium", "large"):
        counts = [points_inside(xyz, item) for item in objects if item.size_class == name]
        hit = sum(count > 0 for count in counts)
        result[name] = ObjectCoverage(len(counts), hit, sum(counts))
    return result


def points_inside(xyz: NDArray[np.float64], item: SceneObject) -> int:
    """How many points (M, 3) lie in an object's oriented box, grown by a margin."""
    yaw = np.radians(item.yaw_deg)
    cos, sin = np.cos(yaw), np.sin(yaw)
    box_from_world = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    local = (xyz - np.array(item.centre)) @ box_from_world.T
    inside = (np.abs(local) <= 0.5 * np.array(item.size) + _MARGIN_M).all(1)
    return int(inside.sum())
