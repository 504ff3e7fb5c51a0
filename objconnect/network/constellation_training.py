"""Train the graph over objects.

``python -m objconnect.network.constellation_training SCENE...``

The detector finds the objects of a scene's map and of its queries. An object of a query at the
position of a landmark is that landmark. The graph is trained to describe the two alike and all
other landmarks differently. Headings and heights get errors as large as those of a search, and some
objects are left out.
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
from objconnect.network.landmarks import Landmarks, place_on_ground
from objconnect.network.network import read_network, start_from
from objconnect.network.object_map import ObjectFinder, map_ground
from objconnect.network.object_matching import ObjectLayout, describe_landmarks, lay_out
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.config import Config
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import looks_down
from objconnect.scene.runtime.device import AUTO, torch_device
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.images import read_rgb

# Longer side (px) of resized images, as for queries.
LONGEST: Final = 1024
SAME_M: Final = 1.5
"""Largest distance between an object and its landmark, metres."""
# Number of photographs in a step, all of one scene; highest learning rate and weight decay.
_QUERIES: Final = 4
_RATE: Final = 2e-3
_DECAY: Final = 1e-3
# Largest share of the landmarks that are left out of a step.
_MISSING_LANDMARKS: Final = 0.25


class ConstellationTraining(Config):
    """Options of the training of the graph: its length and the errors of queries."""

    steps: int = Field(1500, ge=1, description="Number of steps of the optimizer.")
    turn_deg: float = Field(
        6.0, ge=0, description="Standard deviation of the error of the heading, deg."
    )
    stretch: float = Field(
        0.08, ge=0, description="Standard deviation of the logarithm of the error of the height."
    )
    moved_m: float = Field(0.4, ge=0, description="Standard deviation of the error of a centre, m.")
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
        height: height of the camera above the ground, metres.
        landmark: (N,) row of the landmark of each object, -1 for none.
        xyz: (N, 3) true positions of the objects, world metres.
    """

    name: str
    session: str
    laid: ObjectLayout
    height: float
    landmark: NDArray[np.int64]
    xyz: NDArray[np.float64]


class TrainingScene(NamedTuple):
    """The landmarks of a scene's map, and its queries."""

    name: str
    landmarks: Landmarks
    queries: list[TrainingQuery]


def build_training_scene(scene: Scene, finder: ObjectFinder) -> TrainingScene:
    """Find the objects of a scene's map and of those of its queries that look down.

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
                laid = lay_out(found, camera, pose.rotation)
                if not len(laid):
                    continue
                placed = place_on_ground(found, camera, pose, ground).xyz
                xyz = placed[laid.rows]
                centre = pose.centre().numpy()
                height = float(centre[2]) - ground.height_at(centre[0], centre[1])
                same = _same(xyz, landmarks.xyz)
                queries.append(TrainingQuery(name, session, laid, height, same, xyz))
    return TrainingScene(scene.name, landmarks, queries)


def _same(xyz: NDArray[np.float64], landmarks: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the row of the landmark at each object's position, -1 for none, each row once."""
    if not len(landmarks):
        return np.full(len(xyz), -1)
    away = np.linalg.norm(xyz[:, None, :2] - landmarks[None, :, :2], axis=-1)
    away = np.where(np.isfinite(away), away, np.inf)
    nearest = away.argmin(1)
    mutual = away.argmin(0)[nearest] == np.arange(len(xyz))
    return np.where(mutual & (away[np.arange(len(xyz)), nearest] < SAME_M), nearest, -1)


def describe_query(
    graph: ConstellationGraph,
    query: TrainingQuery,
    rows: NDArray[np.int64],
    wrong: tuple[float, float] = (0.0, 1.0),
    moved: NDArray[np.float64] | None = None,
) -> Tensor:
    """Return unit vectors (n, D) of some objects of a query among themselves.

    Args:
        graph: the graph.
        query: the query.
        rows: (n,) rows of the objects.
        wrong: error of the heading (rad), and factor on the height.
        moved: (n, 2) errors of the objects' positions, metres.
    """
    laid, (turn, stretch) = query.laid, wrong
    cosine, sine = np.cos(turn), np.sin(turn)
    turned = laid.offset[rows] @ np.array([[cosine, -sine], [sine, cosine]])
    height = query.height * stretch
    where = turned * height + (0 if moved is None else moved)
    place = graph.to_tensor(where)
    near, there = graph.neighbours(place)
    described: Tensor = graph(
        laid.vectors[torch.from_numpy(rows)].to(place.device),
        place[None],
        graph.to_tensor(laid.rise[rows] * height)[None],
        graph.to_tensor(laid.side[rows] * height)[None],
        near,
        there,
    )
    return described[0]


def train_graph(
    lessons: Sequence[TrainingScene],
    config: ConstellationConfig,
    options: ConstellationTraining,
    device: torch.device,
) -> ConstellationGraph:
    """Train a graph on scenes, on a device. Equal arguments give equal graphs on one machine.

    Raises:
        InputError: no query of the scenes shows a landmark.
    """
    torch.manual_seed(options.seed)
    rng = np.random.default_rng(options.seed)
    graph = ConstellationGraph(config).to(device)
    optimizer = torch.optim.AdamW(graph.parameters(), _RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, options.steps, pct_start=0.05)
    usable = [(of, [q for q in of.queries if (q.landmark >= 0).any()]) for of in lessons]
    usable = [(of, queries) for of, queries in usable if queries]
    if not usable:
        raise InputError("no query of these scenes shows an object of its map")
    with progress_bar("graph over objects", options.steps) as advance:
        for step in range(options.steps):
            of, queries = usable[rng.integers(len(usable))]
            left_out = rng.uniform(0, _MISSING_LANDMARKS)
            kept = np.flatnonzero(rng.random(len(of.landmarks)) >= left_out)
            number = np.full(len(of.landmarks) + 1, -1)
            number[kept] = np.arange(len(kept))
            theirs = describe_landmarks(graph, of.landmarks.some(kept))
            losses = []
            for _ in range(_QUERIES):
                query = queries[rng.integers(len(queries))]
                loss = _query_loss(graph, query, theirs, number, rng, options)
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
    theirs: Tensor,
    number: NDArray[np.int64],
    rng: np.random.Generator,
    options: ConstellationTraining,
) -> Tensor | None:
    """Return the cross entropy of matching a query's objects with landmarks, and back."""
    left_out = rng.uniform(0, options.missing)
    rows = np.flatnonzero(rng.random(len(query.landmark)) >= left_out)
    wrong = (
        float(rng.normal(0, np.radians(options.turn_deg))),
        float(np.exp(rng.normal(0, options.stretch))),
    )
    moved = rng.normal(0, options.moved_m, (len(rows), 2))
    target = number[query.landmark[rows]]
    known = np.flatnonzero(target >= 0)
    if len(known) < 2:
        return None
    own = describe_query(graph, query, rows, wrong, moved)
    alike = graph.sharpness.exp() * own @ theirs.T
    mine, their = (torch.from_numpy(each).to(alike.device) for each in (known, target[known]))
    there = functional.cross_entropy(alike[mine], their)
    back = functional.cross_entropy(alike.T[their], mine)
    return there + 0.5 * back


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m objconnect.network.constellation_training")
    parser.add_argument("scenes", type=Path, nargs="+", help="scenes with maps")
    parser.add_argument("--weights", type=Path, required=True, help="network with a detector")
    parser.add_argument("--out", type=Path, required=True, help="file of weights to write")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default=AUTO, help="auto, cpu, cuda or cuda:NUMBER")
    given = parser.parse_args(arguments)
    try:
        device = torch_device(given.device)
        network = read_network(given.weights)[0].to(device)
        if network.detector is None:
            raise InputError(f"{given.weights} has no detector of objects")
        extract = MapExtractor(network, LONGEST, "float32")
        finder = ObjectFinder(extract, network.detector)
        options = ConstellationTraining(seed=given.seed)
        lessons = [build_training_scene(Scene.open(path), finder) for path in given.scenes]
        config = ConstellationConfig(vector=network.detector.config.vector)
        graph = train_graph(lessons, config, options, device)
        whole = start_from(given.weights, {"constellation": config.model_dump()})
        assert whole.constellation is not None
        whole.constellation.load_state_dict(graph.state_dict())
        write_weights(given.out, whole, whole.config.model_dump(mode="json"))
    except InputError as error:
        print(f"objconnect: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
