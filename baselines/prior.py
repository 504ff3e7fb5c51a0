"""The floor under every method that refines: the pose it starts from, and nothing done to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from baselines.retrieval import References
from baselines.starts import starts
from scene.config import Config
from scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from scene.maps.sparse_map import SparseMap


class PriorConfig(Config):
    """There is nothing to choose."""


class PriorLocalizer:
    """Answers the prior; for what it does not say, as methods by alignment do, that of the nearest
    photograph. Implements ``scene.localizer.Localizer``."""

    name = "prior"
    weights_sha256: str | None = None

    def __init__(self, config: PriorConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Nothing of the photographs but their poses is needed."""
        self._map = sparse_map
        unseen = [np.empty((0, 1), np.float32)] * len(sparse_map.names)
        self._references = References.build(sparse_map, unseen)

    def localize(self, query: Query) -> Estimate:
        """Where the query is believed to be."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        if query.prior is None and query.references is None:
            return Estimate(Status.FAILED, reason="no prior, and no photograph of the map is named")
        clock = Stopwatch()
        with clock.stage("retrieval"):
            chosen = self._references.choose(query, 1, lambda: np.empty((0, 1), np.float32))
            if not len(chosen):
                return Estimate(Status.FAILED, seconds=clock.seconds, reason="no reference")
            start = starts(query.prior, self._map, chosen)[0]
        return Estimate(Status.OK, start, seconds=clock.seconds)
