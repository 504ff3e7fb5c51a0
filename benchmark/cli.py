"""The command line ``objconnect``.

Nothing heavy is imported before a command runs, so that help and mistakes answer at once.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from benchmark.boundary import INPUT_AT_FAULT, REGRESSION, Boundary, PrintedFormatter
from benchmark.choices import described, listed, one_of
from benchmark.registry import TRAINABLES
from scene.errors import InputError
from scene.exports.formats import FORMATS
from simulate.place.presets import PRESETS

if TYPE_CHECKING:
    from benchmark.datasets.dataset import Dataset
    from scene.geometry.camera import Camera

app = typer.Typer(
    name="objconnect",
    cls=Boundary,
    help="Simulate, build and compare 6-DoF localization of UAV cameras across seasons.",
    epilog="Exit codes: 0 done, 1 regression found, 2 the input or the environment is at fault, "
    "3 a fault of the program.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


Json = Annotated[
    bool, typer.Option("--json", help="Print a machine-readable summary on standard output.")
]

Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one value of the methods' configuration; repeat for several.",
    ),
]

Cache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Folder where methods keep what they build per map, for next time."
    ),
]


def _address(address: str | None) -> str | None:
    """Refused before any work, not where the work is spread."""
    from scene.runtime.cluster import require_address

    require_address(address)
    return address


ClusterAddress = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        callback=_address,
        help="Work on a Ray cluster: local (all cores of this machine), auto (the cluster that "
        "this machine is a node of) or HOST:PORT; see docs/cluster.md.",
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
    handler = logging.StreamHandler()
    handler.setFormatter(PrintedFormatter())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])


@app.command()
def evaluate(
    datasets: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATASET",
            help="Scenes, folders of flights, Extended CMU Seasons or one slice of it. A flight "
            "with a hard split is two data sets; FLIGHT-sparse names the hard split alone.",
        ),
    ],
    method: Annotated[
        list[str], typer.Option(metavar="METHOD", help="Localizer to run; repeat for several.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.json.")
    ],
    overrides: Settings = None,
    start: Annotated[
        str,
        typer.Option(
            metavar="START",
            help="What the method is told about a query: prior (the data set's own), none, "
            "retrieval[=K] (the K map photographs most like it), pairs=FILE (hloc's pair list), or "
            "error=3m,5deg (the reference pose, moved and turned by so much).",
        ),
    ] = "prior",
    cache: Cache = None,
    jobs: Annotated[int, typer.Option(help="Queries at a time.", min=1)] = 1,
    cluster: ClusterAddress = None,
    as_json: Json = False,
) -> None:
    """Localize the queries of data sets and score the poses.

    Writes RESULTS/<dataset>/<method>.json and a picture of the query of median error, each when its
    last query is done, and once per data set album.h5, which the leaderboard's page shows. Run
    again, an interrupted evaluation goes on where it was. Older results of the same name are
    replaced, but none that score wrote, and no other file.
    """
    from benchmark.datasets.open import open_datasets
    from benchmark.evaluate import claim_evaluation, results_path
    from benchmark.evaluate import evaluate as run
    from benchmark.registry import create
    from benchmark.report.markdown import markdown
    from benchmark.report.tables import tables
    from benchmark.starts import parse_start

    # Everything that can be wrong is looked at before the first minute is spent.
    settings = _settings(overrides or [])
    localizers = {name: create(name, settings) for name in method}
    told = parse_start(start)
    opened = [dataset for path in datasets for dataset in open_datasets(path)]
    _require_distinct_names(opened)
    _claim_folders(datasets, out, cache)
    for dataset in opened:
        for localizer in localizers.values():
            claim_evaluation(dataset, localizer, out)
    written = []
    for dataset in opened:
        for localizer in localizers.values():
            run(dataset, localizer, out, told, cache, jobs, cluster)
            written.append(results_path(out, dataset, localizer))
    boards = tables(written)
    if as_json:
        _print_json({"results": [str(path) for path in written], "tables": boards})
    else:
        print(markdown(boards), end="")


@app.command()
def submit(
    path: Annotated[
        Path, typer.Argument(metavar="CMU", help="Extended CMU Seasons, or one slice of it.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for submission.txt.")],
    method: Annotated[str, typer.Option(metavar="METHOD", help="Localizer to run.")] = "sift",
    overrides: Settings = None,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Write the poses of all query images as visuallocalization.net takes them.

    Run again, it goes on after the last finished slice.
    """
    from benchmark.registry import create
    from benchmark.submission import SUBMISSION
    from benchmark.submission import submit as run

    _claim_folders([path], out, cache)
    found, images = run(path, create(method, _settings(overrides or [])), out, cache)
    if as_json:
        _print_json({"submission": str(out / SUBMISSION), "images": images, "found": found})
    else:
        print(f"{out / SUBMISSION}: {found} of {images} images found")


@app.command()
def score(
    poses: Annotated[
        Path, typer.Argument(metavar="POSES", help="Lines: name qw qx qy qz tx ty tz, as hloc's.")
    ],
    reference: Annotated[
        list[Path],
        typer.Option(metavar="DATASET", help="What the poses are of, as for evaluate; repeatable."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.json.")
    ],
    method: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name to go by; else that of the file.")
    ] = None,
    start: Annotated[
        str, typer.Option(metavar="START", help="What the method was told, as for evaluate.")
    ] = "none",
    as_json: Json = False,
) -> None:
    """Score poses that another program found; a query without a line has failed.

    Older results of the same name are replaced if score wrote them; those of evaluate never are.
    """
    from benchmark.datasets.open import open_datasets
    from benchmark.external_poses import score as run
    from benchmark.report.markdown import markdown
    from benchmark.report.tables import tables

    opened = [dataset for path in reference for dataset in open_datasets(path)]
    _require_distinct_names(opened)
    _claim_folders(reference, out)
    written = run(poses, opened, poses.stem if method is None else method, out, start)
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
        Path | None, typer.Option(metavar="DIR", help="Folder for leaderboard.md, .tex and .html.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare results: one table per data set and starting information.

    Prints Markdown. With --out it is also written as LaTeX tables and as one HTML page that opens
    as a file: charts, paired comparisons, and every query with its pictures. Albums and basins that
    lie beside the results are shown in it.
    """
    from benchmark.report.leaderboard import leaderboard as compare
    from benchmark.report.tables import tables

    text = compare(results, out)
    if as_json:
        _print_json({"tables": tables(results)})
    else:
        print(text, end="")


@app.command()
def basin(
    datasets: Annotated[
        list[Path], typer.Argument(metavar="DATASET", help="Data sets, as of evaluate.")
    ],
    method: Annotated[
        list[str], typer.Option(metavar="METHOD", help="Localizer to run; repeat for several.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.basin.json.")
    ],
    errors: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Sizes of error as 1m/2deg,3m/5deg; left out, from 0m/0deg to 30m/30deg.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the directions of the errors.", min=0)] = 0,
    overrides: Settings = None,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Measure recall against the error of the prior: how far off may a start be?

    Each query is localized once for each size, from its reference pose moved and turned by exactly
    that much, the same way for every method. Refiners start there; sift looks at the map
    photographs nearest to it.
    """
    from benchmark.basin import DEFAULT_SIZES, basin_path, parse_sizes
    from benchmark.basin import basin as run
    from benchmark.datasets.open import open_datasets
    from benchmark.registry import create

    sizes = DEFAULT_SIZES if errors is None else parse_sizes(errors)
    settings = _settings(overrides or [])
    localizers = [create(name, settings) for name in method]
    opened = [dataset for path in datasets for dataset in open_datasets(path)]
    _require_distinct_names(opened)
    _claim_folders(datasets, out, cache)
    found = {}
    for dataset in opened:
        for localizer in localizers:
            measured = run(dataset, localizer, out, sizes, seed, cache)
            found[str(basin_path(out, dataset, localizer))] = measured
    if as_json:
        _print_json({"basins": found})
    else:
        print("\n".join(f"{path}\n{measured.text()}" for path, measured in found.items()))


@app.command()
def localize(
    place: Annotated[
        Path, typer.Option("--map", metavar="PLACE", help="Scene with its map, or a flight.")
    ],
    images: Annotated[Path, typer.Option(metavar="DIR", help="Folder of new photographs.")],
    out: Annotated[
        Path, typer.Option(metavar="POSES", help="Text file of the poses; a CSV lies beside it.")
    ],
    method: Annotated[str, typer.Option(metavar="METHOD", help="Localizer to run.")] = "sift",
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="'MODEL W H PARAMS'",
            help="Calibration of the photographs; else the map's camera of their size.",
        ),
    ] = None,
    priors: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Positions and attitudes; else those in EXIF and XMP."),
    ] = None,
    gps_sigma: Annotated[
        float,
        typer.Option(help="Standard deviation of EXIF positions, metres.", min=0.01, max=1e6),
    ] = 10.0,
    gimbal_sigma: Annotated[
        float,
        typer.Option(
            help="Standard deviation of the gimbal's attitudes in XMP, degrees.", min=0.01, max=180
        ),
    ] = 5.0,
    overrides: Settings = None,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Find the poses of new photographs in a map.

    Writes POSES (name qw qx qy qz tx ty tz, world to camera) and a CSV beside it with latitude,
    longitude, altitude, sigma and, for photographs not found, the reason. A photograph that cannot
    be read is a row of the CSV, too. Run again, an interrupted run goes on where it was.
    """
    from benchmark.localize import localize as run
    from benchmark.localize import open_place
    from benchmark.registry import create

    calibration = _camera(camera)
    _claim_folders([place, images], cache)
    located = run(
        open_place(place),
        images,
        create(method, _settings(overrides or [])),
        out,
        camera=calibration,
        priors=priors,
        gps_sigma_m=gps_sigma,
        gimbal_sigma_deg=gimbal_sigma,
        cache=cache,
    )
    found = sum(item.found for item in located)
    if as_json:
        _print_json({"poses": str(out), "photographs": len(located), "found": found})
    else:
        print(f"{out}: {found} of {len(located)} photographs found")


@app.command()
def train(
    method: Annotated[
        str,
        typer.Argument(metavar="METHOD", help=f"What learns: {', '.join(TRAINABLES.built_in)}."),
    ],
    data: Annotated[
        list[Path],
        typer.Option(metavar="SCENE", help="Scene to learn from; repeat for several."),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="RUN", help="Folder for checkpoint, log, curves, weights and card."),
    ],
    validation: Annotated[
        list[Path] | None,
        typer.Option(metavar="SCENE", help="Scene to look at only; repeat for several."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="File of baselines.training.config, or the name of one that comes with "
            "objconnect, as train/pixloc.",
        ),
    ] = None,
    overrides: Settings = None,
    as_json: Json = False,
) -> None:
    """Train a method on rendered scenes, or resume its training. Under torchrun, in processes."""
    from baselines.training.command import train as run
    from baselines.training.config import TrainConfig
    from benchmark.registry import trainable
    from scene.config import load_config

    settings = load_config(TrainConfig, config, _settings(overrides or []))
    weights = run(method, trainable(method), data, out, settings, validation or [])
    if as_json:
        _print_json({"weights": str(weights)})
    else:
        print(weights)


@app.command()
def ablate(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN",
            help="YAML of benchmark.ablation, or ablation, the one that comes with objconnect.",
        ),
    ],
    datasets: Annotated[
        list[Path],
        typer.Argument(metavar="DATASET", help="What evaluate takes: queries to answer."),
    ],
    data: Annotated[
        list[Path], typer.Option(metavar="SCENE", help="Scene to learn from; repeat for several.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="OUT", help="Folder for training runs, results and table.")
    ],
    validation: Annotated[
        list[Path] | None,
        typer.Option(metavar="SCENE", help="Scene to look at only; repeat for several."),
    ] = None,
    start: Annotated[
        str, typer.Option(metavar="START", help="As evaluate takes it.")
    ] = "error=3m,5deg",
    as_json: Json = False,
) -> None:
    """Train variants of object-connect alike, ask them the same queries, and print one table."""
    from benchmark.ablation import TABLE, Plan
    from benchmark.ablation import ablate as run
    from benchmark.datasets.open import open_datasets
    from benchmark.starts import parse_start
    from scene.config import load_config

    settings = load_config(Plan, plan, {})
    told = parse_start(start)
    opened = [dataset for path in datasets for dataset in open_datasets(path)]
    _require_distinct_names(opened)
    _claim_folders(datasets, out)
    table = run(settings, data, validation or [], opened, out, told)
    if as_json:
        _print_json({"table": str(out / TABLE)})
    else:
        print(table, end="")


@app.command()
def regress(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Folder that evaluate wrote.")],
    against: Annotated[
        Path, typer.Option(metavar="BASELINE", help="Folder of the recorded results.")
    ],
    update: Annotated[
        bool, typer.Option("--update", help="Make RESULTS the baseline instead of comparing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Compare recall with a baseline, query by query; exit 1 when it dropped by more than chance.

    McNemar's exact test on the same queries, at 5 % for each method and data set together.
    """
    from benchmark.regress import regress as run
    from benchmark.regress import update as record

    if update:
        written = record(results, against)
        if as_json:
            _print_json({"written": [str(path) for path in written]})
        else:
            print("\n".join(str(path) for path in written))
        return
    comparisons = run(results, against)
    if as_json:
        _print_json({"comparisons": [comparison.as_dict() for comparison in comparisons]})
    else:
        print("\n".join(comparison.text() for comparison in comparisons))
    if any(comparison.dropped for comparison in comparisons):
        raise typer.Exit(REGRESSION)


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(metavar="SCENE", help="Folder of the scene.")],
    preset: Annotated[
        str | None, typer.Option(metavar=listed(PRESETS), help="Kind of place.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed makes the same world.")] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="Configuration: a file, or the name of one that comes with objconnect, as demo "
            "or uav-sim. The options here win over it.",
        ),
    ] = None,
    area: Annotated[float | None, typer.Option(help="Side of the place, metres.")] = None,
    session: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CONDITION:FLIGHT[:ROLE][:CHANGE]",
            help="A flight under a condition, as winter-dusk:oblique; repeat for several. FLIGHT "
            "is nadir, grid, oblique, corridor, free, street or plan=FILE (QGroundControl's). ROLE "
            "is map or query; left out, the first flight builds the map, the others are queries. "
            "CHANGE is what is no longer as the place was built, as "
            "cars_moved=0.3,objects_removed=0.1,objects_added=0.1,bare_trees=true.",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option(help="Photographs per session.")] = None,
    size: Annotated[int | None, typer.Option(help="Side of a photograph, pixels.")] = None,
    spp: Annotated[int | None, typer.Option(help="Rendering samples per pixel.")] = None,
    jobs: Annotated[int, typer.Option(help="Rendering processes.", min=1)] = 1,
    cluster: ClusterAddress = None,
    file_format: Annotated[
        str | None,
        typer.Option(
            "--export",
            metavar=listed(FORMATS),
            callback=one_of(FORMATS),
            help="Also build the map and export the scene to the folder SCENE-FORMAT beside it.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Render a scene; run again, it goes on where it was interrupted.

    An option that is left out takes its value from the configuration file, else its default.
    """
    from mapping.build import build_map as build
    from scene.exports.export import export as write
    from scene.exports.export import require_empty
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
    wanted = SimulateConfig.load(config, settings)
    target = None if file_format is None else out.with_name(f"{out.name}-{file_format}")
    if target is not None and file_format is not None:
        FORMATS.load(file_format)
        require_empty(target)
    scene = run(wanted, out, jobs, cluster)
    summary: dict[str, Any] = {"scene": str(scene.path), "sessions": list(scene.sessions)}
    if target is not None and file_format is not None:
        if not scene.map_path.is_dir():
            build(out)
        summary["export"] = write(out, file_format, target)["out"]
    if as_json:
        _print_json(summary)
    else:
        print(f"{scene.path}: {', '.join(scene.sessions)}")
        if target is not None:
            print(f"exported to {target}")


@app.command()
def gallery(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for gallery.md and gallery/, its pictures.")
    ],
    preset: Annotated[
        str | None,
        typer.Option(metavar=listed(PRESETS), help="Kind of place to show under every condition."),
    ] = None,
    condition: Annotated[
        str, typer.Option(metavar="SEASON-LIGHT[-WEATHER]", help="To show every kind of place in.")
    ] = "summer-noon",
    seed: Annotated[int | None, typer.Option(help="Of the places.")] = None,
    area: Annotated[float | None, typer.Option(help="Side of the places, metres.")] = None,
    size: Annotated[int, typer.Option(help="Side of a photograph, pixels.")] = 240,
    spp: Annotated[int | None, typer.Option(help="Rendering samples per pixel.")] = None,
    as_json: Json = False,
) -> None:
    """Render a page of pictures: every kind of place, and one place in every season, light and
    weather. Run again, it goes on where it was interrupted.
    """
    from simulate.config import SimulateConfig
    from simulate.gallery import gallery as run

    settings = {"preset": preset, "seed": seed, "area": area, "size": size, "spp": spp}
    page = run(SimulateConfig.load(None, settings), out, condition)
    if as_json:
        _print_json({"page": str(page)})
    else:
        print(page)


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
    views: Annotated[int, typer.Option(help="Chessboard views.", min=4, max=1000)] = 20,
    seed: Annotated[int, typer.Option(help="Of the board's poses.", min=0)] = 0,
    as_json: Json = False,
) -> None:
    """Calibrate the simulated camera from rendered chessboards, and compare with the truth."""
    from scene.config import load_config
    from simulate.calibrate import calibrate as run
    from simulate.camera.lens import CameraConfig
    from simulate.config import SimulateConfig

    scene = SimulateConfig()
    chosen = None if camera is None else load_config(CameraConfig, camera, {})
    result = run(chosen.build(scene.size) if chosen else scene.photo_camera(), out, views, seed)
    if as_json:
        _print_json(result.as_dict())
    else:
        print(result.text())


class MapperName(StrEnum):
    """Structure from motion."""

    INCREMENTAL = "incremental"
    GLOBAL = "global"


class SplitBy(StrEnum):
    """What every k-th of is left for queries."""

    PHOTO = "photo"
    LINE = "line"
    NONE = "none"


@app.command()
def ingest(
    photographs: Annotated[
        Path,
        typer.Argument(
            metavar="PHOTOS", help="Folder of JPEGs, with GPS in their EXIF or a table."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="SCENE", help="Folder of the scene.")],
    gps: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="Table of positions, columns name,lat,lon,alt; else positions from EXIF.",
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="'MODEL W H PARAMS'",
            help="Calibration of all photographs; else focal lengths from EXIF.",
        ),
    ] = None,
    size: Annotated[
        int, typer.Option(help="Longest side of photographs in the scene, pixels.", min=64)
    ] = 1600,
    mapper: Annotated[
        MapperName, typer.Option(help="One photograph after the other, or all at once.")
    ] = MapperName.INCREMENTAL,
    split: Annotated[
        SplitBy, typer.Option(help="What queries are: single photographs, flight lines, none.")
    ] = SplitBy.PHOTO,
    every: Annotated[
        int, typer.Option(help="One photograph or line of so many is for queries.", min=2)
    ] = 4,
    as_json: Json = False,
) -> None:
    """Turn a folder of photographs with GPS into a scene; run again, it goes on.

    Writes SCENE with its map, a report ingest.json and a picture of the flight. The reference poses
    are the photographs' own structure from motion, placed by GPS.
    """
    from ingest.command import ingest as run

    report = run(
        photographs,
        out,
        gps=gps,
        camera=_camera(camera),
        size=size,
        mapper=mapper.value,
        split=split.value,
        every=every,
    )
    if as_json:
        _print_json(report.model_dump())
    else:
        print(report.text())


class MapMethod(StrEnum):
    """How a map is built."""

    TRIANGULATE = "triangulate"
    SFM = "sfm"


@app.command(name="map")
def build_map(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene to map.")],
    method: Annotated[
        MapMethod,
        typer.Option(
            help="Triangulate with the exact poses, or structure from motion aligned to them."
        ),
    ] = MapMethod.TRIANGULATE,
    cluster: ClusterAddress = None,
    as_json: Json = False,
) -> None:
    """Build the sparse map of a scene from its map frames, and measure it against the truth."""
    from mapping.build import build_map as run

    report = run(scene, method.value, cluster)
    if as_json:
        _print_json(report.as_dict())
    else:
        print(report.text())


@app.command()
def diagnose(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene with its map.")],
    masks: Annotated[
        Path | None,
        typer.Option(
            metavar="MASKS",
            help="Objects of the map's photographs, where the scene does not know them: a folder "
            "of label pictures, NAME.png for NAME.jpg, or a JSON of COCO annotations with "
            "run-length masks.",
        ),
    ] = None,
    cell: Annotated[
        float,
        typer.Option(
            help="Side of a cell of ground to count points in, metres.", min=0.1, max=10_000
        ),
    ] = 5.0,
    as_json: Json = False,
) -> None:
    """Say what a map has of the objects in its photographs: which have points, how many, how far
    these lie from the true surface, and how evenly they cover the ground.

    Draws SCENE/pictures/diagnosis.png. Where points were added to the map, also says and shows what
    it was before.
    """
    from mapping.diagnosis.command import diagnose as run

    diagnosis = run(scene, masks, cell)
    if as_json:
        _print_json(diagnosis.as_dict())
    else:
        print(diagnosis.text())


@app.command()
def supplement(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene with its map.")],
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Weights of an object-connect network, to look at its centres too; what "
            "stands out in the photographs alone otherwise.",
        ),
    ] = None,
    masks: Annotated[
        Path | None,
        typer.Option(
            metavar="MASKS",
            help="Objects of the map's photographs, to look at these alone: as of diagnose.",
        ),
    ] = None,
    remove: Annotated[
        bool, typer.Option("--remove", help="Take out what was added: the map of before.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Add points on small things that stand on the ground and have none in the map.

    They are marked in SCENE/map/supplement.json; nothing else of the map changes. Run again, they
    are replaced. Draws SCENE/pictures/diagnosis.png and says what the map was before.
    """
    from mapping.supplement.command import supplement as run
    from mapping.supplement.map import remove_from_map

    if remove:
        if weights is not None or masks is not None:
            raise InputError("--remove takes no other option: it takes out all that was added")
        removed = remove_from_map(scene)
        if as_json:
            _print_json({"removed": removed})
        else:
            print(f"{removed} points taken out of the map")
        return
    report = run(scene, weights, masks)
    if as_json:
        _print_json(report.as_dict())
    else:
        print(report.text())


class Stereo(StrEnum):
    """Who matches the photographs."""

    OWN = "own"
    COLMAP = "colmap"


@app.command(name="dense")
def make_dense(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene with its map.")],
    size: Annotated[
        int, typer.Option(help="Longest side of a depth map, pixels; never enlarged.", min=64)
    ] = 1024,
    sources: Annotated[
        int, typer.Option(help="Photographs to match each photograph with, at most.", min=2)
    ] = 6,
    stereo: Annotated[
        Stereo, typer.Option(help="Our own PatchMatch, or COLMAP's where pycolmap has CUDA.")
    ] = Stereo.OWN,
    seed: Annotated[int, typer.Option(help="The same seed makes the same maps.", min=0)] = 0,
    cluster: ClusterAddress = None,
    as_json: Json = False,
) -> None:
    """Estimate depth maps of the map's photographs, fuse them to a cloud, and measure them.

    Writes SCENE/dense as a COLMAP workspace. Run again, it goes on where it was interrupted.
    """
    from dense.command import dense as run

    report = run(scene, size=size, sources=sources, stereo=stereo.value, seed=seed, cluster=cluster)
    if as_json:
        _print_json(report.as_dict())
    else:
        print(report.text())


@app.command()
def export(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene to export.")],
    file_format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar=listed(FORMATS),
            callback=one_of(FORMATS),
            help=described(FORMATS),
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New or empty folder.")],
    session: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Session to export; repeat for several, omit for all."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write the poses and cameras of a scene for another program; photographs stay in the scene.

    Image names in the files are relative to SCENE/sessions; in transforms.json, to the file itself.
    """
    from scene.exports.export import export as run

    summary = run(scene, file_format, out, session or ())
    if as_json:
        _print_json(summary)
    else:
        print("{out}: {frames} frames for {format}".format_map(summary))


@app.command()
def validate(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene or flight to check.")],
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Check a scene's or flight's conventions and exactness, and name what is wrong."""
    from benchmark.validate import validate as run

    _claim_folders([scene], cache)
    report = run(scene, cache)
    if as_json:
        _print_json(report.as_dict())
    else:
        print(report.text())
    if not report.ok:
        raise typer.Exit(INPUT_AT_FAULT)


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what is installed, what is missing, and the line that mends it; exit 2 if anything needed
    is missing.

    Where this command itself cannot start, python -m benchmark.doctor can.
    """
    from benchmark.doctor import doctor as run

    diagnosis = run()
    if as_json:
        _print_json(diagnosis.as_dict())
    else:
        print(diagnosis.text())
    if not diagnosis.ok:
        raise typer.Exit(INPUT_AT_FAULT)


@app.command()
def view(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene with its map.")],
    results: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RESULTS",
            help="Results file, or folder that evaluate wrote, whose poses of the scene's queries "
            "to show; repeat for several.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="HTML", help="File for the page; else SCENE/pictures/view.html."),
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: Json = False,
) -> None:
    """Write a scene as one page to move about in, and as a picture beside it.

    Cameras with their photographs, points of the map, those added to it, the dense cloud, objects
    with and without a point, and queries where methods found them. The page holds all it shows: it
    opens as a file, without a server or a network.
    """
    import webbrowser

    from benchmark.report.view import view as run

    written = run(scene, results or (), out)
    if show and not webbrowser.open(written.page.resolve().as_uri()):
        raise InputError(f"no browser was found: open {written.page} in one")
    if as_json:
        summary = {"page": str(written.page), "picture": str(written.picture)}
        _print_json({**summary, "points": written.points})
    else:
        print(written.page)


def _settings(overrides: list[str]) -> dict[str, Any]:
    """``key=value`` words as a dictionary; values are read as YAML, so 0.7 is a number."""
    settings: dict[str, Any] = {}
    for word in overrides:
        key, equals, value = word.partition("=")
        if not key or not equals:
            raise InputError(f"--set takes KEY=VALUE, got {word!r}")
        try:
            settings[key] = yaml.safe_load(value)
        except (yaml.YAMLError, ValueError, RecursionError):
            raise InputError(f"--set {key}: {value!r} is not a YAML value") from None
        if settings[key] is None:
            raise InputError(f"--set {key}: {value!r} is no value; leave it out for the default")
    return settings


def _camera(words: str | None) -> Camera | None:
    """The value of ``--camera``."""
    from scene.geometry.camera import Camera

    try:
        return None if words is None else Camera.parse(words.split())
    except InputError as error:
        raise InputError(f"--camera: {error}") from None


def _claim_folders(inputs: Iterable[Path], *folders: Path | None) -> None:
    """Refuse to write among what a command reads: another data set would come of it."""
    from scene.storage.outputs import claim_folder

    for folder in folders:
        if folder is not None:
            claim_folder(folder, inputs)


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
