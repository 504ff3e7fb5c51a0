"""Train the classifier: ``python -m objconnect.mapping.supplement.learning SCENE... --out FILE``.

The labels come from rendered scenes: whether a point is within 0.5 m of an object. Points on small
objects are rare and have ten times the weight.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import binary_cross_entropy_with_logits

from objconnect.learning.checkpoint import write_weights
from objconnect.mapping.diagnosis.surface_distances import CLOSE_M, read_truth
from objconnect.mapping.supplement.classifier import NUM_FEATURES, PointClassifier
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.small_objects import Proposals, propose_points
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_bar

# Precisions at which the report counts covered objects.
_PRECISIONS: Final = (0.95, 0.93, 0.9)

# Optimizer steps of the shipped weights.
_STEPS: Final = 3000
# Batch size, maximum learning rate and weight decay.
_BATCH: Final = 1024
_RATE: Final = 4e-3
_DECAY: Final = 1e-2
# Weight of points on small objects, which are rare.
_SMALL_WEIGHT: Final = 10.0
# Share of the features that each step replaces by their mean, so that the classifier tolerates
# unknown features.
_DROPOUT: Final = 0.1


class TrainingData(NamedTuple):
    """Points of a scene with ground truth.

    Attributes:
        features: inputs (T, F) of the classifier.
        on_object: (T,) bool, whether each point is within 0.5 m of the surface of an object.
        small: id (T,) of the small object on which each point lies, 0 for none.
        uncovered: ids of small objects in view that have no point in the map.
    """

    features: NDArray[np.float32]
    on_object: NDArray[np.bool_]
    small: NDArray[np.int64]
    uncovered: frozenset[int]


def read_training_data(path: Path) -> TrainingData:
    """Propose points in a rendered scene with a map, with the objects on which they lie.

    Raises:
        InputError: the folder is not a rendered scene with a map.
    """
    scene = Scene.open(path)
    sparse_map = scene.sparse_map()
    sparse_map = sparse_map.drop_points(scene.is_added_point(sparse_map))
    proposals = propose_points(sparse_map, scene.images_root, SupplementConfig())
    truth = read_truth(scene, _to_map(proposals))
    before = read_truth(scene, sparse_map)
    if truth is None or before is None:
        raise InputError(
            f"{path} has no ground truth of objects: train the classifier on rendered scenes"
        )
    small = {item.id for item in scene.objects.objects if item.size_class == "small"}
    on_object = (truth.owners > 0) & (truth.distance_m < CLOSE_M)
    owner = np.where(on_object & np.isin(truth.owners, list(small)), truth.owners, 0)
    uncovered = (small & before.ids_in_view) - set(np.unique(before.owners).tolist())
    return TrainingData(proposals.features, on_object, owner, frozenset(uncovered))


def _to_map(proposals: Proposals) -> SparseMap:
    """Convert proposals to a map, as ``read_truth`` takes it."""
    tracks, images = proposals.tracks, {}
    for view, image in enumerate(proposals.images):
        is_in_view = tracks.view == view
        xy = proposals.blobs[view].xy[tracks.row[is_in_view]]
        images[image.name] = replace(image, xy=xy, point_rows=tracks.track[is_in_view])
    count = len(tracks.xyz)
    colours = np.zeros((count, 3), np.uint8)
    return SparseMap(images, tracks.xyz, colours, np.zeros(count), tracks.views)


def train_classifier(
    data: Sequence[TrainingData], steps: int = _STEPS, seed: int = 0
) -> PointClassifier:
    """Train a classifier on points of scenes.

    Args:
        data: points of each scene.
        steps: number of optimizer steps.
        seed: random seed.

    Raises:
        InputError: the scenes have no points.
    """
    torch.manual_seed(seed)
    classifier = PointClassifier()
    features = torch.from_numpy(np.concatenate([each.features for each in data]))
    if not len(features):
        raise InputError("the scenes have no points to train on: give other scenes")
    target = torch.from_numpy(np.concatenate([each.on_object for each in data])).float()
    small = torch.from_numpy(np.concatenate([each.small for each in data])) > 0
    weight = torch.where(small, _SMALL_WEIGHT, 1.0)
    classifier.mean.copy_(features.mean(0))
    classifier.deviation.copy_(features.std(0).clamp_min(1e-6))
    drop = torch.nn.Dropout(_DROPOUT)
    optimizer = torch.optim.AdamW(classifier.parameters(), _RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, steps)
    with progress_bar("steps", steps) as advance:
        for step in range(1, steps + 1):
            batch = torch.randint(len(features), (_BATCH,))
            noisy = classifier.mean + drop(features[batch] - classifier.mean)
            loss = binary_cross_entropy_with_logits(classifier(noisy), target[batch], weight[batch])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
            advance(step)
    return classifier.eval()


def report(classifier: PointClassifier, data: TrainingData) -> list[str]:
    """Report the number of small objects that the classifier covers, at several precisions."""
    probability = classifier.predict(data.features)
    order = np.argsort(-probability, kind="stable")
    precision = np.cumsum(data.on_object[order]) / np.arange(1, len(order) + 1)
    lines = []
    for wanted in _PRECISIONS:
        enough = np.flatnonzero(precision >= wanted)
        kept = order[: enough[-1] + 1] if len(enough) else order[:0]
        covered = data.uncovered & set(data.small[kept].tolist())
        least = float(probability[kept].min()) if len(kept) else 1.0
        lines.append(
            f"{wanted:.0%} of {len(kept)} points with probability {least:.3f} or more are on "
            f"objects: {len(covered)} of {len(data.uncovered)} small objects without a point get "
            "one"
        )
    return lines


def main() -> None:
    """Train a classifier on scenes, print its report on other scenes, and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE")
    parser.add_argument("--validation", nargs="*", default=[], type=Path, metavar="SCENE")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    parser.add_argument("--steps", type=int, default=_STEPS)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    try:
        data = [read_training_data(path) for path in args.scenes]
        classifier = train_classifier(data, args.steps, args.seed)
        for path in args.validation:
            print(path, *report(classifier, read_training_data(path)), sep="\n")
        learning = {"steps": args.steps, "seed": args.seed}
        write_weights(args.out, classifier, {"figures": NUM_FEATURES, "learning": learning})
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
