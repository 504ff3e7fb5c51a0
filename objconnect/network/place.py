"""Place search with the object-connect network, as a method of its own: the best start it finds."""

from __future__ import annotations

from pathlib import Path

import torch
from pydantic import Field

from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.inference import Precision, fold
from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.coarse.finder import LONGEST, CoarseSearch, CoarseSearchOptions
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import read_network
from objconnect.scene.config import Config
from objconnect.scene.localizer import By, Estimate, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.device import AUTO, Device, torch_device


class PlaceConfig(Config):
    """Options of the method ``place``."""

    weights: Path | None = Field(
        None,
        description="File of an object-connect network; None is the one that comes with the "
        "project.",
    )
    device: Device = AUTO
    precision: Precision = Field(
        "auto", validate_default=True, description="Precision of the convolutions."
    )
    place: CoarseSearchOptions = Field(CoarseSearchOptions(), description="Search of the map.")


class PlaceLocalizer:
    """Answers the best start of the place search, unrefined: good to some metres and degrees.

    Implements ``objconnect.scene.localizer.Localizer``.
    """

    name = "place"

    def __init__(self, config: PlaceConfig) -> None:
        self.config = config
        network, digest = read_network(config.weights or shipped_path(SHIPPED))
        network.to(torch_device(config.device))
        fold(network, config.precision)
        self.weights_sha256: str | None = digest
        extract = MapExtractor(network, 2 * LONGEST, config.precision)
        self._finder = CoarseSearch(extract, config.place)

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        """Make the mosaic of the map, or read it from the cache."""
        with open_cache(sparse_map, images, cache) as kept:
            self._finder.prepare(kept, f"{self.weights_sha256} {self.config.precision}")

    @torch.inference_mode()
    def localize(self, query: Query) -> Estimate:
        """Search the place of the query."""
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        with clock.stage("place"):
            candidates = self._finder.find(query)
        if not candidates:
            return Estimate(Status.FAILED, seconds=clock.seconds, reason="no place looks like it")
        return Estimate(Status.OK, candidates[0].pose, seconds=clock.seconds, by=By.PLACE)
