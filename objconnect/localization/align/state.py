"""The state of the minimisation of a level's cost."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from objconnect.localization.align.residuals import Linearisation
from objconnect.scene.geometry.pose import Pose


@dataclass(frozen=True)
class State:
    """The state of M poses.

    Attributes:
        pose: (M) ``cam_from_world``.
        linearisation: the cost around the poses.
        iterations: (M,) number of steps tried.
        damping_factor: (M, 1) factor on the level's damping.
    """

    pose: Pose
    linearisation: Linearisation
    iterations: Tensor
    damping_factor: Tensor
