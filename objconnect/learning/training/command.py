"""The command ``train``, which trains a method on scenes and writes its weights."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from types import MappingProxyType

from objconnect.learning.training.card import write_card
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import PairSources, Trainable, join, train_loop
from objconnect.learning.training.planes import PlanePairs
from objconnect.learning.training.rendered import RenderedPairs
from objconnect.scene.bundle.held_out import HeldOut, refuse_held_out
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.runtime.device import torch_device
from objconnect.scene.storage.digests import digest, sha256
from objconnect.scene.storage.files import require_distinct
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.outputs import check_output_folder


# More than six parameters: it is the function of a command.
def train(
    method: str,
    make: Callable[[TrainConfig], Trainable],
    data: Sequence[Path],
    out: Path,
    config: TrainConfig,
    validation: Sequence[Path] = (),
    held_out: Mapping[str, HeldOut] = MappingProxyType({}),
) -> Path:
    """Train a method on scenes, or continue an interrupted training.

    Args:
        method: name of the method.
        make: creates the method from the configuration.
        data: finished scenes (folders that ``simulate`` or ``ingest`` wrote) with depth, taken by
            pinhole cameras.
        out: folder of the run: checkpoint, log, curves, and at the end the weights and their card.
        config: configuration of the training.
        validation: scenes that are evaluated during training but not trained on.
        held_out: conditions, presets and lenses that benchmarks reserve for evaluation, by name of
            the benchmark's track; ``benchmark.tracks.description.held_out`` returns them.

    Returns:
        The file of the weights.

    Raises:
        InputError: a scene is unfinished, has a distorted camera or no overlapping frames, is given
            twice, or has a condition, preset or lens that a track holds out; folders of photographs
            hold none; ``out`` holds other files, another run or a run that is still going on; or a
            data loading process died.
    """
    check_output_folder(out, [*data, *validation])
    scenes = [Scene.open(path) for path in data]
    validation_scenes = [Scene.open(path) for path in validation]
    for opened in (scenes, validation_scenes):
        require_distinct(scene.path for scene in opened)
    refuse_held_out([*scenes, *validation_scenes], held_out)
    size, points = config.crop, config.points
    rendered = RenderedPairs(scenes, size, points, config.strength, config.pairs)
    planes = None
    if config.photographs and config.photograph_share > 0:
        planes = PlanePairs(config.photographs, size, points, config.strength, config.pairs)
    validation_pairs = None
    if validation_scenes:
        validation_pairs = RenderedPairs(validation_scenes, size, points, 0.0, config.pairs)
    sources = PairSources(rendered, planes, validation_pairs)
    description = {"method": method, "scenes": [_identity(scene) for scene in scenes]}
    if config.weights is not None:
        description["weights"] = digest(config.weights)
    is_first_process = join(torch_device(config.device)).rank == 0
    with write_lock(out) if is_first_process else nullcontext():
        trainable = make(config)
        # If there are initial weights, they determine the width.
        width = getattr(trainable.network_config, "width", config.width)
        config = config.model_copy(update={"width": width})
        weights = train_loop(trainable, config, sources, out, description)
        if is_first_process:
            write_card(out, method, config, scenes, validation_scenes)
    return weights


def _identity(scene: Scene) -> str:
    """Return preset, seed and a digest of all sessions of a scene, without its map."""
    sessions = {
        name: sha for name, sha in scene.manifest.sha256.items() if name.startswith("sessions/")
    }
    content = sha256(json.dumps(sessions, sort_keys=True))
    return f"{scene.manifest.preset} {scene.manifest.seed} {content}"
