"""The state of a minimisation."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from objconnect.localization.align.residuals import Linearisation
from objconnect.scene.geometry.pose import Pose


@dataclass(frozen=True)
class State:
    """The state of M elements of a batch.

    Attributes:
        pose: ``cam_from_world``.
        iterations: (M,) steps tried.
        damping: (M, 1) factor on the level's damping.
    """

    pose: Pose
    around: Linearisation
    iterations: Tensor
    damping: Tensor
