"""Problems that PixLoc's own optimizer was given too, and what it answered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor

from objconnect.localization.align.residuals import Level
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from tests.objconnect.localization.align.world import DISTORTED, PINHOLE, World, looking_down, wrong

RECORD: Final = Path(__file__).parents[3] / "data/official/pixloc-65a51a7-optimizer.npz"
CASES: Final = ("pinhole", "pinhole-confident", "distorted", "distorted-confident")
ITERATIONS: Final = (1, 5, 15)


@dataclass(frozen=True)
class Case:
    """One problem; ``thetas`` are the raw damping parameters of each level, rotation first."""

    camera: Camera
    levels: list[Level]
    points: Tensor
    start: Pose
    thetas: list[Tensor]


def case(name: str) -> Case:
    """The problem of a name."""
    seed = CASES.index(name)
    camera = DISTORTED if name.startswith("distorted") else PINHOLE
    world, truth = World(seed), looking_down(seed)
    points = world.points(camera, truth, 300)
    levels = world.levels(camera, truth, points, confident="confident" in name, noise=0.05)
    rng = np.random.default_rng([seed, 5])
    thetas = [torch.as_tensor(rng.normal(-0.5, 0.3, 6).astype(np.float32)) for _ in levels]
    return Case(camera, levels, torch.as_tensor(points), wrong(truth, 3, 3, seed), thetas)
