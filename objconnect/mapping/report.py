"""The report of ``map``: errors of a map against the truth of its scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.mapping.class_coverage import KindShare
from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.bundle.object_points import ObjectCoverage, coverage
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap


@dataclass(frozen=True)
class ErrorSummary:
    """Mean, root mean square and maximum of errors."""

    mean: float
    rms: float
    max: float

    @staticmethod
    def of(values: NDArray[np.float64]) -> ErrorSummary:
        """Summarise errors (N,)."""
        return ErrorSummary(
            float(values.mean()), float(np.sqrt((values**2).mean())), float(values.max())
        )

    def text(self, unit: str) -> str:
        """Return the statistics as text."""
        return f"{self.mean:.3f}{unit} mean, {self.rms:.3f}{unit} rms, {self.max:.3f}{unit} at most"


@dataclass(frozen=True)
class MapReport:
    """Statistics of a map.

    Attributes:
        images: number of photographs chosen for the map.
        registered: number of frames in the map.
        pairs: number of pairs of photographs that were matched.
        points: number of triangulated points.
        reprojection_error_px: mean reprojection error over all observations, pixels.
        track_length: mean number of photographs that observe a point.
        position_m: errors of the camera centres, metres.
        rotation_deg: errors of the rotations, degrees.
        objects: coverage of the objects in the map's photographs, by size class.
        small_objects: coverage of the small objects, by class.
        kinds: shares of each kind of surface.
        options: values of ``objconnect.mapping.options.MapOptions``.
    """

    images: int
    registered: int
    pairs: int
    points: int
    reprojection_error_px: float
    track_length: float
    position_m: ErrorSummary
    rotation_deg: ErrorSummary
    objects: Mapping[str, ObjectCoverage]
    small_objects: Mapping[str, ObjectCoverage]
    kinds: Mapping[str, KindShare]
    options: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics as a dictionary for JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return the statistics as text."""
        possible = self.images * (self.images - 1) // 2
        lines = [
            f"{self.registered} of {self.images} images registered, {self.pairs} of {possible} "
            "pairs matched",
            f"{self.points} points, {self.reprojection_error_px:.2f} px mean reprojection error, "
            f"tracks of {self.track_length:.1f} images",
            "position errors: " + self.position_m.text(" m"),
            "rotation errors: " + self.rotation_deg.text("°"),
        ]
        lines += [f"{name} objects: {c.text()}" for name, c in self.objects.items()]
        lines += [f"  small, {name}: {c.text()}" for name, c in self.small_objects.items()]
        lines += [
            f"{name}: {s.pixels:.1%} of pixels, {s.keypoints:.1%} of keypoints, "
            f"{s.points:.1%} of points"
            for name, s in self.kinds.items()
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class ObjectTruth:
    """The objects in the photographs of a map, and the objects on which its points lie.

    Attributes:
        objects: objects that a map photograph shows.
        owners: id (M,) of the object on which each point of the map lies, 0 for the ground.
    """

    objects: Sequence[SceneObject]
    owners: NDArray[np.int64]


def report(
    sparse_map: SparseMap,
    truth: Sequence[PosedImage],
    objects: ObjectTruth,
    pairs: int,
    kinds: Mapping[str, KindShare],
    options: Mapping[str, Any],
) -> MapReport:
    """Measure a map.

    Args:
        sparse_map: map of all or some of the images of ``truth``.
        truth: all map frames, with their exact poses.
        objects: the objects in view, and those on which the points lie.
        pairs: number of pairs of photographs that were matched.
        kinds: result of ``objconnect.mapping.class_coverage``.
        options: options with which the map was built.
    """
    mapped = [image for image in truth if image.name in sparse_map.images]
    estimated = np.stack([sparse_map.images[image.name].cam_from_world for image in mapped])
    exact = np.stack([image.cam_from_world for image in mapped])
    metres, degrees = Pose.from_matrix(estimated).error_to(Pose.from_matrix(exact))
    owners, small = objects.owners, [o for o in objects.objects if o.size_class == "small"]
    return MapReport(
        images=len(truth),
        registered=len(mapped),
        pairs=pairs,
        points=len(sparse_map.xyz),
        reprojection_error_px=sparse_map.reprojection_error(),
        track_length=float(sparse_map.track_length.mean()),
        position_m=ErrorSummary.of(metres.numpy()),
        rotation_deg=ErrorSummary.of(degrees.numpy()),
        objects=coverage(owners, objects.objects, lambda item: item.size_class),
        small_objects=coverage(owners, small, lambda item: item.class_name),
        kinds=kinds,
        options=options,
    )
