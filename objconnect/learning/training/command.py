"""The command ``train``, which trains a method on scenes and writes its weights."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path

from objconnect.learning.training.card import write_card
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import PairSources, Trainable, join, train_loop
from objconnect.learning.training.planes import PlanePairs
from objconnect.learning.training.rendered import RenderedPairs
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.runtime.device import torch_device
from objconnect.scene.storage.digests import digest, sha256
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.outputs import check_output_folder


def train(
    method: str,
    make: Callable[[TrainConfig], Trainable],
    data: Sequence[Path],
    out: Path,
    config: TrainConfig,
    validation: Sequence[Path] = (),
) -> Path:
    """Train a method on scenes, or continue an interrupted training.

    Args:
        method: name of the method.
        make: creates the method from the configuration.
        data: finished scenes with depth, taken by pinhole cameras.
        out: folder of the run: checkpoint, log, curves, and at the end the weights and their card.
        config: configuration of the training.
        validation: scenes that are evaluated during training and not learned from.

    Returns:
        The file of the weights.

    Raises:
        InputError: a scene is unfinished, has a distorted camera or no overlapping frames; ``out``
            holds another run or one that is still running; a process that makes pairs died.
    """
    check_output_folder(out, [*data, *validation])
    scenes = [Scene.open(path) for path in data]
    validated = [Scene.open(path) for path in validation]
    size, points = config.crop, config.points
    rendered = RenderedPairs(scenes, size, points, config.strength, config.pairs)
    planes = None
    if config.photographs and config.photograph_share > 0:
        planes = PlanePairs(config.photographs, size, points, config.strength, config.pairs)
    chosen = RenderedPairs(validated, size, points, 0.0, config.pairs) if validated else None
    sources = PairSources(rendered, planes, chosen)
    described = {"method": method, "scenes": [_identity(scene) for scene in scenes]}
    if config.weights is not None:
        described["weights"] = digest(config.weights)
    first = join(torch_device(config.device)).rank == 0
    with write_lock(out) if first else nullcontext():
        trained = make(config)
        # Initial weights determine the width.
        width = getattr(trained.network_config, "width", config.width)
        config = config.model_copy(update={"width": width})
        weights = train_loop(trained, config, sources, out, described)
        if first:
            write_card(out, method, config, scenes, validated)
    return weights


def _identity(scene: Scene) -> str:
    """Return preset, seed and the digest of all flights of a scene, without its maps."""
    flights = {
        name: sha for name, sha in scene.manifest.sha256.items() if name.startswith("sessions/")
    }
    content = sha256(json.dumps(flights, sort_keys=True))
    return f"{scene.manifest.preset} {scene.manifest.seed} {content}"
