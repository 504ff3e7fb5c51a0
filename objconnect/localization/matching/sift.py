"""COLMAP's DoG SIFT with RootSIFT descriptors (Arandjelovic and Zisserman, CVPR 2012).

Maps are built from the same keypoints, so that keypoints have 3D points without interpolation.
pycolmap, which takes 60 MB, is imported at the first extraction, because most maps hold their
features already.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from objconnect.localization.matching.features import Extractor
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.maps.features import Features

if TYPE_CHECKING:
    from objconnect.scene.colmap.sift import SiftExtractor


class Sift(Extractor):
    """The SIFT that maps are built from, at most ``max_features`` per image."""

    name = "sift"

    def __init__(self, max_features: int) -> None:
        self._options = SiftOptions(max_features=max_features)
        self.options = str(self._options)

    @cached_property
    def _extract(self) -> SiftExtractor:
        from objconnect.scene.colmap.sift import SiftExtractor

        return SiftExtractor(self._options)

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        return self._extract(rgb)

    def extract_photographs(
        self,
        root: Path,
        names: Sequence[str],
        on_progress: Callable[[int], None],
        temporary_root: Path | None = None,
    ) -> dict[str, Features]:
        """Extract features of photographs on all cores; see ``Extractor``."""
        from objconnect.scene.colmap.sift import extract_sift

        return extract_sift(root, names, self._options, on_progress, parent=temporary_root)
