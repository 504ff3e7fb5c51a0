"""Localization by SIFT matches, which gives starts of the alignment."""

from __future__ import annotations

import logging

from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.matching.sift import Sift
from objconnect.localization.matching.structure import (
    NoKeypointOnPointError,
    StructureConfig,
    StructureLocalizer,
)

log = logging.getLogger(__name__)


def create_matcher(config: StructureConfig) -> StructureLocalizer:
    """Return the localizer by SIFT matches, not yet prepared."""
    return StructureLocalizer(config, Sift(config.max_features), interpolate=False)


def prepare_matcher(config: StructureConfig, kept: MapCache) -> StructureLocalizer | None:
    """Return the prepared localizer by SIFT matches; None if the map was not built from SIFT.

    Raises:
        InputError: a photograph is missing, damaged or changed meanwhile.
        WriteError: the cache cannot be written.
    """
    localizer = create_matcher(config)
    try:
        localizer.prepare_from(kept)
    except NoKeypointOnPointError as error:
        log.warning("no starts from matches: %s", error)
        return None
    return localizer
