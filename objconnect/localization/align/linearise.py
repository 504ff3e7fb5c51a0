"""Linearisation of the cost around poses, by compiled loops if possible, else by torch."""

from __future__ import annotations

import torch

from objconnect.localization.align.residuals import LevelCost, Linearisation
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.runtime.device import supports_loops


def linearise(cost: LevelCost, cam_from_world: Pose) -> Linearisation:
    """Return a cost around poses ``cam_from_world`` (M), with its derivatives."""
    if can_be_compiled(cost):
        from objconnect.localization.align.compiled_loops import linearise_compiled

        return linearise_compiled(cost, cam_from_world)
    return cost.linearise(cam_from_world)


def can_be_compiled(cost: LevelCost) -> bool:
    """Return whether compiled loops apply: single precision on the CPU without gradients."""
    tensors = (cost.table.values, cost.points, cost.reference)
    is_single = all(each.dtype == torch.float32 for each in tensors)
    return is_single and torch.is_inference_mode_enabled() and supports_loops(cost.points.device)
