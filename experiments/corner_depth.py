"""Depth errors of the corners of photographs, against the true surface of a rendered scene.

``python -m experiments.corner_depth SCENE`` (a finished scene with a map and rendered depth).
To measure another version of the code: ``PYTHONPATH=FOLDER python -P THIS_FILE SCENE``.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from benchmark.datasets.open import open_datasets
from objconnect.localization.featuremetric.corners import CornerFinder, CornerOptions
from objconnect.scene.bundle.scene import Scene


def main() -> None:
    """Print one line per photograph, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--every", type=int, default=6, help="take every n-th photograph")
    parser.add_argument("--sweep", default="{}", help="options of the sweep, as JSON")
    args = parser.parse_args()
    options = CornerOptions.model_validate_json(args.sweep)
    torch.set_num_threads(1)
    scene, (dataset,) = Scene.open(args.scene), open_datasets(args.scene)
    sparse_map = dataset.load_map()
    find = CornerFinder(sparse_map, dataset.images, 1024, options)
    names = sparse_map.names[args.every // 2 :: args.every]
    find(names[0])  # warm-up
    errors, seconds = [], []
    for name in names:
        began = time.process_time()
        found = find(name)
        seconds.append(time.process_time() - began)
        session = name.split("/")[0]
        with scene.layers(session) as layers:
            depth = layers.read("depth", list(scene.frames(session).names).index(name))
        columns, rows = found.xy.astype(int).T
        in_camera = sparse_map.images[name].pose.transform(torch.from_numpy(found.xyz))
        errors.append(np.abs(in_camera[:, 2].numpy() - depth[rows, columns]))
        print(f"{name}: {_summary(errors[-1:], seconds[-1:])}")
    print(f"all: {_summary(errors, seconds)}")


def _summary(errors: list[np.ndarray], seconds: list[float]) -> str:
    """Return a line with the number of corners with a depth, their errors and the time."""
    all_errors = np.concatenate(errors)
    return (
        f"{len(all_errors) / len(errors):.0f} corners placed, off by {np.median(all_errors):.4f} m "
        f"(median), {np.mean(all_errors < 0.5):.1%} within 0.5 m, {np.mean(seconds):.3f} s"
    )


if __name__ == "__main__":
    main()
