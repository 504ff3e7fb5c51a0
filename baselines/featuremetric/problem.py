"""What is aligned: an image, seen as the photographs of the map were, and points of theirs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.align.aligner import align
from baselines.align.descent import Options
from baselines.align.residuals import Level
from baselines.align.sampling import per_axis
from baselines.featuremetric.maps import FeatureMap, MapExtractor
from baselines.featuremetric.references import ReferenceFeatures, spaced_order
from baselines.resolution import metres_per_pixel, scale_to
from baselines.views import View, north
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.geometry.projection import Intrinsics
from scene.localizer import Query

# The coarsest level has a cell for so many pixels; an image must have one at least.
LEAST_SIDE: Final = 16


class Problem(NamedTuple):
    """The arguments of ``baselines.align.aligner.align``, of one image."""

    levels: list[Level]
    points: torch.Tensor
    intrinsics: Intrinsics
    start: Pose
    damping: list[torch.Tensor]
    options: Options


@dataclass(frozen=True)
class Problems:
    """Makes them of images, photographs of the map and starts (``cam_from_world``).

    Attributes:
        extract: of feature maps.
        observations: of the map's photographs, which are chosen by their rows.
        damping: of every level.
        options: of the alignment.
    """

    extract: MapExtractor
    observations: ReferenceFeatures
    damping: list[torch.Tensor]
    options: Options

    def scale(self, camera: Camera, chosen: NDArray[np.int64], start: Pose) -> float:
        """At which an image shows the ground as large as the photographs of the map do."""
        points = np.concatenate([self.observations[int(row)].xyz for row in chosen])
        own = metres_per_pixel(start, camera, points)
        largest = self.extract.largest_scale(camera)
        # The view must not fall below what the network needs.
        least = LEAST_SIDE / min(camera.width, camera.height)
        return max(scale_to(self.observations.metres_per_pixel, own, largest), least)

    def look(
        self, query: Query, chosen: NDArray[np.int64], start: Pose, levels: int | None = None
    ) -> tuple[View, list[FeatureMap]]:
        """The image as the photographs of the map were seen, if the start is right; so many levels
        of it from the coarsest, or all."""
        scale = self.scale(query.camera, chosen, start)
        angle = north(start.rotation.numpy())
        view, maps = self.extract(query.image, query.camera, angle, scale, levels)
        # Once for all problems that are made of them.
        unit = torch.nn.functional.normalize
        return view, [replace(each, features=unit(each.features, dim=1)) for each in maps]

    def of(
        self, view: View, maps: list[FeatureMap], chosen: NDArray[np.int64], start: Pose, count: int
    ) -> Problem:
        """At most ``count`` points, those first that the start sees, and what they look like.

        They cover the image evenly, though the references overlap most in its middle: tilting the
        camera and moving it are told apart only far from there. A point seen by several references
        counts once for each of them, as in the authors' code.
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
        order = spaced_order(projected.xy.numpy()[seen] / size, -turn[seen])
        kept = np.concatenate([seen[order], np.flatnonzero(~visible)])[:count]
        confidence = np.concatenate([each.confidence for each in observed])[kept]
        levels = []
        for number, level in enumerate(maps):
            reference = np.concatenate([each.features[number] for each in observed])[kept]
            levels.append(
                Level(
                    level.features,
                    level.stride,
                    torch.from_numpy(reference).float()[None],
                    level.confidence,
                    torch.from_numpy(confidence[:, number]).float()[None],
                )
            )
        return Problem(
            levels,
            torch.from_numpy(xyz[kept])[None],
            view.camera.intrinsics(),
            Pose(from_world.rotation[None], from_world.translation[None]),
            self.damping,
            self.options,
        )


def fit(problem: Problem, pose: Pose) -> float:
    """The cost at a pose, in parts of what other points would cost where these are seen."""
    levels, points, intrinsics, _, damping, options = problem
    still = replace(options, iterations=0)
    judge = len(levels) // 2
    level, held_back = levels[judge], damping[judge]
    projected = intrinsics.project(pose.transform(points))
    size = torch.tensor(level.features.shape[:1:-1], dtype=points.dtype)
    cells = projected.xy / per_axis(level.stride, points)
    seen = (projected.valid & (cells > 1).all(-1) & (cells < size - 1).all(-1))[0]
    if not bool(seen.any()):
        return math.inf
    # Those seen change places among themselves, and keep how far they are trusted: where all of the
    # picture looks the same, so do they. Neighbours in the list are of different parts of it.
    order = torch.nonzero(seen)[:, 0]
    other = torch.roll(order, len(order) // 2)

    def cost(which: torch.Tensor) -> float:
        trust = level.reference_confidence
        chosen = replace(
            level,
            reference=level.reference[:, which],
            reference_confidence=None if trust is None else trust[:, which],
        )
        return float(align([chosen], points[:, order], intrinsics, pose, [held_back], still).cost)

    return cost(order) / max(cost(other), 1e-12)
