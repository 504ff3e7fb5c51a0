"""The localizer ``sift``: COLMAP's SIFT matches with reference images, and PnP."""

from __future__ import annotations

from objconnect.localization.matching.matcher import NearestNeighbours
from objconnect.localization.matching.sift import Sift
from objconnect.localization.matching.structure import StructureConfig, StructureLocalizer


class SiftConfig(StructureConfig):
    """Options of the sift localizer; see ``StructureConfig``."""


class SiftLocalizer(StructureLocalizer):
    """The localizer ``sift``."""

    def __init__(self, config: SiftConfig) -> None:
        sift = Sift(config.max_features)
        matcher = NearestNeighbours(sift, config.ratio)
        super().__init__(config, sift, matcher, interpolate=False)
