"""Alignment problems: features of an image, and of map points in view from an initial pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.align.local_frame import LocalProblem
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level, robust_cost
from objconnect.localization.align.sampling import per_axis
from objconnect.localization.featuremetric.maps import FeatureMap, MapExtractor
from objconnect.localization.featuremetric.references import (
    ReferenceFeatures,
    order_by_coverage,
)
from objconnect.localization.resolution import SAME_RESOLUTION, metres_per_pixel, scale_to
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import WarpedImage, level_rotation, north_angle, tilt
from objconnect.scene.localizer import Query
from objconnect.scene.maps.sparse_map import SparseMap

# Numerical guard: a cost by chance below this means that all features are equal.
_MIN_CHANCE_COST: Final = 1e-12
LEAST_SIDE: Final = 16
"""Least side of an image, pixels: one cell of the coarsest level."""


@dataclass(frozen=True)
class Levelling:
    """Warps images that are tilted much more than the map's photographs to a smaller tilt.

    Attributes:
        tilts: (N,) tilts of the photographs, radians.
        most_tilt: angle by which the tilt of an image may exceed the median tilt of its reference
            images, radians; infinite to warp no image.
    """

    tilts: NDArray[np.float64]
    most_tilt: float

    @staticmethod
    def of(sparse_map: SparseMap, most_tilt_deg: float | None) -> Levelling:
        """Return the levelling for a map; ``most_tilt_deg`` None levels no image."""
        poses = (sparse_map.images[name].cam_from_world for name in sparse_map.names)
        most = math.inf if most_tilt_deg is None else math.radians(most_tilt_deg)
        return Levelling(np.array([tilt(pose[:3, :3]) for pose in poses]), most)

    def __call__(
        self, start: Pose, reference_rows: NDArray[np.int64]
    ) -> NDArray[np.float64] | None:
        """Return ``view_from_camera`` (3, 3) of a levelled image; None if it needs no levelling.

        Args:
            start: ``cam_from_world`` of the image.
            reference_rows: rows of its reference images.
        """
        rotation = start.rotation.numpy()
        limit = float(np.median(self.tilts[reference_rows])) + self.most_tilt
        return level_rotation(rotation, limit) @ rotation.T if tilt(rotation) > limit else None


@dataclass(frozen=True)
class ProblemBuilder:
    """Builds alignment problems of images, reference images and starts (``cam_from_world``).

    Attributes:
        extract: computes feature maps.
        observations: observations of the map's photographs, by row.
        centres: (M, 3) camera centres of the photographs, world metres.
        damping: (6,) damping factors of every level, coarse to fine.
        options: options of the alignment.
        levelling: levels tilted images; None levels no image.
    """

    extract: MapExtractor
    observations: ReferenceFeatures
    centres: NDArray[np.float64]
    damping: list[torch.Tensor]
    options: Options
    levelling: Levelling | None = None

    def scale(
        self,
        camera: Camera,
        reference_rows: NDArray[np.int64],
        start: Pose,
        view_from_camera: NDArray[np.float64] | None = None,
        pixel_ratio: float | None = None,
        max_magnification: float = 1.0,
    ) -> float:
        """Return the scale at which an image has the ground resolution of the map's photographs.

        Args:
            camera: camera of the image.
            reference_rows: rows of its reference images.
            start: ``cam_from_world``.
            view_from_camera: (3, 3) rotation that levels the image; None if it is not levelled.
            pixel_ratio: target resolution (m/px) as a multiple of the photographs'; None for the
                photographs' resolution; an image that nearly has it is then not resized.
            max_magnification: upper bound of the scale.
        """
        points = np.concatenate([self.observations[int(row)].xyz for row in reference_rows])
        resolution = metres_per_pixel(start, camera, points, view_from_camera)
        largest = self.extract.largest_scale(camera, max_magnification)
        # The shorter side of a view must have at least LEAST_SIDE pixels.
        least = LEAST_SIDE / min(camera.width, camera.height)
        wanted = self.observations.target_resolution
        same = SAME_RESOLUTION
        if pixel_ratio is not None:
            wanted, same = pixel_ratio * wanted, 1.0
        return max(scale_to(wanted, resolution, largest, same), least)

    def view(
        self,
        query: Query,
        reference_rows: NDArray[np.int64],
        start: Pose,
        levels: int | None = None,
    ) -> tuple[WarpedImage, list[FeatureMap]]:
        """Warp an image for a start and extract its features.

        If the start is right, the warped image is north up and has the map's resolution. An image
        that is tilted much more than its reference images is levelled.

        Args:
            query: the image.
            reference_rows: rows of its reference images.
            start: ``cam_from_world``.
            levels: number of levels to extract, from the coarsest; None for all.

        Returns:
            The warped image and its feature maps, of unit length.
        """
        view = self.warp(query, reference_rows, start)
        return view, self.features(view, levels)

    def warp(
        self,
        query: Query,
        reference_rows: NDArray[np.int64],
        start: Pose,
        pixel_ratio: float | None = None,
    ) -> WarpedImage:
        """Warp an image as ``view`` does; ``pixel_ratio`` is as in ``scale``."""
        view_from_camera = self._view_from_camera(reference_rows, start)
        scale = self.scale(query.camera, reference_rows, start, view_from_camera, pixel_ratio)
        return self._warp(query, start, scale, view_from_camera)

    def magnify(
        self,
        query: Query,
        reference_rows: NDArray[np.int64],
        start: Pose,
        view: WarpedImage,
        max_magnification: float,
    ) -> WarpedImage | None:
        """Warp an image that is coarser than the map's photographs to their resolution.

        Args:
            query: the image.
            reference_rows: rows of its reference images.
            start: ``cam_from_world``.
            view: the image warped without magnification.
            max_magnification: upper bound of the scale.

        Returns:
            The warped image; None if ``view`` nearly has the photographs' resolution.
        """
        view_from_camera = self._view_from_camera(reference_rows, start)
        scale = self.scale(
            query.camera,
            reference_rows,
            start,
            view_from_camera,
            max_magnification=max_magnification,
        )
        if scale < SAME_RESOLUTION * view.scale:
            return None
        return self._warp(query, start, scale, view_from_camera)

    def _view_from_camera(
        self, reference_rows: NDArray[np.int64], start: Pose
    ) -> NDArray[np.float64] | None:
        return self.levelling(start, reference_rows) if self.levelling else None

    def _warp(
        self, query: Query, start: Pose, scale: float, view_from_camera: NDArray[np.float64] | None
    ) -> WarpedImage:
        angle = north_angle(start.rotation.numpy())
        return self.extract.warp(query.image, query.camera, angle, scale, view_from_camera)

    def features(self, view: WarpedImage, levels: int | None = None) -> list[FeatureMap]:
        """Return feature maps of a view, of unit length."""
        maps = self.extract.features(view, levels)
        for each in maps:  # here, because several problems may be built from these maps
            torch.nn.functional.normalize(each.features, dim=1, out=each.features)
        return maps

    def build(
        self,
        view: WarpedImage,
        maps: list[FeatureMap],
        reference_rows: NDArray[np.int64],
        start: Pose,
        count: int,
    ) -> Problem:
        """Build the problem of a view with at most ``count`` points, those in view first.

        The points are chosen on the CPU; the problem is on the device of the maps. The reference
        images overlap most in the middle of the image, but the chosen points cover the image
        evenly, because only points far from the middle tell a rotation of the camera from a shift.
        A point in several reference images is used once for each of them, as in PixLoc's code.

        Args:
            view: the warped image.
            maps: its feature maps.
            reference_rows: rows of the reference images that give the points.
            start: ``cam_from_world`` of the image.
            count: maximum number of points.
        """
        from_world = view.pose(start)
        observed = [self.observations[int(row)] for row in reference_rows]
        xyz = np.concatenate([each.xyz for each in observed])
        rank = np.concatenate([np.arange(len(each.xyz)) for each in observed])
        in_camera = from_world.transform(torch.from_numpy(xyz))
        projected = view.camera.project(in_camera)
        inside = projected.valid & view.camera.contains(projected.xy)
        visible = inside.numpy() & view.shows(projected.xy.numpy())
        seen = np.flatnonzero(visible)
        size = np.array([view.camera.width, view.camera.height])
        order = order_by_coverage(projected.xy.numpy()[seen] / size, -rank[seen])
        kept = np.concatenate([seen[order], np.flatnonzero(~visible)])[:count]
        confidence = np.concatenate([each.confidence for each in observed])[kept]
        seen_from = np.repeat(
            self.centres[reference_rows], [len(each.xyz) for each in observed], 0
        )[kept]
        device = self.extract.device
        levels = []
        for number, level in enumerate(maps):
            reference = np.concatenate([each.features[number] for each in observed])[kept]
            levels.append(
                Level(
                    level.features,
                    level.stride,
                    torch.from_numpy(reference).to(device).float()[None],
                    level.confidence,
                    torch.from_numpy(confidence[:, number]).to(device).float()[None],
                )
            )
        return Problem(
            levels,
            torch.from_numpy(xyz[kept]).to(device)[None],
            view.camera.intrinsics(device=device),
            Pose(from_world.rotation[None], from_world.translation[None]).to(device=device),
            self.damping,
            self.options,
            seen_from=torch.from_numpy(seen_from).to(device)[None],
        )


def relative_cost(problem: Problem, pose: Pose) -> float:
    """Return the cost at a pose as a share of the cost by chance.

    The cost by chance is the cost at the same pose after the points in view have swapped their
    features. The result is 1 if all features are equal. It is infinite if no point is in view or
    too few have confidence.

    Args:
        problem: problem of one image.
        pose: ``cam_from_world``, batched (1).
    """
    points, options = problem.points, problem.options
    level = problem.levels[len(problem.levels) // 2]
    projected = problem.intrinsics.project(pose.transform(points))
    size = points.new_tensor(level.features.shape[:1:-1])
    cells = projected.xy / per_axis(level.stride, points)
    seen = (projected.valid & (cells > 1).all(-1) & (cells < size - 1).all(-1))[0]
    if not bool(seen.any()):
        return math.inf
    # For the cost by chance, each point gets the reference features of the point half the list
    # away, which is rarely near it in the picture. Where the picture looks the same everywhere,
    # these features fit as well.
    order = torch.nonzero(seen)[:, 0]
    swapped = torch.roll(order, len(order) // 2)
    local = LocalProblem.of(replace(problem, points=points[:, order], mask=None).starting_at(pose))
    cost = local.cost(level, options)
    values, confidence = cost.sample(local.start)

    def mean_cost(rows: torch.Tensor) -> float:
        """Return the mean cost with the reference features of the points in these rows."""
        weight = confidence
        if level.reference_confidence is not None:
            weight = confidence * level.reference_confidence[:, rows]
        if int((weight > 0).sum()) < options.min_points:
            return math.inf
        squared = ((values - level.reference[:, rows].to(values)) ** 2).sum(-1)
        each = weight * robust_cost(squared, options.robust_scale)
        return float(each.sum() / weight.sum())

    chance = mean_cost(swapped)
    if not math.isfinite(chance):
        return math.inf
    # Equal features cost nothing at any pose and do not localize.
    return mean_cost(order) / chance if chance > _MIN_CHANCE_COST else 1.0
