"""The localizer ``prior``: the starting pose without refinement, to compare methods with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from objconnect.localization.matching.retrieval import References
from objconnect.localization.starts import start_of, starts
from objconnect.scene.config import Config
from objconnect.scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap


class PriorConfig(Config):
    """Options of the prior localizer."""


class PriorLocalizer:
    """Returns the first start of a query, as methods by alignment use it.

    Implements ``objconnect.scene.localizer.Localizer``.
    """

    name = "prior"
    weights_sha256: str | None = None

    def __init__(self, config: PriorConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Keep the poses of the map's photographs."""
        self._map = sparse_map
        unseen = [np.empty((0, 1), np.float32)] * len(sparse_map.names)
        self._references = References.build(sparse_map, unseen)

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
                return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
            start = starts(query.prior, self._map, chosen)[0]
        by = start_of(query.prior)
        return Estimate(Status.OK, start, seconds=clock.seconds, by=by)
