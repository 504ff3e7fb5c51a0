"""Commands about the methods: their options and their training."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

import typer
from pydantic import BaseModel

from benchmark.cli.arguments import parse_settings
from benchmark.cli.options import Json, Settings, TrainingScenes, ValidationScenes
from benchmark.cli.output import Summary, emit
from objconnect.methods import TRAINABLES

app = typer.Typer(rich_markup_mode=None)


@app.command()
def options(
    method: Annotated[str, typer.Argument(metavar="METHOD", help="Localizer, such as sift.")],
    as_json: Json = False,
) -> None:
    """List the options of a localizer with their defaults.

    Each is printed as KEY=VALUE, as --set of evaluate and localize takes it. The options of a group
    follow it as GROUP.KEY.
    """
    from objconnect.methods import create

    method_options = list(_list_options(create(method, {}).config))
    lines = [_describe(option) for option in method_options] or [f"{method} has no options"]
    emit(Summary("\n".join(lines), {"method": method, "options": method_options}), as_json)


def _list_options(config: BaseModel, group: str = "") -> Iterator[dict[str, Any]]:
    """Yield key, default and description of every option; those of a group follow the group."""
    defaults = config.model_dump(mode="json")
    for name, field in type(config).model_fields.items():
        description = (field.description or "").replace("``", "")
        yield {"key": group + name, "default": defaults[name], "description": description}
        if isinstance(inner := getattr(config, name), BaseModel):
            yield from _list_options(inner, f"{group}{name}.")


def _describe(option: dict[str, Any]) -> str:
    is_group = isinstance(option["default"], dict)
    first = f"{option['key']}{' (group)' if is_group else '=' + json.dumps(option['default'])}"
    indent = " " * 4
    text = fill(option["description"], 96, initial_indent=indent, subsequent_indent=indent)
    return f"{first}\n{text}"


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

    Scenes with a condition, preset, lens or seed that a track holds out are refused.
    Under torchrun, several processes train together. To use the weights, pass --set weights=FILE to
    evaluate or localize.
    """
    from benchmark.tracks.description import read_held_out
    from objconnect.learning.training.command import train as run
    from objconnect.learning.training.config import TrainConfig
    from objconnect.methods import trainable
    from objconnect.scene.config import load_config

    settings = load_config(TrainConfig, config, parse_settings(overrides))
    constructor = trainable(method)
    weights = str(run(method, constructor, data, out, settings, validation or [], read_held_out()))
    emit(Summary(weights, {"weights": weights}), as_json)


@app.command()
# More than six parameters: each is an option or argument of the command.
def publish_weights(
    weights: Annotated[
        str,
        typer.Argument(
            metavar="WEIGHTS",
            help="Weights that come with objconnect (objconnect, objconnect-objects, pixloc, "
            "d2net), or a .safetensors file with its card beside it.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="New or empty folder; the model gets its name."),
    ],
    results: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RESULTS",
            help="Results of evaluate for the card; repeat the option for several. Results of "
            "other weights are left out.",
        ),
    ] = None,
    benchmark: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="ADDRESS",
            help="Published data set on the hub, hf://OWNER/NAME@COMMIT, whose scores the hub is "
            "to show. The results must cover all its scenes.",
        ),
    ] = None,
    license_id: Annotated[
        str | None,
        typer.Option(
            "--license",
            metavar="SPDX",
            help="Licence of the weights, such as CC-BY-4.0. Your own weights need it.",
            show_default="Apache-2.0 for those that come with objconnect",
        ),
    ] = None,
    creator: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Person or organization that made the weights."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Write nothing, and report the size.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write weights as a model for a hub, with a card and results.

    DIR holds the file of weights unchanged, the files beside it that calibrate covariances and
    acceptance, a model card, the results and checksums. It appears when it is complete. --set
    weights=DIR uses the weights.
    """
    from benchmark.publishing.description import Release
    from benchmark.publishing.weights.command import publish_weights as run

    release = Release(license_id, creator)
    emit(run(weights, out, results or [], benchmark or [], release, dry_run), as_json)
