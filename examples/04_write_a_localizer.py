"""Write a localizer and score it: it answers with the pose of the nearest map photograph.

python examples/04_write_a_localizer.py [SCENE] [RESULTS]    (after 01_map.py)
"""

from pathlib import Path

import numpy as np

from benchmark.api import Estimate, Query, SparseMap, evaluate, open_datasets, run_script
from objconnect.scene.config import Config
from objconnect.scene.localizer import By, Status, Stopwatch


class NearestConfig(Config):
    """Everything that changes the results; it is written into them."""

    ignore_altitude: bool = True


class Nearest:
    name = "nearest"  # of its results file
    weights_sha256 = None  # no weights

    def __init__(self, config: NearestConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        self.map = sparse_map  # called once, before the queries

    def localize(self, query: Query) -> Estimate:
        if query.prior is None:
            return Estimate(Status.FAILED, reason="no prior position")
        clock = Stopwatch()
        with clock.stage("search"):
            axes = 2 if self.config.ignore_altitude else 3
            away = self.map.centres[:, :axes] - query.prior.position[:axes]
            nearest = self.map.names[int(np.linalg.norm(away, axis=1).argmin())]
        pose = self.map.images[nearest].pose
        return Estimate(Status.OK, pose, seconds=clock.seconds, by=By.RETRIEVAL)


def main(
    path: Path = Path("runs/examples/scene"), out: Path = Path("runs/examples/results")
) -> None:
    (dataset,) = open_datasets(path)
    results = evaluate(dataset, Nearest(NearestConfig()), out)
    for threshold, recall in results.summary.recall.items():
        print(f"{threshold}: {100 * recall.value:.0f} % [{recall.low:.2f}, {recall.high:.2f}]")


if __name__ == "__main__":
    run_script(main)
