"""Time to prepare a method on a cluster with an empty cache.

``python -m experiments.cluster_preparation SCENE [--cluster local] [--method objconnect]``
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.run import Run, prepare_method
from benchmark.evaluation.starts import PRIOR
from objconnect.methods import create


def main() -> None:
    """Print the wall-clock seconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cluster", default="local")
    parser.add_argument("--method", default="objconnect")
    args = parser.parse_args()
    (dataset,) = open_datasets(args.scene)
    with tempfile.TemporaryDirectory() as cache:
        run = Run(dataset, create(args.method, {}), PRIOR, Path(cache), None)
        with prepare_method(run, 1, args.cluster) as (seconds, _):
            print(f"{seconds:.1f} s for {len(run.sparse_map.names)} photographs")


if __name__ == "__main__":
    main()
