"""Ablation of learned objects and of the graph over them, against segments without learning.

    python -m experiments.object_ablation TRAINING_SCENE... --report SCENE... [--seeds 3]

Objects are detections of the detector, segments of SLIC or Felzenszwalb, or squares; a segment or a
square has the mean of the detector's vectors in it. For each kind a graph over objects is trained
once per seed, and for the learned ones also a graph without messages from neighbours. Prints for
each the top-1 and top-5 share of objects that match the right landmark, and how often the true pose
(8 m, 10 degrees) is the first candidate or among the first five. Queries have no prior; tilts
of 0 to 60 degrees are tried.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from experiments.objects import finder_of, rank_of_right, ranks_of
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.network.config import ConstellationConfig, ObjConnectNetConfig
from objconnect.network.constellation_training import (
    LONGER_SIDE_PX,
    ConstellationTraining,
    TrainingScene,
    build_training_scene,
    train_graph,
)
from objconnect.network.detector import Detections, DetectorMaps
from objconnect.network.finder import allowed_poses
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.network.object_map import ObjectFinder, map_ground
from objconnect.network.object_matching import ObjectMatcher
from objconnect.network.objects import centres, occupancy
from objconnect.network.segmentation import sample_cells, segment
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.images import read_rgb

# Kinds of objects, and numbers of layers of the graph; 0 layers pass no messages.
VARIANTS = [("learned", 2), ("learned", 0), ("slic", 2), ("felzenszwalb", 2), ("grid", 2)]
# The number of segments is the maximum number of the detector's objects.
SEGMENTS = {"segments": 256, "segment_side": 24.0}


class SegmentFinder(ObjectFinder):
    """Segments of one kind, with the detector's vectors."""

    def __init__(self, network: ObjConnectNet, kind: str) -> None:
        assert network.detector is not None
        extract = MapExtractor(network, LONGER_SIDE_PX, "float32")
        super().__init__(extract, network.detector)
        self._stride = network.detector.config.stride
        self._config = ObjConnectNetConfig.model_validate({"segmentation": kind, **SEGMENTS})

    def detect(self, picture: NDArray[np.uint8], maps: DetectorMaps) -> Detections:
        """See ``ObjectFinder``."""
        image = torch.from_numpy(picture.astype(np.float32)).permute(2, 0, 1)[None] / 255
        labels = sample_cells(segment(image, self._config), image, maps.centre, self._stride)
        objects = occupancy(labels, self._config.segments)
        present = objects.present[0]
        rows = maps.vector.permute(0, 2, 3, 1).flatten(1, 2)
        side = objects.area[0, present].sqrt() * self._stride
        return Detections(
            centres(objects)[0, present] * self._stride,
            torch.ones_like(side),
            side,
            torch.zeros_like(side),
            torch.nn.functional.normalize(objects.mean(rows)[0, present], dim=1),
        )


def main() -> None:
    """Run the ablation and print a line for each variant and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--report", type=Path, nargs="+", required=True)
    parser.add_argument("--weights", type=Path, default=SHIPPED)
    parser.add_argument("--session", default="nadir", help="session of the queries")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", default=["learned", "slic", "felzenszwalb", "grid"])
    args = parser.parse_args()
    network, _ = read_network(args.weights)
    for kind in args.kinds:
        finder = finder_of(network) if kind == "learned" else SegmentFinder(network, kind)
        training_scenes = [build_training_scene(Scene.open(path), finder) for path in args.scenes]
        scenes = [Scene.open(path) for path in args.report]
        tested = [build_training_scene(scene, finder) for scene in scenes]
        for layers in (each for name, each in VARIANTS if name == kind):
            for seed in range(args.seeds):
                assert network.detector is not None
                config = ConstellationConfig(vector=network.detector.config.vector, layers=layers)
                graph = train_graph(
                    training_scenes, config, ConstellationTraining(seed=seed), torch.device("cpu")
                ).eval()
                ranks = np.concatenate([ranks_of(graph, each, args.session) for each in tested])
                starts = [
                    rank
                    for scene, each in zip(scenes, tested, strict=True)
                    for rank in _rank_starts(finder, graph, scene, each, args.session)
                ]
                total, start_ranks = ranks[:, 0].sum(), np.array(starts)
                print(
                    f"{kind}, {layers} layers, seed {seed}: top-1 {ranks[:, 1].sum() / total:.3f}, "
                    f"top-5 {ranks[:, 2].sum() / total:.3f} of {total} objects; start first "
                    f"{(start_ranks == 0).sum()}, among five "
                    f"{(start_ranks < 5).sum()} of {len(start_ranks)}",
                    flush=True,
                )


def _rank_starts(
    finder: ObjectFinder,
    graph: torch.nn.Module,
    scene: Scene,
    tested: TrainingScene,
    session: str,
) -> Sequence[int]:
    """Return the rank of the first correct candidate of each query, 99 for none."""
    sparse_map = scene.sparse_map()
    connect = ObjectMatcher(graph, tested.landmarks, map_ground(sparse_map))  # type: ignore[arg-type]
    heights = [sparse_map.height_above(centre) for centre in sparse_map.centres]
    frames, ranks = scene.frames(session), []
    for row, name in enumerate(frames.names):
        camera, true = frames.cameras[row], Pose.from_matrix(frames.cam_from_world[row])
        found = finder(read_rgb(scene.images_root / name), camera)
        candidates = connect(found, camera, *allowed_poses(None, heights))
        ranks.append(rank_of_right(candidates, true))
    return ranks


if __name__ == "__main__":
    main()
