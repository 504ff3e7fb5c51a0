"""Commands that render scenes, the sites (*places*) of a benchmark track, and chessboards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from benchmark.cli.arguments import check_jobs
from benchmark.cli.choices import list_choices, restrict_to
from benchmark.cli.options import ClusterAddress, Jobs, Json, options_of
from benchmark.cli.output import Summary, emit
from objconnect.scene.exports.formats import FORMATS
from simulate.config import SimulateConfig
from simulate.place.presets import PRESETS, SITE

app = typer.Typer(rich_markup_mode=None)

Sessions = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CONDITION:FLIGHT[:ROLE][:CHANGE]",
        help="A flight under a condition, such as winter-dusk:oblique; repeat the option for "
        "several. FLIGHT is nadir, grid, oblique, corridor, free, street, plan=FILE (a plan of "
        "QGroundControl) or flown=SCENE (the poses of a scene's photographs). ROLE is map or "
        "query; by default the first flight builds the map and the others are queries. CHANGE "
        "changes the site, such as "
        "cars_moved=0.3,objects_removed=0.1,objects_added=0.1,bare_trees=true.",
    ),
]
SiteScene = Annotated[
    Path | None,
    typer.Option(
        "--from",
        metavar="SCENE",
        help="Scene with depth maps, exact or from dense, to build the preset site from.",
    ),
]
SiteOrthophoto = Annotated[
    Path | None,
    typer.Option(metavar="TIF", help="Orthophoto to build the preset site from; needs --dsm."),
]
SiteSurface = Annotated[
    Path | None, typer.Option(metavar="TIF", help="Surface model of the preset site.")
]
SiteClasses = Annotated[
    Path | None,
    typer.Option(
        metavar="TIF",
        help="Surface classes of the preset site; by default they are estimated.",
    ),
]
SiteTime = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="When the photographs of the preset site were taken, such as 2026-07-01T10:30:00Z, "
        "to soften the shadows in them. By default the time of --from.",
    ),
]


Flights = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        envvar="OBJCONNECT_REAL",
        help="Folder of the flights of a track that is not rendered, such as real-seasons.",
    ),
]
KeyFile = Annotated[
    Path | None,
    typer.Option(
        metavar="KEYFILE",
        help="File of at least 16 random bytes, from which the seeds of places with withheld query "
        "poses are derived.",
    ),
]


@app.command()
@options_of(
    SimulateConfig,
    "preset",
    "seed",
    "area",
    "frames",
    "size",
    "spp",
    metavars={"preset": f"{list_choices(PRESETS)[:-1]}|{SITE}>"},
)
# More than six parameters: each is an option or argument of the command.
def simulate(
    out: Annotated[Path, typer.Option(metavar="SCENE", help="Folder of the scene.")],
    settings: dict[str, Any],
    session: Sessions = None,
    from_scene: SiteScene = None,
    ortho: SiteOrthophoto = None,
    dsm: SiteSurface = None,
    classes: SiteClasses = None,
    taken: SiteTime = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="Configuration: a file, or the name of one that comes with objconnect, such as "
            "demo or uav-sim. Options of this command override it.",
        ),
    ] = None,
    jobs: Jobs = 1,
    cluster: ClusterAddress = None,
    file_format: Annotated[
        str | None,
        typer.Option(
            "--export",
            metavar=list_choices(FORMATS),
            callback=restrict_to(FORMATS),
            help="Also build the map and export the scene to the folder SCENE-FORMAT beside it.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Render a scene with exact camera poses.

    An option that is left out takes its value from the configuration file, or else its default. An
    interrupted run goes on where it stopped. Run map on the scene next.
    """
    from objconnect.mapping.build import build_map as build
    from objconnect.scene.bundle.manifest import read_json
    from objconnect.scene.exports.export import export as write
    from objconnect.scene.storage.outputs import require_empty
    from simulate.command import simulate as run
    from simulate.twin.report import REPORT_FILE, SiteReport

    check_jobs(jobs, cluster)
    site = {"ortho": ortho, "dsm": dsm, "scene": from_scene, "classes": classes, "taken": taken}
    site_settings = {f"site.{name}": value for name, value in site.items()}
    chosen_config = SimulateConfig.load(config, settings | site_settings | {"sessions": session})
    target = None if file_format is None else out.with_name(f"{out.name}-{file_format}")
    if target is not None and file_format is not None:
        FORMATS.load(file_format)
        require_empty(target)
    scene = run(chosen_config, out, jobs, cluster)
    text = f"{scene.path}: {', '.join(scene.sessions)}"
    values: dict[str, Any] = {"scene": str(scene.path), "sessions": list(scene.sessions)}
    if chosen_config.site is not None:
        report = read_json(out / REPORT_FILE, SiteReport, "report of the site")
        text = "\n".join((text, report.text()))
        values["site"] = report.model_dump(mode="json")
    if target is not None and file_format is not None:
        if not scene.map_path.is_dir():
            build(out)
        values["export"] = write(out, file_format, target)["out"]
        text += f"\nexported to {target}"
    emit(Summary(text, values), as_json)


@app.command()
# More than six parameters: each is an option or argument of the command.
def track(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="Name of the track, such as uav-seasons or street-seasons."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the scenes, one for each place. A track of flights needs none.",
        ),
    ] = None,
    place: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Place to render, such as park-1; repeat the option for several.",
            show_default="all places",
        ),
    ] = None,
    jobs: Jobs = 1,
    cluster: ClusterAddress = None,
    board: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of all tracks.",
            show_default="the leaderboard that comes with objconnect",
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option(
            "--update",
            help="Record the digests and the difficulty of each query in the folder of --board.",
        ),
    ] = False,
    flights: Flights = None,
    sealed: KeyFile = None,
    as_json: Json = False,
) -> None:
    """Render and map the sites of a benchmark track, or check its flights.

    Prints one line per place: its digest, and whether the data set is the one behind the
    leaderboard's results. Places of the preset street are also exported in the layout of Extended
    CMU Seasons. An interrupted run goes on where it stopped, and finished places are not rendered
    again.
    """
    from benchmark.tracks.command import track as run
    from benchmark.tracks.description import TRACKS_FOLDER
    from objconnect.scene.errors import InputError

    check_jobs(jobs, cluster)
    if update and board is None:
        raise InputError("--update records into a folder of tracks: name it with --board")
    tracks_folder = board or TRACKS_FOLDER
    report = run(name, out, place or (), jobs, cluster, tracks_folder, update, flights, sealed)
    emit(report, as_json)


@app.command()
def calibrate(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the views and pictures.")],
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="YAML",
            help="File of the camera: model, width, height and params, or preset and size. By "
            "default the camera of simulate.",
        ),
    ] = None,
    views: Annotated[int, typer.Option(help="Number of chessboard views.", min=4, max=1000)] = 20,
    seed: Annotated[int, typer.Option(help="Random seed of the chessboard's poses.", min=0)] = 0,
    as_json: Json = False,
) -> None:
    """Calibrate the simulated camera from rendered chessboards.

    Prints the calibration beside the true camera. Use it to check that a camera model is rendered
    as OpenCV defines it.
    """
    from objconnect.scene.config import load_config
    from simulate.calibration import calibrate as run
    from simulate.camera.lens import CameraConfig

    defaults = SimulateConfig()
    camera_config = None if camera is None else load_config(CameraConfig, camera, {})
    truth = camera_config.build(defaults.size) if camera_config else defaults.photo_camera()
    emit(run(truth, out, views, seed), as_json)
