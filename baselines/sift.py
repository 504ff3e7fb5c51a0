"""COLMAP's DoG SIFT with RootSIFT descriptors (Arandjelovic and Zisserman, CVPR 2012).

The map was built from the same keypoints, so that they carry its points as they are. pycolmap is
imported at the first extraction: it takes 60 MB, and maps hold their features.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from baselines.features import Extractor
from baselines.structure import StructureConfig, StructureLocalizer
from scene.colmap.options import SiftOptions
from scene.maps.features import Features

if TYPE_CHECKING:
    from scene.colmap.sift import SiftExtractor


class Sift(Extractor):
    """SIFT as the maps are built from it, at most ``max_features`` an image."""

    name = "sift"

    def __init__(self, max_features: int) -> None:
        self._options = SiftOptions(max_features=max_features)
        self.options = str(self._options)

    @cached_property
    def _extract(self) -> SiftExtractor:
        from scene.colmap.sift import SiftExtractor

        return SiftExtractor(self._options)

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        return self._extract(rgb)

    def of_photographs(
        self,
        root: Path,
        names: Sequence[str],
        on_progress: Callable[[int], None],
        beside: Path | None = None,
    ) -> dict[str, Features]:
        """Extract on all cores; see ``Extractor``."""
        from scene.colmap.sift import extract_sift

        return extract_sift(root, names, self._options, on_progress, beside=beside)


class SiftConfig(StructureConfig):
    """Options of the sift localizer; see ``StructureConfig``."""


class SiftLocalizer(StructureLocalizer):
    """Localizes by SIFT features of the nearest photographs of the map."""

    def __init__(self, config: SiftConfig) -> None:
        super().__init__(config, Sift(config.max_features), interpolate=False)
