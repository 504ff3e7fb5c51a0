"""Localization by SIFT matches, whose pose is the initial pose of an alignment."""

from __future__ import annotations

import logging

from objconnect.localization.cache.map_cache import MapCache
from objconnect.localization.matching.matcher import NearestNeighbours
from objconnect.localization.matching.sift import Sift
from objconnect.localization.matching.structure import (
    NoKeypointOnPointError,
    StructureConfig,
    StructureLocalizer,
)

log = logging.getLogger(__name__)


def create_matcher(config: StructureConfig) -> StructureLocalizer:
    """Return the localizer by SIFT matches, not yet prepared."""
    sift = Sift(config.max_features)
    matcher = NearestNeighbours(sift, config.ratio)
    return StructureLocalizer(config, sift, matcher, interpolate=False)


def prepare_matcher(config: StructureConfig, map_cache: MapCache) -> StructureLocalizer | None:
    """Return the prepared localizer by SIFT matches; None if the map was not built from SIFT.

    Raises:
        InputError: a photograph is missing, damaged or changed meanwhile.
        WriteError: the cache cannot be written.
    """
    localizer = create_matcher(config)
    try:
        localizer.prepare_from(map_cache)
    except NoKeypointOnPointError as error:
        log.warning("the alignment has no starts from SIFT matches: %s", error)
        return None
    return localizer
