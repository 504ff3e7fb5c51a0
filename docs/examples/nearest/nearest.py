"""A localizer in a package of its own: answers with the pose of the nearest map photograph."""

from pathlib import Path
from typing import Any

import numpy as np

from objconnect.scene.config import Config, load_config
from objconnect.scene.localizer import Estimate, PoseSource, Query, Status, Stopwatch
from objconnect.scene.maps.sparse_map import SparseMap


class NearestConfig(Config):
    """`--set ignore_altitude=false` changes it; unknown keys are refused."""

    ignore_altitude: bool = True


class Nearest:
    name = "nearest"
    weights_sha256 = None

    def __init__(self, config: NearestConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        self.map = sparse_map

    def localize(self, query: Query) -> Estimate:
        if query.prior is None:
            return Estimate(Status.FAILED, reason="no prior position")
        clock = Stopwatch()
        with clock.stage("search"):
            axes = 2 if self.config.ignore_altitude else 3
            away = self.map.centres[:, :axes] - query.prior.position[:axes]
            nearest = self.map.names[int(np.linalg.norm(away, axis=1).argmin())]
        pose = self.map.images[nearest].pose
        return Estimate(Status.OK, pose, seconds=clock.seconds, by=PoseSource.RETRIEVAL)


def make(overrides: dict[str, Any]) -> Nearest:
    return Nearest(load_config(NearestConfig, None, overrides))
