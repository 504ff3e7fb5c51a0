"""Training of the graph network over objects.

``python -m objconnect.network.constellation_training SCENE... --weights FILE --out FILE``

The detector finds the objects of a scene's map and of its queries. Each object of a query is
matched to the landmark, an object of the map, at its position. The graph network is trained to give
the two similar vectors, and all other landmarks different vectors. Headings and heights get errors
as large as in a search, and a random part of the objects is left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from objconnect.learning.checkpoint import write_weights
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.network.config import ConstellationConfig
from objconnect.network.constellation import ConstellationGraph
from objconnect.network.landmarks import Landmarks, ObjectLayout, lay_out, place_on_ground
from objconnect.network.network import read_network, start_from
from objconnect.network.object_map import ObjectFinder, map_ground
from objconnect.network.object_matching import describe_landmarks
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.config import Config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import looks_down
from objconnect.scene.runtime.device import AUTO, torch_device
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

# Larger images are resized to this longer side (px), as in the localizer.
LONGER_SIDE_PX: Final = 1024
MAX_LANDMARK_DISTANCE_M: Final = 1.5
"""Largest horizontal distance between an object and its landmark, metres."""
# Number of queries in a step, all of one scene.
_QUERIES: Final = 4
# Highest learning rate, and weight decay.
_RATE: Final = 2e-3
_DECAY: Final = 1e-3
# Largest share of the landmarks that a step leaves out.
_MISSING_LANDMARKS: Final = 0.25


class ConstellationTraining(Config):
    """Options of the training of the graph network: its length and the errors of queries."""

    steps: int = Field(1500, ge=1, description="Number of steps of the optimizer.")
    turn_deg: float = Field(
        6.0, ge=0, description="Standard deviation of the error of the heading, deg."
    )
    stretch: float = Field(
        0.08, ge=0, description="Standard deviation of the logarithm of the factor on the height."
    )
    moved_m: float = Field(
        0.4,
        ge=0,
        description="Standard deviation of the error of an object's position per axis, m.",
    )
    missing: float = Field(
        0.4,
        ge=0,
        lt=1,
        description="Largest share of a photograph's objects that are left out of a step.",
    )
    seed: int = Field(0, description="Seed of all random numbers.")


class TrainingQuery(NamedTuple):
    """The objects of a query, laid out at its true heading.

    Attributes:
        name: name of the photograph.
        session: session (one flight) of the photograph.
        layout: the N objects.
        height: height of the camera above the ground, metres.
        landmark: (N,) row of the landmark of each object, -1 for none.
        xyz: (N, 3) true positions of the objects, world metres.
    """

    name: str
    session: str
    layout: ObjectLayout
    height: float
    landmark: NDArray[np.int64]
    xyz: NDArray[np.float64]


class TrainingScene(NamedTuple):
    """The landmarks of a scene's map, and its queries."""

    name: str
    landmarks: Landmarks
    queries: list[TrainingQuery]


def build_training_scene(scene: Scene, finder: ObjectFinder) -> TrainingScene:
    """Find the objects of a scene's map and of its queries that look down.

    Raises:
        InputError: the scene has no map, or a photograph is broken.
    """
    sparse_map = scene.sparse_map()
    landmarks = finder.landmarks(sparse_map, scene.images_root)
    ground = map_ground(sparse_map)
    queries = []
    wanted = [(name, frames) for name, frames in scene.splits.queries.items() if frames]
    with progress_bar(f"objects of {scene.name}", sum(len(f) for _, f in wanted)) as advance:
        done = 0
        for session, names in wanted:
            frames = scene.frames(session)
            row = {name: k for k, name in enumerate(frames.names)}
            for name in names:
                done += 1
                advance(done)
                pose = Pose.from_matrix(frames.cam_from_world[row[name]])
                camera = frames.cameras[row[name]]
                if not looks_down(pose.rotation.numpy()):
                    continue
                found = finder(read_rgb(scene.images_root / name, camera), camera)
                layout = lay_out(found, camera, pose.rotation)
                if not len(layout):
                    continue
                placed = place_on_ground(found, camera, pose, ground).xyz
                xyz = placed[layout.rows]
                centre = pose.centre().numpy()
                height = float(centre[2]) - ground.height_at(centre[0], centre[1])
                landmark = _landmark_at(xyz, landmarks.xyz)
                queries.append(TrainingQuery(name, session, layout, height, landmark, xyz))
    return TrainingScene(scene.name, landmarks, queries)


def _landmark_at(xyz: NDArray[np.float64], landmarks: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the row (N,) of the landmark at each object's position; -1 for none.

    Object and landmark are mutual nearest neighbours, so that no landmark occurs twice.

    Args:
        xyz: (N, 3) positions of objects, world metres.
        landmarks: (M, 3) centres of landmarks, world metres.
    """
    if not len(landmarks):
        return np.full(len(xyz), -1)
    distance = np.linalg.norm(xyz[:, None, :2] - landmarks[None, :, :2], axis=-1)
    distance = np.where(np.isfinite(distance), distance, np.inf)
    nearest = distance.argmin(1)
    mutual = distance.argmin(0)[nearest] == np.arange(len(xyz))
    is_near = distance[np.arange(len(xyz)), nearest] < MAX_LANDMARK_DISTANCE_M
    return np.where(mutual & is_near, nearest, -1)


def describe_query(
    graph: ConstellationGraph,
    query: TrainingQuery,
    rows: NDArray[np.int64],
    errors: tuple[float, float] = (0.0, 1.0),
    position_errors: NDArray[np.float64] | None = None,
) -> Tensor:
    """Return unit vectors (n, D) of a part of the objects of a query; the rest is left out.

    Args:
        graph: the graph network.
        query: the query.
        rows: (n,) rows of the objects.
        errors: error of the heading (rad), and factor on the height.
        position_errors: (n, 2) errors of the objects' positions, metres.
    """
    layout, (turn, stretch) = query.layout, errors
    cosine, sine = np.cos(turn), np.sin(turn)
    turned = layout.offset[rows] @ np.array([[cosine, -sine], [sine, cosine]])
    height = query.height * stretch
    xy = graph.to_tensor(turned * height + (0 if position_errors is None else position_errors))
    near, exists = graph.neighbours(xy)
    vectors: Tensor = graph(
        layout.vectors[torch.from_numpy(rows)].to(xy.device),
        xy[None],
        graph.to_tensor(layout.rise[rows] * height)[None],
        graph.to_tensor(layout.side[rows] * height)[None],
        near,
        exists,
    )
    return vectors[0]


def train_graph(
    scenes: Sequence[TrainingScene],
    config: ConstellationConfig,
    options: ConstellationTraining,
    device: torch.device,
) -> ConstellationGraph:
    """Train a graph network. On one machine, equal arguments give equal weights.

    Raises:
        InputError: no query of the scenes shows a landmark.
    """
    torch.manual_seed(options.seed)
    rng = np.random.default_rng(options.seed)
    graph = ConstellationGraph(config).to(device)
    optimizer = torch.optim.AdamW(graph.parameters(), _RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, options.steps, pct_start=0.05)
    usable = [(scene, [q for q in scene.queries if (q.landmark >= 0).any()]) for scene in scenes]
    usable = [(scene, queries) for scene, queries in usable if queries]
    if not usable:
        raise InputError(
            "no query of the given scenes shows a landmark of its map: give scenes whose queries "
            "look down and overlap with the map"
        )
    with progress_bar("graph over objects", options.steps) as advance:
        for step in range(options.steps):
            scene, queries = usable[rng.integers(len(usable))]
            left_out = rng.uniform(0, _MISSING_LANDMARKS)
            kept = np.flatnonzero(rng.random(len(scene.landmarks)) >= left_out)
            # Row of each landmark among the kept ones, -1 if it is left out. The last entry is for
            # index -1, which is no landmark.
            new_row = np.full(len(scene.landmarks) + 1, -1)
            new_row[kept] = np.arange(len(kept))
            landmark_vectors = describe_landmarks(graph, scene.landmarks.select(kept))
            losses = []
            for _ in range(_QUERIES):
                query = queries[rng.integers(len(queries))]
                loss = _query_loss(graph, query, landmark_vectors, new_row, rng, options)
                if loss is not None:
                    losses.append(loss)
            if losses:
                optimizer.zero_grad()
                torch.stack(losses).mean().backward()  # type: ignore[no-untyped-call]
                torch.nn.utils.clip_grad_norm_(graph.parameters(), 1.0)
                optimizer.step()
            schedule.step()
            advance(step + 1)
    return graph.eval()


def _query_loss(
    graph: ConstellationGraph,
    query: TrainingQuery,
    landmark_vectors: Tensor,
    new_row: NDArray[np.int64],
    rng: np.random.Generator,
    options: ConstellationTraining,
) -> Tensor | None:
    """Return the cross entropy of matching objects to landmarks, and landmarks to objects.

    It is None if fewer than two objects are left that have a landmark.

    Args:
        graph: the graph network.
        query: the query.
        landmark_vectors: (M, D) unit vectors of the landmarks that are not left out.
        new_row: row in ``landmark_vectors`` of each row of the scene's landmarks; -1 for none.
        rng: source of the errors.
        options: sizes of the errors.
    """
    left_out = rng.uniform(0, options.missing)
    rows = np.flatnonzero(rng.random(len(query.landmark)) >= left_out)
    errors = (
        float(rng.normal(0, np.radians(options.turn_deg))),
        float(np.exp(rng.normal(0, options.stretch))),
    )
    position_errors = rng.normal(0, options.moved_m, (len(rows), 2))
    target = new_row[query.landmark[rows]]
    known = np.flatnonzero(target >= 0)
    if len(known) < 2:
        return None
    vectors = describe_query(graph, query, rows, errors, position_errors)
    similarity = graph.sharpness.exp() * vectors @ landmark_vectors.T
    objects, landmarks = (
        torch.from_numpy(each).to(similarity.device) for each in (known, target[known])
    )
    to_landmarks = functional.cross_entropy(similarity[objects], landmarks)
    to_objects = functional.cross_entropy(similarity.T[landmarks], objects)
    return to_landmarks + 0.5 * to_objects


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m objconnect.network.constellation_training")
    parser.add_argument("scenes", type=Path, nargs="+", help="scenes with maps")
    parser.add_argument("--weights", type=Path, required=True, help="network with a detector")
    parser.add_argument("--out", type=Path, required=True, help="file of weights to write")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default=AUTO, help="auto, cpu, cuda or cuda:NUMBER")
    args = parser.parse_args(arguments)
    try:
        device = torch_device(args.device)
        network = read_network(args.weights)[0].to(device)
        if network.detector is None:
            raise InputError(
                f"{args.weights} has no detector of objects: train one with 'objconnect train "
                "objects'"
            )
        extract = MapExtractor(network, LONGER_SIDE_PX, "float32")
        finder = ObjectFinder(extract, network.detector)
        options = ConstellationTraining(seed=args.seed)
        scenes = [build_training_scene(Scene.open(path), finder) for path in args.scenes]
        config = ConstellationConfig(vector=network.detector.config.vector)
        graph = train_graph(scenes, config, options, device)
        updated = start_from(args.weights, {"constellation": config.model_dump()})
        assert updated.constellation is not None
        updated.constellation.load_state_dict(graph.state_dict())
        write_weights(args.out, updated, updated.config.model_dump(mode="json"))
    except InputError as error:
        print(f"objconnect: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
