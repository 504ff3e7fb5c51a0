"""How well a map says how far the keypoints of its photographs are, held to the renderer's depth:

    python -m tests.baselines.measure_lifting SCENE

prints, per rule, the share of keypoints it gives a depth, the median and 90 % quantile of the
relative error, and the share below 1 %, each in percent.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.d2net.localizer import D2NetConfig, D2NetLocalizer
from baselines.lifting import interpolated_points
from scene.bundle import Scene
from scene.images import read_rgb
from scene.sparse_map import MapImage
from tests.baselines.d2net.untrained import untrained

_RADII = (1.0, 3.0, 8.0, np.inf)
# Every so many photographs of the map.
_STEP = 4


def measure(scene: Scene) -> dict[str, NDArray[np.float64]]:
    """Relative errors of depth by rule, NaN where a rule gives none."""
    sparse_map = scene.sparse_map()
    with tempfile.TemporaryDirectory() as folder:
        extract = D2NetLocalizer(D2NetConfig(weights=untrained(Path(folder))))._extractor
    frames = {name: scene.frames(name) for name in scene.sessions}
    found: dict[str, list[NDArray[np.float64]]] = {}
    for name in sparse_map.names[::_STEP]:
        session = name.split("/")[0]
        with scene.dense(session) as layers:
            depth = layers.read("depth", frames[session].names.index(name))
        xy = extract(read_rgb(scene.images_root / name)).xy
        columns, rows = np.floor(xy).astype(int).T
        truth = depth[rows, columns]
        for rule, given in depths(xy, sparse_map.images[name], sparse_map.xyz).items():
            found.setdefault(rule, []).append(np.abs(given / truth - 1)[truth > 0])
    return {rule: np.concatenate(errors) for rule, errors in found.items()}


def depths(
    xy: NDArray[np.float32], image: MapImage, xyz: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Depths (N,) of keypoints (N, 2) by rule, NaN where a rule gives none."""
    plane = image.pose.transform(torch.from_numpy(interpolated_points(xy, image, xyz)))
    seen = image.point_rows >= 0
    observed = image.pose.transform(torch.from_numpy(xyz[image.point_rows[seen]]))[:, 2].numpy()
    distance = np.linalg.norm(xy[:, None] - image.xy[seen], axis=-1)
    nearest, away = observed[distance.argmin(1)], distance.min(1)
    near = {f"nearest within {r:g} px": np.where(away <= r, nearest, np.nan) for r in _RADII}
    return {**near, "plane": plane[:, 2].numpy()}


if __name__ == "__main__":
    for rule, errors in measure(Scene.open(Path(sys.argv[1]))).items():
        given = errors[np.isfinite(errors)]
        figures = [len(given) / len(errors), *np.quantile(given, [0.5, 0.9]), np.mean(given < 0.01)]
        print(f"{rule:25}", *(f"{100 * figure:6.2f}" for figure in figures))
