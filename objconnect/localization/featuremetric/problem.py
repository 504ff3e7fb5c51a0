"""Alignment problems of images: what an image and points of the map look like from a start."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.localization.align.local_frame import Local
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

# Numerical guard: a cost by chance this small is that of features which are all the same.
_NOTHING: Final = 1e-12
LEAST_SIDE: Final = 16
"""Least side of an image, pixels: that of one cell of the coarsest level."""


@dataclass(frozen=True)
class Levelling:
    """How images that look at the ground more flatly than the map's photographs are levelled.

    Attributes:
        tilts: (N,) of the photographs, radians.
        most_tilt: radians by which an image may look flatter; infinite where none is levelled.
    """

    tilts: NDArray[np.float64]
    most_tilt: float

    @staticmethod
    def of(sparse_map: SparseMap, most_tilt_deg: float | None) -> Levelling:
        """Return that of a map; None levels no image."""
        poses = (sparse_map.images[name].cam_from_world for name in sparse_map.names)
        most = math.inf if most_tilt_deg is None else math.radians(most_tilt_deg)
        return Levelling(np.array([tilt(pose[:3, :3]) for pose in poses]), most)

    def __call__(self, start: Pose, chosen: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """Return ``view_from_camera`` (3, 3) of a levelled image; None where it stays as it is.

        Args:
            start: ``cam_from_world`` of the image.
            chosen: rows of the photographs that it is compared with.
        """
        rotation = start.rotation.numpy()
        least = float(np.median(self.tilts[chosen])) + self.most_tilt
        return level_rotation(rotation, least) @ rotation.T if tilt(rotation) > least else None


@dataclass(frozen=True)
class ProblemBuilder:
    """Builds alignment problems of images, photographs of the map and starts (``cam_from_world``).

    Attributes:
        extract: computes feature maps.
        observations: of the map's photographs, which are chosen by their rows.
        centres: (M, 3) of the photographs, world metres.
        damping: of every level.
        options: of the alignment.
        levelling: of images that are tilted more than the photographs; None for no image.
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
        chosen: NDArray[np.int64],
        start: Pose,
        view_from_camera: NDArray[np.float64] | None = None,
        coarser: float | None = None,
        magnification: float = 1.0,
    ) -> float:
        """Return the scale at which an image has the ground resolution of the map's photographs.

        Args:
            camera: of the image.
            chosen: rows of the photographs.
            start: ``cam_from_world``.
            view_from_camera: (3, 3) how the camera is then turned; None for not at all.
            coarser: metres per pixel over those of the photographs; None leaves an image as it is
                where they are nearly the same.
            magnification: the largest scale.
        """
        points = np.concatenate([self.observations[int(row)].xyz for row in chosen])
        own = metres_per_pixel(start, camera, points, view_from_camera)
        largest = self.extract.largest_scale(camera, magnification)
        # The view must not fall below what the network needs.
        least = LEAST_SIDE / min(camera.width, camera.height)
        wanted = self.observations.metres_per_pixel
        same = SAME_RESOLUTION
        if coarser is not None:
            wanted, same = coarser * wanted, 1.0
        return max(scale_to(wanted, own, largest, same), least)

    def view(
        self, query: Query, chosen: NDArray[np.int64], start: Pose, levels: int | None = None
    ) -> tuple[WarpedImage, list[FeatureMap]]:
        """Warp an image as the map's photographs were, if a start is right, and extract features.

        An image that looks at the ground much more flatly than they do is levelled.

        Args:
            query: the image.
            chosen: rows of the photographs.
            start: ``cam_from_world``.
            levels: how many levels to extract, from the coarsest; None for all.

        Returns:
            The warped image and its feature maps, of unit length.
        """
        view = self.warp(query, chosen, start)
        return view, self.features(view, levels)

    def warp(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        start: Pose,
        coarser: float | None = None,
    ) -> WarpedImage:
        """Warp an image as ``view`` does, with the same arguments; ``coarser`` as in ``scale``."""
        turn = self._turn(chosen, start)
        scale = self.scale(query.camera, chosen, start, turn, coarser)
        return self._warp(query, start, scale, turn)

    def magnify(
        self,
        query: Query,
        chosen: NDArray[np.int64],
        start: Pose,
        view: WarpedImage,
        magnification: float,
    ) -> WarpedImage | None:
        """Warp an image that is coarser than the map's photographs so that it has their resolution.

        Args:
            query: the image.
            chosen: rows of the photographs.
            start: ``cam_from_world``.
            view: the image as it is seen without.
            magnification: most pixels per pixel of the image.

        Returns:
            None where the view has nearly that resolution.
        """
        turn = self._turn(chosen, start)
        scale = self.scale(query.camera, chosen, start, turn, magnification=magnification)
        if scale < SAME_RESOLUTION * view.scale:
            return None
        return self._warp(query, start, scale, turn)

    def _turn(self, chosen: NDArray[np.int64], start: Pose) -> NDArray[np.float64] | None:
        return self.levelling(start, chosen) if self.levelling else None

    def _warp(
        self, query: Query, start: Pose, scale: float, turn: NDArray[np.float64] | None
    ) -> WarpedImage:
        angle = north_angle(start.rotation.numpy())
        return self.extract.warp(query.image, query.camera, angle, scale, turn)

    def features(self, view: WarpedImage, levels: int | None = None) -> list[FeatureMap]:
        """Return feature maps of a view, of unit length, as ``view`` does."""
        maps = self.extract.features(view, levels)
        for each in maps:  # once for all problems that are made of them
            torch.nn.functional.normalize(each.features, dim=1, out=each.features)
        return maps

    def build(
        self,
        view: WarpedImage,
        maps: list[FeatureMap],
        chosen: NDArray[np.int64],
        start: Pose,
        count: int,
    ) -> Problem:
        """Build the problem of a view with at most ``count`` points, those in view first.

        The points are chosen on the processor; the problem is on the device of the maps.

        The points cover the image evenly, though the references overlap most in its middle: tilting
        the camera and moving it are told apart only far from there. A point seen by several
        references counts once for each of them, as in the authors' code.

        Args:
            view: of the image.
            maps: its feature maps.
            chosen: rows of the photographs that give the points.
            start: ``cam_from_world`` of the image.
            count: most points.
        """
        from_world = view.pose(start)
        observed = [self.observations[int(row)] for row in chosen]
        xyz = np.concatenate([each.xyz for each in observed])
        turn = np.concatenate([np.arange(len(each.xyz)) for each in observed])
        in_camera = from_world.transform(torch.from_numpy(xyz))
        projected = view.camera.project(in_camera)
        inside = projected.valid & view.camera.contains(projected.xy)
        visible = inside.numpy() & view.shows(projected.xy.numpy())
        seen = np.flatnonzero(visible)
        size = np.array([view.camera.width, view.camera.height])
        order = order_by_coverage(projected.xy.numpy()[seen] / size, -turn[seen])
        kept = np.concatenate([seen[order], np.flatnonzero(~visible)])[:count]
        confidence = np.concatenate([each.confidence for each in observed])[kept]
        seen_from = np.repeat(self.centres[chosen], [len(each.xyz) for each in observed], 0)[kept]
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


def fit(problem: Problem, pose: Pose) -> float:
    """Return the cost at a pose as a share of the cost with features of other points.

    It is 1 where the features are all the same, and infinite where no point is in view.

    Args:
        problem: of one image.
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
    # Points in view swap features among themselves and keep their confidences: where the whole
    # picture looks the same, they fit as well. Neighbours in the list lie in different parts of it.
    order = torch.nonzero(seen)[:, 0]
    other = torch.roll(order, len(order) // 2)
    local = Local.of(replace(problem, points=points[:, order], mask=None).starting_at(pose))
    cost = local.cost(level, options)
    values, trust = cost.sample(local.start)

    def mean_cost(which: torch.Tensor) -> float:
        weight = trust
        if level.reference_confidence is not None:
            weight = trust * level.reference_confidence[:, which]
        if int((weight > 0).sum()) < options.min_points:
            return math.inf
        squared = ((values - level.reference[:, which].to(values)) ** 2).sum(-1)
        each = weight * robust_cost(squared, options.robust_scale)
        return float(each.sum() / weight.sum())

    chance = mean_cost(other)
    if not math.isfinite(chance):
        return math.inf
    # Features that are all the same cost nothing at any pose: they tell no place from another.
    return mean_cost(order) / chance if chance > _NOTHING else 1.0
