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
        help="Set one option of the method, of its training in train, or of the queries of --pair "
        "in ingest; repeat for each option. 'objconnect options METHOD' lists the options of a "
        "method, docs/pairs.md those of --pair. Options of a sequence or a forecast "
        "are written sequence.KEY and forecast.KEY.",
    ),
]

Undulation = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Height of the geoid above the ellipsoid, for a surface model with heights above sea "
        "level. By default heights are taken as above the ellipsoid, as with 0.",
        min=-200,
        max=200,
    ),
]

Risk = Annotated[
    float | None,
    typer.Option(
        help="Largest probability of an error above 5 m or 10 degrees at which a pose is accepted, "
        "for methods that predict it (search.risk); 1 accepts any probability.",
        min=1e-6,
        max=1,
        show_default="0.05",
    ),
]

Jobs = Annotated[
    int,
    typer.Option(
        help="Number of queries, or of frames to render, at a time on this machine.", min=1
    ),
]

Cache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder for data that a method computes once per map; later runs reuse them.",
    ),
]

Datasets = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATASET",
        help="Scene, folder of a flight, folder that publish wrote or hf://OWNER/NAME@COMMIT, "
        "Extended CMU Seasons or one slice of it, AerialExtreMatch-Localization. A flight with a "
        "hard split (with a sparser map) is two data sets; FLIGHT-sparse names the hard split "
        "alone.",
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
        help="Information on each query for the method: prior (the pose that the data set gives), "
        "none, retrieval[=K] (the K most similar map photographs), pairs=FILE (a pair list of "
        "hloc), error=3m,5deg (the reference pose with an error of this size), gravity[=3deg] "
        "(the direction of gravity, without heading and position), or gps=50m (a position with an "
        "error of this size, without attitude).",
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
        help="Scene to measure the validation loss on; repeat the option for several.",
    ),
]

MappedScene = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene with its map.")]

CameraWords = Annotated[
    str | None,
    typer.Option(
        metavar="'MODEL W H PARAMS'",
        help="Calibration of the photographs: COLMAP's camera model, width and height in pixels, "
        "and parameters.",
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
    """Return a decorator that gives a command one option for each field of a configuration.

    The option has the name and the type of the field, and its help is the field's description. The
    command takes the values as a dictionary in one parameter called ``settings``; an option that
    was left out has its default there.

    Args:
        config: pydantic model.
        fields: names of its fields.
        defaults: defaults of single options. All others default to None, so that the value of a
            configuration file, or of the class, is used.
        metavars: placeholders of single options, such as the names that they take.
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
        own = list(signature.parameters.values())
        index = [parameter.name for parameter in own].index("settings")
        parameters = [*own[:index], *options, *own[index + 1 :]]

        def run(**values: Any) -> None:
            command(settings={name: values.pop(name) for name in fields}, **values)

        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return run

    return with_options
