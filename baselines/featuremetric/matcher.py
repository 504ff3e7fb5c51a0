"""Poses from matches of local features, as starts of the alignment."""

from __future__ import annotations

import logging
from pathlib import Path

from baselines.sift import SiftConfig, SiftLocalizer
from scene.errors import InputError
from scene.maps.sparse_map import SparseMap

log = logging.getLogger(__name__)


def matcher(
    config: SiftConfig, sparse_map: SparseMap, images: Path, cache: Path
) -> SiftLocalizer | None:
    """Return the localizer by matches; None for a map that was not built from its features."""
    localizer = SiftLocalizer(config)
    try:
        localizer.prepare(sparse_map, images, cache)
    except InputError as error:
        log.info("no starts from matches: %s", error)
        return None
    return localizer
