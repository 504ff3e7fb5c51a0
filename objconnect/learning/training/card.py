"""The card of trained weights: training data, settings and validation figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.loop import LOG, WEIGHTS
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import read_text

CARD: Final = "card.md"
"""Name of the card in the folder of a run."""
RESIDUAL: Final = "residual "
"""Prefix of the names of ``ObjectBlocks.residuals`` in the log."""


def write_card(
    run: Path,
    method: str,
    config: TrainConfig,
    scenes: Sequence[Scene],
    validation: Sequence[Scene],
) -> None:
    """Write the card as Markdown. It contains no recall, which is measured separately.

    Args:
        run: folder of a finished run, which contains the weights and the log. The card is written
            into it.
        method: name of the method.
        config: configuration of the run.
        scenes: scenes that the network was trained on.
        validation: scenes that the network was validated on.
    """
    weights = run / WEIGHTS
    rows = [json.loads(line) for line in read_text(run / LOG, "training log").splitlines()]
    hours = sum(row.get("seconds", 0.0) for row in rows) / 3600
    changed = config.model_dump(mode="json", exclude_defaults=True, exclude={"device"})
    megabytes = weights.stat().st_size / 1e6
    lines = [
        f"# Weights of {method}",
        "",
        f"- file: {weights.name}, {megabytes:.1f} MB, sha256 {sha256_of(weights)}",
        f"- trained on: {_list_scenes(scenes)}",
        f"- validated on: {_list_scenes(validation) or 'nothing'}",
        f"- steps: {config.steps} of {config.batch} pairs, seed {config.seed}, {hours:.2f} hours "
        f"on {config.device}",
        f"- settings that differ from the defaults: {json.dumps(changed, sort_keys=True)}",
    ]
    last = [row for row in rows if any(name.startswith("val/") for name in row)][-1:]
    for row in last:
        values = {k.removeprefix("val/"): v for k, v in row.items() if k.startswith("val/")}
        figures = ", ".join(f"{name} {value:.3g}" for name, value in values.items())
        lines.append(f"- validation at the end: {figures}")
    residuals = {k: v for row in rows for k, v in row.items() if k.startswith(RESIDUAL)}
    if residuals:
        shares = ", ".join(f"{k.removeprefix(RESIDUAL)} {v:.3g}" for k, v in residuals.items())
        lines.append(f"- outputs of blocks relative to their input, at the end: {shares}")
    write_text(run / CARD, "\n".join(lines) + "\n")


def _list_scenes(scenes: Sequence[Scene]) -> str:
    return ", ".join(f"{scene.manifest.preset} {scene.manifest.seed}" for scene in scenes)
