"""Commands that train methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.arguments import claim_folders, open_distinct_datasets, parse_settings
from benchmark.cli.options import Datasets, Json, Settings, Start, TrainingScenes, ValidationScenes
from benchmark.cli.output import Summary, emit
from benchmark.registry import TRAINABLES

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
            help="Configuration of the training (baselines.training.config): a file, or the name "
            "of one that comes with objconnect, such as train/pixloc.",
        ),
    ] = None,
    overrides: Settings = None,
    as_json: Json = False,
) -> None:
    """Train a method on rendered scenes, or resume its training.

    Under torchrun, several processes train together. The weights are used by passing their file to
    evaluate or localize with --set weights=FILE.
    """
    from baselines.training.command import train as run
    from baselines.training.config import TrainConfig
    from benchmark.registry import trainable
    from scene.config import load_config

    settings = load_config(TrainConfig, config, parse_settings(overrides))
    weights = str(run(method, trainable(method), data, out, settings, validation or []))
    emit(Summary(weights, {"weights": weights}), as_json)


@app.command()
# More than six parameters: each is an option or argument of the command.
def ablate(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN",
            help="Plan of the variants: a YAML file (see benchmark.ablation), or ablation, the "
            "plan that comes with objconnect.",
        ),
    ],
    datasets: Datasets,
    data: TrainingScenes,
    out: Annotated[
        Path, typer.Option(metavar="OUT", help="Folder for training runs, results and the table.")
    ],
    validation: ValidationScenes = None,
    start: Start = "error=3m,5deg",
    as_json: Json = False,
) -> None:
    """Train and evaluate variants of object-connect, and print one table.

    All variants learn from the same scenes and answer the same queries. Use it to see what each
    block of the network contributes.
    """
    from benchmark.ablation import TABLE, Plan
    from benchmark.ablation import ablate as run
    from benchmark.starts import parse_start
    from scene.config import load_config

    settings = load_config(Plan, plan, {})
    started_from = parse_start(start)
    opened = open_distinct_datasets(datasets)
    claim_folders(datasets, out)
    table = run(settings, data, validation or [], opened, out, started_from)
    emit(Summary(table, {"table": str(out / TABLE)}), as_json)
