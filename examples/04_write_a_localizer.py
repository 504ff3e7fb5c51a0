"""Write a localizer and score it: it answers with the pose of the nearest map photograph.

python examples/04_write_a_localizer.py [SCENE] [RESULTS]    (after 01_map.py)
"""

from pathlib import Path

import numpy as np

import benchmark
import objconnect as oc


class NearestConfig(oc.Config):
    """Everything that changes the results; it is written into them."""

    ignore_altitude: bool = True


class Nearest:
    name = "nearest"  # name of its results file
    weights_sha256 = None  # no weights

    def __init__(self, config: NearestConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: oc.SparseMap, images: Path, cache: Path | None = None) -> None:
        self.map = sparse_map  # called once, before the queries

    def localize(self, query: oc.Query) -> oc.Estimate:
        if query.prior is None:
            return oc.Estimate(oc.Status.FAILED, reason="no prior position")
        clock = oc.Stopwatch()
        with clock.stage("search"):
            axes = 2 if self.config.ignore_altitude else 3
            offsets = self.map.centres[:, :axes] - query.prior.position[:axes]
            nearest = self.map.names[int(np.linalg.norm(offsets, axis=1).argmin())]
        pose = self.map.images[nearest].pose
        return oc.Estimate(oc.Status.OK, pose, seconds=clock.seconds, by=oc.PoseSource.RETRIEVAL)


def main(
    path: Path = Path("runs/examples/scene"), out: Path = Path("runs/examples/results")
) -> None:
    (dataset,) = benchmark.open_datasets(path)
    results = benchmark.evaluate(dataset, Nearest(NearestConfig()), out)
    for threshold, recall in results.summary.recall.items():
        # None means that the reference poses are too inexact to judge the threshold.
        print(f"{threshold}: {'–' if recall is None else recall.text()} %")


if __name__ == "__main__":
    oc.run_script(main)
