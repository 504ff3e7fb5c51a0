"""Options that several commands share, and options made from the fields of a configuration."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

Json = Annotated[
    bool, typer.Option("--json", help="Print a machine-readable summary on standard output.")
]

Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one value of the configuration of the method, in train of its training; "
        "repeat the option for each value. Values of a sequence and of a forecast are written "
        "sequence.KEY and forecast.KEY.",
    ),
]

Risk = Annotated[
    float | None,
    typer.Option(
        help="Probability with which an answer may be wrong by more than 5 m or 10 degrees, of "
        "methods that predict it (search.risk); 1 believes every pose.",
        min=1e-6,
        max=1,
        show_default="0.05",
    ),
]

Jobs = Annotated[
    int,
    typer.Option(
        help="How much is done at a time on this machine: queries, or frames to render.", min=1
    ),
]

Cache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder where methods keep what they compute once per map, for later runs.",
    ),
]

Datasets = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATASET",
        help="Scenes, folders of flights, Extended CMU Seasons or one slice of it. A flight with a "
        "hard split is two data sets; FLIGHT-sparse names the hard split alone.",
    ),
]

Methods = Annotated[
    list[str],
    typer.Option(metavar="METHOD", help="Localizer to run; repeat the option for several."),
]

Method = Annotated[str, typer.Option(metavar="METHOD", help="Localizer to run.")]

Start = Annotated[
    str,
    typer.Option(
        metavar="START",
        help="What the method is told about a query: prior (the pose that the data set gives), "
        "none, retrieval[=K] (the K map photographs that look most like it), pairs=FILE (a pair "
        "list of hloc), error=3m,5deg (the reference pose with an error of this size), "
        "gravity[=3deg] (which way is down, but neither heading nor position), or gps=50m (the "
        "position alone).",
    ),
]

TrainingScenes = Annotated[
    list[Path],
    typer.Option(metavar="SCENE", help="Scene to learn from; repeat the option for several."),
]

ValidationScenes = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="SCENE",
        help="Scene to measure the loss on, without learning from it; repeat the option for "
        "several.",
    ),
]

MappedScene = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene with its map.")]

CameraWords = Annotated[
    str | None,
    typer.Option(
        metavar="'MODEL W H PARAMS'",
        help="Calibration of the photographs: COLMAP's camera model, width, height and parameters.",
    ),
]


def _require_address(address: str | None) -> str | None:
    """Refuse a malformed address before any work begins."""
    from objconnect.scene.runtime.cluster import require_address

    require_address(address)
    return address


ClusterAddress = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        callback=_require_address,
        help="Work on a Ray cluster: local (all cores of this machine), auto (the cluster that "
        "this machine is a node of) or HOST:PORT; see docs/cluster.md.",
    ),
]


DeviceName = Annotated[
    str,
    typer.Option(
        "--device",
        metavar="DEVICE",
        help="Device to compute on: auto (CUDA where torch finds it), cpu, cuda or cuda:NUMBER.",
    ),
]


def options_of(
    config: type[Any],
    *fields: str,
    defaults: Mapping[str, object] | None = None,
    metavars: Mapping[str, str] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command one option for each of these fields of a configuration class.

    The option has the name and the type of the field, and its help is the field's description. The
    command takes one parameter called ``settings`` in place of the options: a dictionary of the
    fields' values, where the value of an option that was left out is its default.

    Args:
        config: pydantic model.
        fields: names of its fields.
        defaults: defaults of single options. All others have the default None, so that the value
            of a configuration file, or of the class, stands.
        metavars: placeholders of single options, such as the names that it takes.
    """
    options = []
    for name in fields:
        default = (defaults or {}).get(name)
        field = config.model_fields[name]
        kind: Any = field.annotation
        if default is None:
            kind = kind | None
        metavar = (metavars or {}).get(name)
        help_text = (field.description or "").replace("``", "")
        annotation: Any = Annotated[kind, typer.Option(metavar=metavar, help=help_text)]
        keyword = inspect.Parameter.POSITIONAL_OR_KEYWORD
        options.append(inspect.Parameter(name, keyword, default=default, annotation=annotation))

    def with_options(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        others = list(signature.parameters.values())
        place = [parameter.name for parameter in others].index("settings")
        parameters = [*others[:place], *options, *others[place + 1 :]]

        def run(**values: Any) -> None:
            command(settings={name: values.pop(name) for name in fields}, **values)

        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return run

    return with_options
