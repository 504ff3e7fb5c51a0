"""The localizers ``aliked+lightglue`` and ``disk+lightglue``: LightGlue's matches, and PnP.

The map was not built from these keypoints, so ``matching.lifting`` interpolates their 3D points
between the map's observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.lightglue.config import AlikedLightGlueConfig, DiskLightGlueConfig
from baselines.lightglue.extraction import Aliked, Disk, KorniaExtractor
from objconnect.localization.matching.matcher import Keypoints
from objconnect.localization.matching.structure import StructureLocalizer


@dataclass(frozen=True)
class LightGlueMatcher:
    """Pairs keypoints by LightGlue; see ``objconnect.localization.matching.matcher.Matcher``.

    Attributes:
        extractor: extractor of the keypoints, which also loads LightGlue.
    """

    extractor: KorniaExtractor

    def __call__(
        self, query: Keypoints, references: Sequence[Keypoints]
    ) -> Sequence[NDArray[np.int64]]:
        """Return the pairs with each reference image."""
        return [self._pair(query, reference) for reference in references]

    def _pair(self, query: Keypoints, reference: Keypoints) -> NDArray[np.int64]:
        if not len(query.xy) or not len(reference.xy):
            return np.zeros((0, 2), np.int64)
        # Positions are relative to the picture's centre. LightGlue divides them by the picture's
        # size, so both pictures get the same size to keep the same scale.
        half = max(float(np.abs(each.xy).max()) for each in (query, reference))
        data = {
            name: self._describe(each, half)
            for name, each in (("image0", query), ("image1", reference))
        }
        with torch.inference_mode():
            matches: torch.Tensor = self.extractor.networks[1](data)["matches"][0]
        return matches.cpu().numpy()

    def _describe(self, keypoints: Keypoints, half: float) -> dict[str, torch.Tensor]:
        """Return LightGlue's input for a square picture whose side is ``2 * half`` pixels."""
        device = self.extractor.device
        side = max(2 * half, 1.0)
        return {
            "keypoints": torch.from_numpy(keypoints.xy)[None].to(device) + side / 2,
            "descriptors": torch.from_numpy(keypoints.descriptors).float()[None].to(device),
            "image_size": torch.tensor([[side, side]], device=device),
        }


class AlikedLightGlueLocalizer(StructureLocalizer):
    """The localizer ``aliked+lightglue``."""

    def __init__(self, config: AlikedLightGlueConfig) -> None:
        extractor = Aliked(config)
        super().__init__(config, extractor, LightGlueMatcher(extractor), interpolate=True)


class DiskLightGlueLocalizer(StructureLocalizer):
    """The localizer ``disk+lightglue``."""

    def __init__(self, config: DiskLightGlueConfig) -> None:
        extractor = Disk(config)
        super().__init__(config, extractor, LightGlueMatcher(extractor), interpolate=True)
