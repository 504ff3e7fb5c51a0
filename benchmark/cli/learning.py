"""Commands that train methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.arguments import parse_settings
from benchmark.cli.options import Json, Settings, TrainingScenes, ValidationScenes
from benchmark.cli.output import Summary, emit
from objconnect.methods import TRAINABLES

app = typer.Typer(rich_markup_mode=None)


@app.command()
# More than six parameters: each is an option or argument of the command.
def train(
    method: Annotated[
        str,
        typer.Argument(
            metavar="METHOD", help=f"Method to train: {', '.join(TRAINABLES.built_in)}."
        ),
    ],
    data: TrainingScenes,
    out: Annotated[
        Path,
        typer.Option(
            metavar="RUN",
            help="Folder for the checkpoint, the log, the loss curves, the weights and their card.",
        ),
    ],
    validation: ValidationScenes = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="Configuration of the training (objconnect.learning.training.config): a file, or "
            "the name of one that comes with objconnect, such as train/pixloc.",
        ),
    ] = None,
    overrides: Settings = None,
    as_json: Json = False,
) -> None:
    """Train a method on rendered scenes, or resume its training.

    Under torchrun, several processes train together. To use the weights, pass --set weights=FILE to
    evaluate or localize.
    """
    from objconnect.learning.training.command import train as run
    from objconnect.learning.training.config import TrainConfig
    from objconnect.methods import trainable
    from objconnect.scene.config import load_config

    settings = load_config(TrainConfig, config, parse_settings(overrides))
    weights = str(run(method, trainable(method), data, out, settings, validation or []))
    emit(Summary(weights, {"weights": weights}), as_json)
