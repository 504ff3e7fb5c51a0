"""The localizer ``prior``: the starting pose without refinement, a baseline for other methods."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from objconnect.localization.initial_poses import list_initial_poses, source_of_initial_poses
from objconnect.localization.matching.retrieval import References
from objconnect.scene.config import Config
from objconnect.scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap


class PriorConfig(Config):
    """Options of the prior localizer."""


class PriorLocalizer:
    """Returns the initial pose of the methods that align features, without alignment.

    Implements ``objconnect.scene.localizer.Localizer``.
    """

    name = "prior"
    weights_sha256: str | None = None

    def __init__(self, config: PriorConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Keep the poses of the map's photographs."""
        self._map = sparse_map
        no_descriptors = [np.empty((0, 1), np.float32)] * len(sparse_map.names)
        self._references = References.build(sparse_map, no_descriptors)

    def localize(self, query: Query) -> Estimate:
        """Return the query's starting pose."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if query.references is None:
            if query.prior is None:
                reason = "the query has no prior and names no reference image"
                return Estimate(Status.FAILED, reason=reason)
            if not query.prior.has_position:
                return Estimate(Status.FAILED, reason="the prior has no position")
        clock = Stopwatch()
        with clock.stage("retrieval"):
            chosen = self._references.choose(query, 1, lambda: np.empty((0, 1), np.float32))
            if not len(chosen):
                return Estimate(
                    Status.FAILED,
                    seconds=clock.seconds,
                    reason="no map photograph was found for the query",
                )
            start = list_initial_poses(query.prior, self._map, chosen)[0]
        by = source_of_initial_poses(query.prior)
        return Estimate(Status.OK, start, seconds=clock.seconds, by=by)
