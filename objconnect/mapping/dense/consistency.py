"""Check the consistency of a depth map with the depth maps of its sources."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor

from objconnect.mapping.dense.options import DEFAULTS, DenseOptions
from objconnect.mapping.dense.warp import StereoView, Warp, round_trip

# Two maps agree at a pixel where their relative depth difference is below this.
_SAME_DEPTH: Final = 0.01


def count_agreeing(
    reference: StereoView,
    sources: Sequence[StereoView],
    inverse: Tensor,
    inverse_of_sources: Sequence[Tensor],
    options: DenseOptions = DEFAULTS,
) -> Tensor:
    """Count the sources whose depth maps confirm each pixel of the reference, (H, W) int64.

    Args:
        reference: the reference view.
        sources: the source views.
        inverse: inverse depths (H, W) of the reference, 0 where unknown.
        inverse_of_sources: inverse depths (H, W) of each source, 0 where unknown.
        options: thresholds within which two maps agree.
    """
    x, y = reference.camera.pixel_grid(torch.float32).to(inverse.device).unbind(-1)
    count = torch.zeros(inverse.shape, dtype=torch.int64, device=inverse.device)
    for source, map_of_source in zip(sources, inverse_of_sources, strict=True):
        there, back = Warp.between(reference, source), Warp.between(source, reference)
        error_px, relative_error = round_trip(there, back, map_of_source, x, y, inverse)
        close = (error_px < options.same_px) & (relative_error.abs() < _SAME_DEPTH)
        count += close & (inverse > 0)
    return count
