"""Draw the learned objects of a map photograph and of a query, and which of them match.

    python -m experiments.object_figure SCENE SESSION OUT.jpg [ROW]

The query is number ROW of a session whose camera looks down. It has no prior, and its pose is found
from its objects alone. Objects on the same landmark of the map have the same colour in both
pictures; white outlines have no landmark. The map photograph is the one that sees most of the same
ground.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from objconnect.localization.cache.map_cache import open_cache
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.network.constellation_training import LONGER_SIDE_PX
from objconnect.network.finder import allowed_poses
from objconnect.network.landmarks import merge, place_on_ground
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.network.object_map import ObjectFinder, map_ground
from objconnect.network.object_matching import ObjectMatcher
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.images import read_rgb

# Maximum horizontal distance of an object from the landmark on which it lies.
SAME_M = 3.0


@torch.inference_mode()
def main(path: Path, session: str, out: Path, row: int = 0) -> None:
    """Draw the picture."""
    network, _ = read_network(SHIPPED)
    assert network.detector is not None and network.constellation is not None
    extract = MapExtractor(network, LONGER_SIDE_PX, "float32")
    finder = ObjectFinder(extract, network.detector)
    scene = Scene.open(path)
    sparse_map, frames = scene.sparse_map(), scene.frames(session)
    ground = map_ground(sparse_map)
    with open_cache(sparse_map, scene.images_root, None) as map_cache:
        landmarks, tracks = merge(finder.views(map_cache))
    name, camera = frames.names[row], frames.cameras[row]
    rgb = read_rgb(scene.images_root / name)
    found = finder(rgb, camera)
    heights = [sparse_map.height_above(centre) for centre in sparse_map.centres]
    connect = ObjectMatcher(network.constellation, landmarks, ground)
    candidate = connect(found, camera, *allowed_poses(None, heights))[0]
    true = Pose.from_matrix(frames.cam_from_world[row])
    error_m = float(torch.linalg.norm(candidate.pose.centre() - true.centre()))
    ground_xyz = place_on_ground(found, camera, candidate.pose, ground).xyz
    distance = np.linalg.norm(ground_xyz[:, None, :2] - landmarks.xyz[None, :, :2], axis=-1)
    distance = np.where(np.isfinite(distance), distance, np.inf)
    nearest = distance.argmin(1)
    mutual = distance.argmin(0)[nearest] == np.arange(len(distance))
    same = np.where(mutual & (distance.min(1) < SAME_M), nearest, -1)

    overlap = scene.covisibility.select([name, *scene.splits.map]).mutual[0, 1:]
    map_name = scene.splits.map[int(overlap.argmax())]
    is_in_photograph = np.array([each == map_name for each in tracks.name])
    figure = Figure(figsize=(14, 7), dpi=80, layout="constrained")
    left, right = figure.subplots(1, 2)
    map_rgb = read_rgb(scene.images_root / map_name)
    shared = set(same.tolist()) & set(tracks.landmark[is_in_photograph].tolist())
    _draw(
        left,
        network,
        map_rgb,
        tracks.xy[is_in_photograph],
        tracks.landmark[is_in_photograph],
        shared,
    )
    _draw(right, network, rgb, found.xy.numpy(), same, shared)
    left.set_title(f"a photograph of the map, {scene.sessions[map_name.split('/')[0]].condition}")
    right.set_title(
        f"a query, {scene.sessions[session].condition}, placed by its objects "
        f"{error_m:.1f} m from the truth:\n"
        f"{(same >= 0).sum()} of its {len(same)} objects lie on landmarks of the map"
    )
    figure.canvas.draw()  # type: ignore[no-untyped-call]
    figure.savefig(out.with_suffix(".png"))
    Image.open(out.with_suffix(".png")).convert("RGB").save(out, quality=88)
    out.with_suffix(".png").unlink()


def _draw(
    axis: Axes,
    network: ObjConnectNet,
    rgb: NDArray[np.uint8],
    xy: NDArray[np.float64],
    landmark: NDArray[np.int64],
    shared: set[int],
) -> None:
    """Draw outlines of learned objects, and centres coloured by their landmark."""
    image = torch.from_numpy(rgb.astype(np.float32) / 255).permute(2, 0, 1)[None]
    labels = network.predict_segments(image)[0].numpy()
    axis.imshow(rgb)
    height, width = rgb.shape[:2]
    rows, columns = (np.linspace(0, n, k) for n, k in zip(rgb.shape, labels.shape, strict=False))
    for label in range(int(labels.max()) + 1):
        axis.contour(columns, rows, labels == label, levels=[0.5], colors="white", linewidths=0.8)
    for position, number in zip(xy, landmark.tolist(), strict=True):
        if number in shared:
            colour = colormaps["hsv"]((number * 0.618034) % 1)
            axis.plot(*position, "o", markersize=9, markerfacecolor="none", markeredgecolor=colour,
                      markeredgewidth=2.5)  # fmt: skip
    axis.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), *map(int, sys.argv[4:]))
