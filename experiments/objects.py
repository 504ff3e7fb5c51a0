"""Repeatability and matching of learned objects, between a summer map and a scene's queries.

    python -m experiments.objects segments SCENE... [--weights FILE]
    python -m experiments.objects matching TRAINING_SCENE... --report SCENE... [--seeds 3]
    python -m experiments.objects starts SCENE... [--weights FILE]

``segments``: repeatability of segments between a query and the map photograph that sees most of its
ground: the mean intersection over union with the best segment there, for learned segments, SLIC,
Felzenszwalb, squares and the true objects; and the share of objects found in both, by size class.
``matching``: graphs with and without neighbours are trained on some scenes and match objects to
landmarks on others. ``starts``: whether the true pose (8 m, 10 degrees) is the first candidate,
or among the first five. Queries have no prior; tilts of 0 to 60 degrees are tried.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.learning.training.instances import LINE_CLASSES, MAX_SIDE_M
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.network.config import ConstellationConfig, ObjConnectNetConfig
from objconnect.network.constellation_training import (
    LONGER_SIDE_PX,
    ConstellationTraining,
    TrainingScene,
    build_training_scene,
    describe_query,
    train_graph,
)
from objconnect.network.finder import allowed_poses
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.network.object_map import ObjectFinder, map_ground
from objconnect.network.object_matching import ObjectMatcher, describe_landmarks
from objconnect.network.segmentation import sample_pixels, segment
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.images import read_rgb

# Maximum relative difference of the depths of one point in two photographs.
SAME_DEPTH = 0.02
# An object is found if a detection lies within half its side, or within this many pixels, of its
# centre.
NEAR_PX = 4.0
# Maximum horizontal distance of a matched landmark from the object.
FOUND_M = 2.0


def main() -> None:
    """Run one of the measurements, and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("segments", "matching", "starts"))
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--report", type=Path, nargs="+", default=[])
    parser.add_argument("--weights", type=Path, default=SHIPPED)
    parser.add_argument("--session", default="nadir", help="session of the queries")
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    network, _ = read_network(args.weights)
    scenes = [Scene.open(path) for path in args.scenes]
    if args.what == "segments":
        measure_segments(network, scenes, args.session)
    elif args.what == "matching":
        report = [Scene.open(path) for path in args.report]
        measure_matching(network, scenes, report, args.session, args.seeds)
    else:
        measure_starts(network, scenes, args.session)


def finder_of(network: ObjConnectNet) -> ObjectFinder:
    """Return the object finder of a network."""
    assert network.detector is not None, "these weights have no detector"
    extract = MapExtractor(network, LONGER_SIDE_PX, "float32")
    return ObjectFinder(extract, network.detector)


# ---- segments


def measure_segments(network: ObjConnectNet, scenes: Sequence[Scene], session: str) -> None:
    """Print the overlap of segments, and the share of objects found in both seasons."""
    kinds: dict[str, list[float]] = {}
    sizes: dict[str, list[bool]] = {}
    for scene in scenes:
        names = scene.splits.queries[session]
        overlap = scene.covisibility.select([*names, *scene.splits.map]).mutual
        for row, query in enumerate(names):
            column = int(overlap[row, len(names) :].argmax())
            pair = (scene.splits.map[column], query)
            labels = {kind: [find(network, scene, name) for name in pair] for kind, find in KINDS}
            a, b, shape = common_pixels(scene, *pair)
            for kind, (first, second) in labels.items():
                image = torch.zeros(1, 3, *shape)
                in_a = sample_pixels(first[None], image, a[None])[0].numpy()
                in_b = sample_pixels(second[None], image, b[None])[0].numpy()
                kinds.setdefault(kind, []).extend(best_overlaps(in_a, in_b).tolist())
            for size, found in find_in_both(network, scene, *pair):
                sizes.setdefault(size, []).append(found)
    for kind, values in kinds.items():
        print(f"{kind}: mean IoU {np.mean(values):.3f} of {len(values)} segments")
    for size, found_of in sizes.items():
        print(f"{size}: {np.mean(found_of):.3f} of {len(found_of)} objects found in both")


def best_overlaps(
    in_a: NDArray[np.int64], in_b: NDArray[np.int64], least: int = 12
) -> NDArray[np.float64]:
    """Return, for each segment of image a, its intersection over union with the best one of b.

    Args:
        in_a: (P,) segment of each common pixel in image a, negative for none.
        in_b: (P,) the same in image b. Pixels in a segment of a but in none of b count as missed.
        least: segments with fewer common pixels are left out.
    """
    names_a, a = np.unique(np.where(in_a < 0, -1, in_a), return_inverse=True)
    names_b, b = np.unique(np.where(in_b < 0, -1, in_b), return_inverse=True)
    shared = np.zeros((len(names_a), len(names_b)))
    np.add.at(shared, (a, b), 1)
    union = shared.sum(1, keepdims=True) + shared.sum(0) - shared
    overlap = np.where(names_b[None] >= 0, shared / union, 0.0)
    is_counted = (names_a >= 0) & (shared.sum(1) >= least)
    return np.asarray(overlap.max(1)[is_counted])


def _frame(scene: Scene, name: str) -> tuple[str, int]:
    """Return the session and the row of a photograph."""
    session = name.split("/")[0]
    return session, scene.frames(session).names.index(name)


def common_pixels(scene: Scene, one: str, other: str) -> tuple[Tensor, Tensor, tuple[int, int]]:
    """Return pixels (P, 2) of a frame and those of another that show the same points."""
    (session_a, row_a), (session_b, row_b) = _frame(scene, one), _frame(scene, other)
    frames_a, frames_b = scene.frames(session_a), scene.frames(session_b)
    with scene.layers(session_a) as layers:
        depth_a = layers.read("depth", row_a)
    with scene.layers(session_b) as layers:
        depth_b = layers.read("depth", row_b)
    camera = frames_a.cameras[row_a]
    y, x = np.mgrid[0 : camera.height : 2, 0 : camera.width : 2]
    xy = torch.from_numpy(np.stack([x.ravel(), y.ravel()], -1) + 0.5)
    rays, _ = camera.unproject(xy)
    rays = rays.double() / rays[:, 2:]
    points = rays * torch.from_numpy(depth_a[y.ravel(), x.ravel()].astype(np.float64))[:, None]
    b_from_a = frames_b.cam_from_world[row_b] @ np.linalg.inv(frames_a.cam_from_world[row_a])
    in_b = Pose.from_matrix(b_from_a).transform(points)
    camera_b = frames_b.cameras[row_b]
    projected = camera_b.project(in_b)
    visible = projected.valid & camera_b.contains(projected.xy)
    column, row = projected.xy[visible].long().T
    seen = torch.from_numpy(depth_b)[row, column]
    same = (seen - in_b[visible, 2]).abs() < SAME_DEPTH * in_b[visible, 2]
    return xy[visible][same], projected.xy[visible][same], (camera.height, camera.width)


def segment_learned(network: ObjConnectNet, scene: Scene, name: str) -> Tensor:
    """Return the label map of the detector."""
    with torch.inference_mode():
        return network.predict_segments(_picture(scene, name))[0]


def true_objects(network: ObjConnectNet, scene: Scene, name: str) -> Tensor:
    """Return the true label map."""
    session, row = _frame(scene, name)
    with scene.layers(session) as layers:
        ids = layers.read("instance", row).astype(np.int64)
    centred = [item.id for item in scene.objects.objects if _has_centre(item.class_name, item.size)]
    number = np.full(int(max(ids.max(), *centred)) + 1, -1)
    number[centred] = np.arange(len(centred))
    return torch.from_numpy(number[ids])


def _has_centre(class_name: str, size: tuple[float, float, float]) -> bool:
    return class_name not in LINE_CLASSES and max(size[:2]) <= MAX_SIDE_M


def _classical_segmenter(kind: str) -> Callable[[ObjConnectNet, Scene, str], Tensor]:
    def find(network: ObjConnectNet, scene: Scene, name: str) -> Tensor:
        config = ObjConnectNetConfig(segmentation=kind)
        return segment(_picture(scene, name), config)[0]

    return find


KINDS = [
    ("learned", segment_learned),
    ("slic", _classical_segmenter("slic")),
    ("felzenszwalb", _classical_segmenter("felzenszwalb")),
    ("squares", _classical_segmenter("grid")),
    ("true objects", true_objects),
]


def _picture(scene: Scene, name: str) -> Tensor:
    rgb = read_rgb(scene.images_root / name)
    return torch.from_numpy(rgb.astype(np.float32)).permute(2, 0, 1)[None] / 255


def find_in_both(
    network: ObjConnectNet, scene: Scene, one: str, other: str
) -> list[tuple[str, bool]]:
    """Return the size class of each object in both frames, and whether it is found in both."""
    by_id = {item.id: item for item in scene.objects.objects}
    finder, found_by_frame = finder_of(network), []
    for name in (one, other):
        session, row = _frame(scene, name)
        frames = scene.frames(session)
        with scene.layers(session) as layers:
            ids, count = np.unique(layers.read("instance", row), return_counts=True)
        camera, pose = frames.cameras[row], Pose.from_matrix(frames.cam_from_world[row])
        found = finder(read_rgb(scene.images_root / name), camera).xy.numpy()
        is_found = {}
        for number in ids[count >= 12].tolist():
            item = by_id.get(number)
            if item is None or not _has_centre(item.class_name, item.size):
                continue
            middle = pose.transform(torch.tensor([item.centre], dtype=torch.float64))
            xy = camera.project(middle)
            if bool(xy.valid) and bool(camera.contains(xy.xy)):
                side = max(item.size[:2]) * float(np.mean(camera.focal)) / float(middle[0, 2])
                distance_px = np.linalg.norm(found - xy.xy.numpy(), axis=1).min(initial=np.inf)
                is_found[number] = bool(distance_px <= max(NEAR_PX, side / 2))
        found_by_frame.append(is_found)
    in_both = sorted(set(found_by_frame[0]) & set(found_by_frame[1]))
    return [(by_id[n].size_class, found_by_frame[0][n] and found_by_frame[1][n]) for n in in_both]


# ---- matching


def build_scenes(network: ObjConnectNet, scenes: Sequence[Scene]) -> list[TrainingScene]:
    """Find the objects of scenes, for training or for tests."""
    finder = finder_of(network)
    return [build_training_scene(scene, finder) for scene in scenes]


def measure_matching(
    network: ObjConnectNet,
    scenes: Sequence[Scene],
    report: Sequence[Scene],
    session: str,
    seeds: int,
) -> None:
    """Print top-1 and top-5 shares with and without neighbours, and their paired p, by seed."""
    assert network.detector is not None
    training_scenes, tested = build_scenes(network, scenes), build_scenes(network, report)
    for seed in range(seeds):
        ranks_by_layers = {}
        for layers in (0, 2):
            config = ConstellationConfig(vector=network.detector.config.vector, layers=layers)
            graph = train_graph(
                training_scenes, config, ConstellationTraining(seed=seed), torch.device("cpu")
            )
            ranks = np.concatenate([ranks_of(graph, each, session) for each in tested])
            ranks_by_layers[layers] = ranks
        without_neighbours, with_neighbours = ranks_by_layers[0], ranks_by_layers[2]
        for layers, ranks in ranks_by_layers.items():
            total = ranks[:, 0].sum()
            print(
                f"seed {seed}, {layers} layers: top-1 {ranks[:, 1].sum() / total:.3f}, "
                f"top-5 {ranks[:, 2].sum() / total:.3f} of {total} objects, {len(ranks)} queries"
            )
        print(
            f"seed {seed}: p = {paired_p(with_neighbours[:, 1] - without_neighbours[:, 1]):.2g} "
            "over queries"
        )


def ranks_of(graph: torch.nn.Module, scene: TrainingScene, session: str) -> NDArray[np.int64]:
    """Return for each query its number of known objects, and how many match at top-1 and top-5."""
    rows = []
    with torch.inference_mode():
        landmark_vectors = describe_landmarks(graph, scene.landmarks)  # type: ignore[arg-type]
        for query in scene.queries:
            known = query.landmark >= 0
            if query.session != session or not known.any():
                continue
            query_vectors = describe_query(graph, query, np.arange(len(query.layout)))  # type: ignore[arg-type]
            best = (query_vectors @ landmark_vectors.T).topk(5, 1).indices.numpy()
            offsets = scene.landmarks.xyz[best][..., :2] - query.xyz[:, None, :2]
            hit = (np.linalg.norm(offsets, axis=-1) < FOUND_M)[known]
            rows.append((known.sum(), hit[:, 0].sum(), hit.any(1).sum()))
    return np.array(rows, np.int64).reshape(-1, 3)


def paired_p(differences: NDArray[np.int64], rounds: int = 20_000) -> float:
    """Return the one-sided p value of a paired permutation test that the mean is above zero."""
    rng = np.random.default_rng(0)
    signs = rng.choice([-1, 1], (rounds, len(differences)))
    return float(((signs * differences).mean(1) >= differences.mean()).sum() + 1) / (rounds + 1)


# ---- starts


def measure_starts(network: ObjConnectNet, scenes: Sequence[Scene], session: str) -> None:
    """Print how often objects alone find the true pose, the time, and the size of the map."""
    assert network.constellation is not None, "these weights have no graph over objects"
    finder = finder_of(network)
    ranks: list[int] = []
    seconds: list[float] = []
    for scene in scenes:
        sparse_map = scene.sparse_map()
        landmarks = finder.landmarks(sparse_map, scene.images_root)
        ground = map_ground(sparse_map)
        connect = ObjectMatcher(network.constellation, landmarks, ground)
        heights = [sparse_map.height_above(c) for c in sparse_map.centres]
        rows, columns = ground.shape
        megabytes = landmarks_bytes(landmarks) / 1e6
        area = rows * columns * ground.cell**2 / 1e6
        frames = scene.frames(session)
        ranks_in_scene = []
        for row, name in enumerate(frames.names):
            began = time.perf_counter()
            rgb, camera = read_rgb(scene.images_root / name), frames.cameras[row]
            found = connect(finder(rgb, camera), camera, *allowed_poses(None, heights))
            seconds.append(time.perf_counter() - began)
            true = Pose.from_matrix(frames.cam_from_world[row])
            ranks_in_scene.append(rank_of_right(found, true))
        ranks += ranks_in_scene
        print(
            f"{scene.name}: first {np.mean(np.array(ranks_in_scene) == 0):.3f}, among five "
            f"{np.mean(np.array(ranks_in_scene) < 5):.3f}; {len(landmarks)} landmarks, "
            f"{megabytes / area:.2f} MB per square km",
            flush=True,
        )
    all_ranks = np.array(ranks)
    print(
        f"all: {(all_ranks == 0).sum()} first and {(all_ranks < 5).sum()} among five of "
        f"{len(ranks)}; {np.median(seconds):.2f} s a query (median)"
    )


def landmarks_bytes(landmarks: object) -> int:
    """Return the bytes of landmarks in a file."""
    arrays = [value for value in vars(landmarks).values() if isinstance(value, np.ndarray)]
    return sum(a.nbytes // 2 if a.dtype == np.float32 else a.nbytes for a in arrays)


def rank_of_right(candidates: Sequence[Candidate], true: Pose) -> int:
    """Return the rank of the first correct candidate, from 0 on; 99 for none."""
    right = [is_right(candidate.pose, true) for candidate in candidates]
    return right.index(True) if True in right else 99


def is_right(pose: Pose, true: Pose) -> bool:
    """Return whether a candidate is within 8 m, 10 degrees of the truth."""
    distance_m = float(torch.linalg.norm(pose.centre() - true.centre()))
    trace = float((pose.rotation @ true.rotation.T).trace())
    return distance_m < 8 and np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))) < 10


if __name__ == "__main__":
    main()
