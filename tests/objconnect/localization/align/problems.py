"""Small alignments with a known answer, made once for all tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import torch
from torch import Tensor

from objconnect.localization.align.aligner import Alignment, align
from objconnect.localization.align.options import Options
from objconnect.localization.align.problem import Problem
from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.localization.align.world import PINHOLE, World, looking_down

DAMPING = [torch.full((6,), 1e-3)] * 3
PLAIN = Options(iterations=8, adaptive_damping=False)


@dataclass(frozen=True)
class Small:
    """A picture of 320 x 256 pixels, 200 points of the ground in it."""

    truth: Pose
    points: Tensor
    levels: list[Level]

    def align(self, start: Pose, options: Options | None = None) -> Alignment:
        """From starts (B) or (B, K)."""
        return align(
            Problem(
                self.levels, self.points, PINHOLE.intrinsics(), start, DAMPING, options or Options()
            )
        )


@cache
def small(seed: int = 0, wavelengths: tuple[float, ...] = (25, 8, 4), longest: float = 4) -> Small:
    """The problem of a seed."""
    world, truth = World(seed, wavelengths, longest, (16, 4, 2)), looking_down(seed)
    points = world.points(PINHOLE, truth, 200)
    levels = world.levels(PINHOLE, truth, points, noise=0.05)
    return Small(truth, torch.as_tensor(points)[None], levels)


def batch(problems: Sequence[Small]) -> Small:
    """Several as one."""

    def join(levels: tuple[Level, ...]) -> Level:
        return replace(
            levels[0],
            features=torch.cat([level.features for level in levels]),
            reference=torch.cat([level.reference for level in levels]),
        )

    levels = [join(each) for each in zip(*(p.levels for p in problems), strict=True)]
    return Small(
        stack_problems([p.truth for p in problems]), torch.cat([p.points for p in problems]), levels
    )


def stack_problems(poses: Sequence[Pose]) -> Pose:
    """Single poses as one batch."""
    return Pose(
        torch.stack([p.rotation for p in poses]), torch.stack([p.translation for p in poses])
    )
