"""Poses from matches of local features, as starts of the alignment."""

from __future__ import annotations

import logging
from pathlib import Path

from baselines.sift import SiftConfig, SiftLocalizer
from baselines.structure import NoKeypointOnPointError
from scene.maps.sparse_map import SparseMap

log = logging.getLogger(__name__)


def matcher(
    config: SiftConfig, sparse_map: SparseMap, images: Path, cache: Path
) -> SiftLocalizer | None:
    """Return the localizer by matches; None for a map that was not built from its features.

    Raises:
        InputError: a photograph is missing, damaged or changed meanwhile.
        WriteError: the cache cannot be written.
    """
    localizer = SiftLocalizer(config)
    try:
        localizer.prepare(sparse_map, images, cache)
    except NoKeypointOnPointError as error:
        log.warning("no starts from matches: %s", error)
        return None
    return localizer
