"""Depth errors of lifted keypoints against the rendered depth.

    python -m experiments.lifted_depth SCENE

Every fourth photograph of the map is measured. Errors are along the optical axis, at the keypoints
with a 3D point.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.binary import Akaze, Orb
from objconnect.localization.matching.features import Extractor
from objconnect.localization.matching.lifting import find_observations, interpolate_points
from objconnect.scene.bundle.frames import dense_layers, read_frames
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.images import read_rgb

Lift = Callable[[NDArray[np.float32], MapImage, NDArray[np.float64]], NDArray[np.float64]]
# Every n-th photograph of the map is taken.
EVERY = 4


def nearest(
    xy: NDArray[np.float32], image: MapImage, xyz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the points of the observations at the keypoints."""
    rows = find_observations(xy, image)
    return np.where((rows >= 0)[:, None], xyz[rows], np.nan)


def depths(scene: Path, sparse_map: SparseMap) -> Mapping[str, NDArray[np.float32]]:
    """Return the rendered depth (H, W) of photographs of the map by name."""
    wanted = set(sparse_map.names[::EVERY])
    found = {}
    for session in Scene.open(scene).manifest.sessions:
        path = scene / "sessions" / session / "frames.h5"
        with dense_layers(path) as layers:
            for row, name in enumerate(read_frames(path).names):
                if name in wanted:
                    found[name] = layers.read("depth", row)
    return found


def measure(scene: Path, extract: Extractor, lift: Lift) -> tuple[float, NDArray[np.float64]]:
    """Return the share of keypoints with a point (%), and the errors of their depths (m)."""
    sparse_map = read_model(scene / "map")
    errors, keypoints = [], 0
    for name, depth in depths(scene, sparse_map).items():
        image = sparse_map.images[name]
        xy = extract(read_rgb(scene / "sessions" / name)).xy
        points = lift(xy, image, sparse_map.xyz)
        has_point = np.isfinite(points).all(1)
        row, column = np.floor(xy[has_point, ::-1]).astype(int).T
        truth = depth[row.clip(max=depth.shape[0] - 1), column.clip(max=depth.shape[1] - 1)]
        point_depth = image.pose.transform(torch.from_numpy(points[has_point]))[:, 2].numpy()
        errors.append(np.where(truth > 0, np.abs(point_depth - truth), np.inf))
        keypoints += len(xy)
    stacked = np.concatenate(errors)
    return 100 * len(stacked) / keypoints, stacked


if __name__ == "__main__":
    for extractor in (Orb(8192), Akaze(8192, 0.001)):
        for how in (nearest, interpolate_points):
            share, errors = measure(Path(sys.argv[1]), extractor, how)
            median, p90 = np.quantile(errors, [0.5, 0.9])
            figures = f"lifted {share:.1f} %, off {median:.2f} m (median), {p90:.2f} m (90 %)"
            print(f"{extractor.name} {how.__name__}: {figures}")
