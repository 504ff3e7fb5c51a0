"""How far corners of photographs stand from the true surface of a rendered scene.

``python -m tests.benchmarks.corner_depth SCENE`` (a finished scene with a map and rendered depth).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import torch

from baselines.featuremetric.corners import CornerFinder
from benchmark.datasets.open import open_datasets
from scene.bundle.scene import Scene

_PHOTOGRAPHS = slice(8, 11)
_MOST = 2500


def main(path: Path) -> None:
    """Print one line per photograph."""
    scene, (dataset,) = Scene.open(path), open_datasets(path)
    sparse_map = dataset.load_map()
    find = CornerFinder(sparse_map, dataset.images, _MOST, 1024)
    for name in sparse_map.names[_PHOTOGRAPHS]:
        began = time.process_time()
        found = find(name)
        seconds = time.process_time() - began
        image = sparse_map.images[name]
        session = name.split("/")[0]
        with scene.dense(session) as layers:
            depth = layers.read("depth", list(scene.frames(session).names).index(name))
        columns, rows = found.xy.astype(int).T
        z = image.pose.transform(torch.from_numpy(found.xyz))[:, 2].numpy()
        off = np.abs(z - depth[rows, columns])
        print(
            f"{name}: {len(off)} of {_MOST} corners placed, "
            f"off by {np.median(off):.3f} m (median), {np.mean(off < 0.5):.0%} within 0.5 m, "
            f"{seconds:.1f} s"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
