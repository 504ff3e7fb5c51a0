"""Commands that turn photographs into scenes, and check and export scenes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final

import typer

from benchmark.cli.arguments import check_folders, list_given_options, parse_camera, parse_settings
from benchmark.cli.boundary import INPUT_AT_FAULT
from benchmark.cli.choices import describe_choices, list_choices, restrict_to
from benchmark.cli.ingest_options import (
    Homography,
    MapOrthophoto,
    PairSurface,
    Photographs,
    PositionTable,
    Residual,
)
from benchmark.cli.options import Cache, CameraWords, Json, Settings, Undulation
from benchmark.cli.output import Summary, emit
from objconnect.mapping.pairs.options import PairQueryOptions
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from objconnect.scene.exports.formats import FORMATS

app = typer.Typer(rich_markup_mode=None)


class MapperName(StrEnum):
    """The structure-from-motion mappers."""

    INCREMENTAL = "incremental"
    GLOBAL = "global"


class FrameName(StrEnum):
    """The coordinate frames that another program's poses may be in."""

    TOPOCENTRIC = "topocentric"
    PROJECTED = "projected"


class SplitBy(StrEnum):
    """The units by which photographs are divided into map and queries."""

    PHOTO = "photo"
    LINE = "line"
    NONE = "none"


class LayerName(StrEnum):
    """The layers that ``publish`` can write; see ``benchmark.publishing.layers.LAYER_FILES``."""

    DEPTH = "depth"
    INSTANCE = "instance"
    SEMANTIC = "semantic"
    NORMAL = "normal"
    THERMAL = "thermal"


LongerSide = Annotated[
    int, typer.Option(help="Longer side of photographs in the scene, pixels.", min=64)
]
MapperOption = Annotated[
    MapperName,
    typer.Option(help="Structure from motion: one photograph after another, or all at once."),
]
SplitUnit = Annotated[
    SplitBy, typer.Option(help="Queries are single photographs, whole flight lines, or none.")
]
EveryNth = Annotated[
    int,
    typer.Option(help="One in this many photographs or flight lines becomes a query.", min=2),
]
GivenPoses = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Poses and cameras of another program, which replace structure from motion: "
        "reconstruction.json of ODM, cameras.xml of Metashape, transforms.json of nerfstudio, "
        "or the folder of a COLMAP model. Photographs without a pose are left out.",
    ),
]
PosesFrame = Annotated[
    FrameName | None,
    typer.Option(
        help="Frame of the poses in a reconstruction.json, if no file states it: "
        "'topocentric', metres east and north, as OpenSfM writes, or 'projected', as ODM writes, "
        "which needs odm_georeferencing/coords.txt.",
    ),
]
AddTo = Annotated[
    Path | None,
    typer.Option(
        metavar="OLD",
        help="Finished scene to add the photographs to. OLD does not change, and SCENE holds both: "
        "the frames of OLD keep their poses, and the new photographs are registered in its map.",
    ),
]
ControlList = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Ground control points in ODM's format: first line EPSG:n, then lines "
        "'x y z px py PHOTO NAME'. The report states their residuals and names wrong points.",
    ),
]
CheckPoints = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="Ground control point to use as a check point, not in the fit; repeat the option for "
        "several.",
    ),
]
ControlSigma = Annotated[
    float,
    typer.Option(help="Standard deviation of surveyed coordinates, metres.", min=0.001, max=1000),
]


# Options of ``ingest`` for --pair alone, and options for both photographs and --pair.
_PAIR_OPTIONS: Final = ("--pair", "--homography", "--dsm", "--undulation", "--residual", "--set")
_SHARED_OPTIONS: Final = ("--out", "--json")


def _check_options(given: Sequence[str], pair: Path | None) -> None:
    """Refuse options of --pair without --pair, and options of photographs with --pair."""
    for_pairs = [name for name in given if name in _PAIR_OPTIONS]
    for_photographs = [name for name in given if name not in (*_PAIR_OPTIONS, *_SHARED_OPTIONS)]
    if pair is None and for_pairs:
        raise InputError(f"{for_pairs[0]} is for two orthophotos: give --pair too")
    if pair is not None and for_photographs:
        raise InputError(f"{for_photographs[0]} is for photographs, not for --pair: leave it out")


@app.command()
# More than six parameters: each is an option or argument of the command.
def ingest(
    context: typer.Context,
    photographs: Photographs,
    out: Annotated[Path, typer.Option(metavar="SCENE", help="Folder of the scene.")],
    gps: PositionTable = None,
    poses: GivenPoses = None,
    poses_frame: PosesFrame = None,
    add: AddTo = None,
    gcp: ControlList = None,
    gcp_check: CheckPoints = None,
    gcp_sigma: ControlSigma = 0.05,
    camera: CameraWords = None,
    size: LongerSide = 1600,
    mapper: MapperOption = MapperName.INCREMENTAL,
    split: SplitUnit = SplitBy.PHOTO,
    every: EveryNth = 4,
    pair: MapOrthophoto = None,
    homography: Homography = None,
    dsm: PairSurface = None,
    undulation: Undulation = None,
    residual: Residual = None,
    overrides: Settings = None,
    as_json: Json = False,
) -> None:
    """Turn a folder of photographs with GPS positions into a scene.

    Writes SCENE with its map, the report ingest.json and a picture of the flight. Structure from
    motion over all photographs, aligned to GPS, gives the reference poses; with --poses they are
    read from that file, with --add they are found in the map of OLD. Without --camera, focal
    lengths are read from --poses, OLD or EXIF. An interrupted run goes on where it stopped.

    With --pair, SCENE becomes a flight of two orthophotos of different dates.
    """
    _check_options(list_given_options(context), pair)
    if pair is not None:
        from objconnect.mapping.pairs.command import ingest_pair

        flight = ingest_pair(
            pair,
            photographs,
            out,
            homography=homography,
            dsm=dsm,
            undulation=undulation,
            residual=residual,
            options=load_config(PairQueryOptions, None, parse_settings(overrides)),
        )
        emit(flight, as_json)
        return
    from objconnect.ingestion.command import ingest as run
    from objconnect.ingestion.options import IngestOptions

    report = run(
        photographs,
        out,
        gps=gps,
        poses=poses,
        poses_frame=None if poses_frame is None else poses_frame.value,
        add=add,
        gcp=gcp,
        checks=gcp_check or (),
        camera=parse_camera(camera),
        size=size,
        mapper=mapper.value,
        split=split.value,
        every=every,
        options=IngestOptions(control_sigma_m=gcp_sigma),
    )
    emit(Summary(report.text(), report.model_dump()), as_json)


@app.command()
# More than six parameters: each is an option or argument of the command.
def export(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene to export.")],
    file_format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar=list_choices(FORMATS),
            callback=restrict_to(FORMATS),
            help=describe_choices(FORMATS),
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New or empty folder.")],
    session: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Flight (session) to export; repeat it for several. By default all are exported.",
        ),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Pixel size of --format ortho, metres.",
            min=0.001,
            max=1000,
            show_default="ground size of the photographs' pixels",
        ),
    ] = None,
    crs: Annotated[
        str | None,
        typer.Option(
            metavar="EPSG:N",
            help="Coordinate reference system of --format ortho, in metres.",
            show_default="the UTM zone",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write the poses and cameras of a scene in the format of another program.

    Photographs are not copied: only --format cmu, video and rerun-images hold them. Image names in
    the files are relative to SCENE/sessions, but in transforms.json they are relative to the file
    itself, and with --format opensfm and metashape they have no folders.
    An orthophoto is fused from the map's photographs.
    """
    from objconnect.scene.exports.export import export as run

    summary = run(scene, file_format, out, session or (), resolution=resolution, crs=crs)
    text = "{out}: {frames} frames for {format}".format_map(summary)
    emit(Summary(text, summary), as_json)


ScenesToPublish = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCENE", help="Scene, or folder of scenes, such as those that track renders."
    ),
]
Layers = Annotated[
    list[LayerName] | None,
    typer.Option(
        help="Layer to publish with each photograph; repeat the option for several.",
    ),
]
License = Annotated[
    str | None,
    typer.Option(
        "--license",
        metavar="SPDX",
        help="Licence of the data set, such as CC-BY-4.0. Scenes that show a real site need it.",
        show_default="CC-BY-4.0 for invented sites",
    ),
]
Creator = Annotated[
    str | None, typer.Option(metavar="NAME", help="Person or organization that made the data set.")
]
Url = Annotated[str | None, typer.Option(metavar="URL", help="Page of the data set.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Write nothing, and report the size.")]
Sealed = Annotated[
    bool, typer.Option("--sealed", help="Leave out the poses of queries (see track --sealed).")
]
Day = Annotated[str | None, typer.Option(metavar="YYYY-MM-DD", help="Day of publication.")]


@app.command()
# More than six parameters: each is an option or argument of the command.
def publish(
    scenes: ScenesToPublish,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="New or empty folder; the data set gets its name."),
    ],
    layer: Layers = None,
    license_id: License = None,
    creator: Creator = None,
    url: Url = None,
    date: Day = None,
    release: Annotated[
        str, typer.Option(metavar="VERSION", help="Version of the data set.")
    ] = "1.0.0",
    dry_run: DryRun = False,
    sealed: Sealed = False,
    as_json: Json = False,
) -> None:
    """Write scenes as a data set for a data hub, with a card and metadata.

    DIR holds Parquet files of the photographs with their poses, cameras, priors and difficulty,
    the maps, a data card, metadata in Croissant 1.1, preview pictures and checksums. It appears
    when it is complete. evaluate reads it without Blender.
    """
    from benchmark.publishing.command import publish as run
    from benchmark.publishing.description import Release

    description = Release(license_id, creator, url, date, release)
    layers = [name.value for name in layer or ()]
    emit(run(scenes, out, layers, description, dry_run, sealed), as_json)


@app.command()
def validate(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene or flight to check.")],
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Check the conventions and the exactness of a scene or a flight.

    Prints every check with its figures, and exits with 2 if one fails. Use it on data that you
    made or changed, before you trust results on it.
    """
    from benchmark.validation import validate as run

    check_folders([scene], cache)
    report = run(scene, cache)
    emit(report, as_json)
    if not report.ok:
        raise typer.Exit(INPUT_AT_FAULT)


@app.command()
def audit(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA",
            help="Scene, flight, Extended CMU Seasons, or poses of another program: a COLMAP "
            "model, transforms.json of nerfstudio, reconstruction.json of ODM, cameras.xml of "
            "Metashape, cameras.json of 3D Gaussian splatting, a TUM trajectory, a table "
            "name,lat,lon,alt, or the folder of such a project.",
        ),
    ],
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the photographs. By default the usual folders of the format are tried.",
        ),
    ] = None,
    camera: CameraWords = None,
    poses_frame: PosesFrame = None,
    out: Annotated[
        Path | None, typer.Option(metavar="HTML", help="HTML page of the verdicts to write.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Check the poses of any data set against its photographs, without ground truth.

    Reports for each property whether it is right, wrong (and what the fault looks like) or unknown
    (and why): conventions of poses, focal length, principal point, names and their order, scale,
    positions, heights, and the files themselves. The evidence is matches between photographs, their
    EXIF, and the map's points. Exits with 2 if something is wrong.
    """
    from benchmark.auditing.command import audit as run

    audits = run(
        data,
        images,
        parse_camera(camera),
        out,
        frame=None if poses_frame is None else poses_frame.value,
    )
    text = "\n\n".join(report.text() for report in audits)
    emit(Summary(text, {"audits": [report.as_dict() for report in audits]}), as_json)
    if not all(report.ok for report in audits):
        raise typer.Exit(INPUT_AT_FAULT)
