"""The command line ``objconnect``.

Nothing heavy is imported before a command runs, so that help and mistakes answer at once.
"""

from __future__ import annotations

import json
import logging
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml
from typer.core import TyperGroup

from scene.errors import InputError

if TYPE_CHECKING:
    from benchmark.datasets import Dataset

_INPUT_AT_FAULT = 2
_INTERRUPTED = 130


class _Group(TyperGroup):
    """Runs a command and turns what a person can mend into one line and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            message = " ".join(str(error).split())
            print(f"objconnect: error: {message}", file=sys.stderr)
            raise typer.Exit(_INPUT_AT_FAULT) from None
        except KeyboardInterrupt:
            print("objconnect: interrupted", file=sys.stderr)
            raise typer.Exit(_INTERRUPTED) from None


app = typer.Typer(
    name="objconnect",
    cls=_Group,
    help="Simulate, build and compare 6-DoF localization of UAV cameras across seasons.",
    epilog="Exit codes: 0 done, 1 regression found, 2 the input or the environment is at fault.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class Start(StrEnum):
    """What queries are handed besides the image."""

    PRIOR = "prior"
    NONE = "none"


Json = Annotated[
    bool, typer.Option("--json", help="Print a machine-readable summary on standard output.")
]

Cache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Folder where methods keep what they build per map, for next time."
    ),
]


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"objconnect {version('objconnect')}")
        except PackageNotFoundError:
            print("objconnect, not installed as a package")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", is_eager=True, callback=_version),
    ] = False,
) -> None:
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")


@app.command()
def evaluate(
    datasets: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATASET",
            help="Scenes, or folders of flights. A flight with a hard split is two data sets; "
            "FLIGHT-sparse names the hard split alone.",
        ),
    ],
    method: Annotated[
        list[str], typer.Option(metavar="METHOD", help="Localizer to run; repeat for several.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.json.")
    ],
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change one value of the methods' configuration; repeat for several.",
        ),
    ] = None,
    start: Annotated[
        Start, typer.Option(help="Hand each query's own prior to the method, or nothing.")
    ] = Start.PRIOR,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Localize the queries of data sets and score the poses.

    Writes RESULTS/<dataset>/<method>.json and a picture of the query of median error, each when its
    last query is done. An older file of the same name is replaced.
    """
    from baselines.registry import create
    from benchmark.datasets import open_datasets
    from benchmark.evaluate import evaluate as run
    from benchmark.evaluate import results_path
    from benchmark.leaderboard import markdown, tables

    # Everything that can be wrong is looked at before the first minute is spent.
    settings = _settings(overrides or [])
    localizers = {name: create(name, settings) for name in method}
    opened = [dataset for path in datasets for dataset in open_datasets(path)]
    _require_distinct_names(opened)
    written = []
    for dataset in opened:
        for localizer in localizers.values():
            run(dataset, localizer, out, start is Start.PRIOR, cache)
            written.append(results_path(out, dataset, localizer))
    boards = tables(written)
    if as_json:
        _print_json({"results": [str(path) for path in written], "tables": boards})
    else:
        print(markdown(boards), end="")


@app.command()
def leaderboard(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULTS", help="Results files, or folders that evaluate wrote."),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write leaderboard.md to.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare results: one Markdown table per data set and starting information."""
    from benchmark.leaderboard import leaderboard as compare
    from benchmark.leaderboard import tables

    text = compare(results, out)
    if as_json:
        _print_json({"tables": tables(results)})
    else:
        print(text, end="")


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(metavar="SCENE", help="Folder of the scene.")],
    preset: Annotated[str | None, typer.Option(help="Kind of place.")] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed makes the same world.")] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="YAML", help="Configuration; the options here win over it."),
    ] = None,
    area: Annotated[float | None, typer.Option(help="Side of the place, metres.")] = None,
    session: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CONDITION:FLIGHT[:ROLE]",
            help="A flight under a condition, as winter-dusk:oblique; repeat for several. ROLE is "
            "map or query; left out, the first flight builds the map, the others are queries.",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option(help="Photographs per session.")] = None,
    size: Annotated[int | None, typer.Option(help="Side of a photograph, pixels.")] = None,
    spp: Annotated[int | None, typer.Option(help="Rendering samples per pixel.")] = None,
    jobs: Annotated[int, typer.Option(help="Rendering processes.", min=1)] = 1,
    as_json: Json = False,
) -> None:
    """Render a scene; run again, it goes on where it was interrupted.

    An option that is left out takes its value from the configuration file, else its default.
    """
    from simulate.command import simulate as run
    from simulate.config import SimulateConfig

    settings = {
        "preset": preset,
        "seed": seed,
        "area": area,
        "sessions": session,
        "frames": frames,
        "size": size,
        "spp": spp,
    }
    scene = run(SimulateConfig.load(config, settings), out, jobs)
    if as_json:
        _print_json({"scene": str(scene.path), "sessions": list(scene.sessions)})
    else:
        print(f"{scene.path}: {', '.join(scene.sessions)}")


@app.command()
def calibrate(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the views and pictures.")],
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="Camera: model, width, height and params, or preset and size. Left out, the "
            "default camera of simulate.",
        ),
    ] = None,
    views: Annotated[int, typer.Option(help="Chessboard views.", min=4)] = 20,
    seed: Annotated[int, typer.Option(help="Of the board's poses.", min=0)] = 0,
    as_json: Json = False,
) -> None:
    """Calibrate the simulated camera from rendered chessboards, and compare with the truth."""
    from scene.config import load_config
    from simulate.calibrate import calibrate as run
    from simulate.config import SimulateConfig
    from simulate.lens import CameraConfig

    scene = SimulateConfig()
    chosen = None if camera is None else load_config(CameraConfig, camera, {})
    result = run(chosen.build(scene.size) if chosen else scene.photo_camera(), out, views, seed)
    if as_json:
        _print_json(result.as_dict())
    else:
        print(result.text())


@app.command(name="map")
def build_map(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene to map.")],
    as_json: Json = False,
) -> None:
    """Triangulate the sparse map of a scene from its map frames."""
    from simulate.mapping import build_map as run

    sparse_map = run(scene)
    figures = {
        "map": str(scene / "map"),
        "images": len(sparse_map.images),
        "points": len(sparse_map.xyz),
        "reprojection_error_px": sparse_map.reprojection_error(),
    }
    if as_json:
        _print_json(figures)
    else:
        print(
            "{map}: {images} images, {points} points, {reprojection_error_px:.2f} px".format_map(
                figures
            )
        )


@app.command()
def validate(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene or flight to check.")],
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Check a scene's or flight's conventions and exactness, and name what is wrong."""
    from benchmark.validate import validate as run

    report = run(scene, cache)
    if as_json:
        _print_json(report.as_dict())
    else:
        print(report.text())
    if not report.ok:
        raise typer.Exit(_INPUT_AT_FAULT)


def _settings(overrides: list[str]) -> dict[str, Any]:
    """``key=value`` words as a dictionary; values are read as YAML, so 0.7 is a number."""
    settings: dict[str, Any] = {}
    for word in overrides:
        key, equals, value = word.partition("=")
        if not key or not equals:
            raise InputError(f"--set takes KEY=VALUE, got {word!r}")
        try:
            settings[key] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise InputError(f"--set {key}: {value!r} is not a YAML value") from None
    return settings


def _require_distinct_names(datasets: list[Dataset]) -> None:
    """Two data sets of one name would overwrite each other's results."""
    seen = set()
    for dataset in datasets:
        if dataset.name in seen:
            raise InputError(f"two data sets are called {dataset.name!r}: evaluate them apart")
        seen.add(dataset.name)


def _print_json(summary: dict[str, Any]) -> None:
    from pydantic import TypeAdapter

    plain = TypeAdapter(dict[str, Any]).dump_python(summary, mode="json")
    print(json.dumps(plain, indent=1, allow_nan=False))


def main() -> None:
    """Entry point of the console script."""
    app()


if __name__ == "__main__":
    main()
