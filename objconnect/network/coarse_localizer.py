"""The localizer ``place``: the best candidate of the coarse search of a map, without alignment."""

from __future__ import annotations

from pathlib import Path

import torch
from pydantic import Field

from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.inference import Precision, fuse_layers
from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.coarse.finder import LONGER_SIDE_PX, CoarseSearch, CoarseSearchOptions
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.options import NetworkOptions
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import read_network
from objconnect.scene.localizer import Estimate, PoseSource, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.device import torch_device


class CoarseLocalizerConfig(NetworkOptions):
    """Options of the method ``place``."""

    precision: Precision = Field(
        "auto", validate_default=True, description="Precision of the convolutions."
    )
    place: CoarseSearchOptions = Field(
        CoarseSearchOptions(), description="Coarse search of the map."
    )


class CoarseLocalizer:
    """Returns the best candidate of the coarse search, without refinement by alignment.

    It implements ``objconnect.scene.localizer.Localizer``.
    """

    name = "place"

    def __init__(self, config: CoarseLocalizerConfig) -> None:
        self.config = config
        network, digest = read_network(config.weights or shipped_path(SHIPPED))
        network.to(torch_device(config.device))
        fuse_layers(network, config.precision)
        self.weights_sha256: str | None = digest
        extract = MapExtractor(network, 2 * LONGER_SIDE_PX, config.precision)
        self._finder = CoarseSearch(extract, config.place)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Make the mosaic of the map, or read it from the cache."""
        with open_cache(sparse_map, images, cache) as map_cache:
            self._finder.prepare(map_cache, f"{self.weights_sha256} {self.config.precision}")

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Return the best candidate of the coarse search."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        with clock.stage("place"):
            candidates = [each for found in self._finder.find(query) for each in found]
        if not candidates:
            reason = "the coarse search found no candidate"
            return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
        best = max(candidates, key=lambda each: each.score)
        return Estimate(Status.OK, best.pose, seconds=clock.seconds, by=PoseSource.PLACE)
