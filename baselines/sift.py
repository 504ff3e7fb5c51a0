"""The localizer ``sift``: COLMAP's SIFT matches with reference images, and PnP."""

from __future__ import annotations

from objconnect.localization.matching.sift import Sift
from objconnect.localization.matching.structure import StructureConfig, StructureLocalizer


class SiftConfig(StructureConfig):
    """Options of the sift localizer; see ``StructureConfig``."""


class SiftLocalizer(StructureLocalizer):
    """The localizer ``sift``."""

    def __init__(self, config: SiftConfig) -> None:
        super().__init__(config, Sift(config.max_features), interpolate=False)
