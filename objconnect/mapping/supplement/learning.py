"""Train the classifier: ``python -m objconnect.mapping.supplement.learning SCENE... --out FILE``.

For maps of rendered scenes it is known whether a place is within 0.5 m of an object. Places on
small objects are rare and have ten times the weight.
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
from objconnect.mapping.diagnosis.drift import CLOSE_M, read_truth
from objconnect.mapping.supplement.classifier import FIGURES, PlaceClassifier
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.small_objects import Places, find_places
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_bar

# Precisions at which the report counts the objects that are covered. They change no weights.
_SHARES: Final = (0.95, 0.93, 0.9)

# Steps of the optimizer, as the shipped weights were trained.
_STEPS: Final = 3000
# Places in a step, highest learning rate and weight decay.
_BATCH: Final = 1024
_RATE: Final = 4e-3
_DECAY: Final = 1e-2
# Weight of places on small objects, which are few.
_SMALL_WEIGHT: Final = 10.0
# Share of the figures that are set to unknown in a step, as those that no photograph shows.
_DROPOUT: Final = 0.1


class Lessons(NamedTuple):
    """Places of a scene with their truth.

    Attributes:
        figures: figures (T, F) of the places.
        on_object: (T,) bool, whether each place is within 0.5 m of the object on which it lies.
        small: id (T,) of the small object on which each place lies, 0 for none.
        lacking: ids of small objects that the photographs show and that have no point in the map.
    """

    figures: NDArray[np.float32]
    on_object: NDArray[np.bool_]
    small: NDArray[np.int64]
    lacking: frozenset[int]


def lessons(path: Path) -> Lessons:
    """Find the places of a rendered scene with a map, and the objects on which they lie.

    Raises:
        InputError: the folder is not such a scene.
    """
    scene = Scene.open(path)
    sparse_map = scene.sparse_map()
    sparse_map = sparse_map.without(scene.is_added_point(sparse_map))
    places = find_places(sparse_map, scene.images_root, SupplementConfig())
    truth = read_truth(scene, _as_map(sparse_map, places))
    before = read_truth(scene, sparse_map)
    if truth is None or before is None:
        raise InputError(
            f"{path} does not know its objects: the classifier learns on rendered scenes"
        )
    small = {item.id for item in scene.objects.objects if item.size_class == "small"}
    on_object = (truth.owners > 0) & (truth.drift < CLOSE_M)
    owner = np.where(on_object & np.isin(truth.owners, list(small)), truth.owners, 0)
    lacking = (small & before.seen) - set(np.unique(before.owners).tolist())
    return Lessons(places.figures, on_object, owner, frozenset(lacking))


def _as_map(sparse_map: SparseMap, places: Places) -> SparseMap:
    """Make places the points of a map, so that their truth can be read."""
    tracks, images = places.tracks, {}
    for view, image in enumerate(places.images):
        mine = tracks.view == view
        xy = places.blobs[view].xy[tracks.row[mine]]
        images[image.name] = replace(image, xy=xy, point_rows=tracks.track[mine])
    count = len(tracks.xyz)
    colours = np.zeros((count, 3), np.uint8)
    return SparseMap(images, tracks.xyz, colours, np.zeros(count), tracks.views)


def learn(taught: Sequence[Lessons], steps: int = _STEPS, seed: int = 0) -> PlaceClassifier:
    """Train a classifier on the places of scenes.

    Args:
        taught: places of each scene.
        steps: number of steps of the optimizer.
        seed: random seed.

    Raises:
        InputError: the scenes have no places.
    """
    torch.manual_seed(seed)
    classifier = PlaceClassifier()
    figures = torch.from_numpy(np.concatenate([each.figures for each in taught]))
    if not len(figures):
        raise InputError("the scenes have no place to learn from")
    right = torch.from_numpy(np.concatenate([each.on_object for each in taught])).float()
    small = torch.from_numpy(np.concatenate([each.small for each in taught])) > 0
    weight = torch.where(small, _SMALL_WEIGHT, 1.0)
    classifier.mean.copy_(figures.mean(0))
    classifier.deviation.copy_(figures.std(0).clamp_min(1e-6))
    drop = torch.nn.Dropout(_DROPOUT)
    optimizer = torch.optim.AdamW(classifier.parameters(), _RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, steps)
    with progress_bar("steps", steps) as advance:
        for step in range(1, steps + 1):
            some = torch.randint(len(figures), (_BATCH,))
            noisy = classifier.mean + drop(figures[some] - classifier.mean)
            loss = binary_cross_entropy_with_logits(classifier(noisy), right[some], weight[some])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
            advance(step)
    return classifier.eval()


def report(classifier: PlaceClassifier, evaluated: Lessons) -> list[str]:
    """Report how many small objects the likeliest places cover, at several precisions."""
    likely = classifier.likely(evaluated.figures)
    order = np.argsort(-likely, kind="stable")
    share = np.cumsum(evaluated.on_object[order]) / np.arange(1, len(order) + 1)
    lines = []
    for wanted in _SHARES:
        enough = np.flatnonzero(share >= wanted)
        kept = order[: enough[-1] + 1] if len(enough) else order[:0]
        covered = evaluated.lacking & set(evaluated.small[kept].tolist())
        least = float(likely[kept].min()) if len(kept) else 1.0
        lines.append(
            f"{wanted:.0%} of {len(kept)} places on objects from probability {least:.3f} on: "
            f"{len(covered)} of {len(evaluated.lacking)} small objects without a point have one"
        )
    return lines


def main() -> None:
    """Train a classifier on scenes, print its report on other scenes, and write it."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("scenes", nargs="+", type=Path, metavar="SCENE")
    words.add_argument("--validation", nargs="*", default=[], type=Path, metavar="SCENE")
    words.add_argument("--out", type=Path, required=True, metavar="FILE")
    words.add_argument("--steps", type=int, default=_STEPS)
    words.add_argument("--seed", type=int, default=0)
    chosen = words.parse_args()
    try:
        taught = [lessons(path) for path in chosen.scenes]
        classifier = learn(taught, chosen.steps, chosen.seed)
        for path in chosen.validation:
            print(path, *report(classifier, lessons(path)), sep="\n")
        learning = {"steps": chosen.steps, "seed": chosen.seed}
        write_weights(chosen.out, classifier, {"figures": FIGURES, "learning": learning})
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
