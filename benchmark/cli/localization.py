"""Commands that localize: on data sets, on new photographs, from wrong priors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.arguments import (
    check_jobs,
    check_methods,
    claim_folders,
    create_at_risk,
    open_distinct_datasets,
    parse_camera,
    parse_crs,
    parse_settings,
)
from benchmark.cli.options import (
    Cache,
    CameraWords,
    ClusterAddress,
    Datasets,
    Jobs,
    Json,
    Method,
    Methods,
    Risk,
    Settings,
    Start,
)
from benchmark.cli.output import Summary, emit
from objconnect.scene.errors import InputError

app = typer.Typer(rich_markup_mode=None)

Poses = Annotated[
    Path,
    typer.Option(metavar="POSES", help="Text file of the poses; a CSV file is written beside it."),
]
Images = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of new photographs.")]
VideoFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Video of a flight, instead of photographs."),
]
Subtitles = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Subtitles of the video with the drone's telemetry. By default those of the same "
        "name beside the video.",
    ),
]
Sequenced = Annotated[
    bool,
    typer.Option(
        "--sequence",
        help="The photographs are of one flight: each is looked for where those before it lead.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        help="Frames of the video to localize a second. With --sequence, photographs a second, "
        "in the order of their names, instead of the times in EXIF.",
        min=0.01,
        max=240,
        show_default="2 of a video",
    ),
]
Priors = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="Table of positions: name,e,n,u in metres in the map's frame or name,lat,lon,alt, "
        "and perhaps sigma_m and attitudes. Without it, they are read from EXIF and XMP.",
    ),
]
GpsSigma = Annotated[
    float,
    typer.Option(
        help="Standard deviation of EXIF positions, metres, and of those of --priors without "
        "sigma_m. Fixed positions of RTK have the standard deviations of their XMP instead.",
        min=0.01,
        max=1e6,
    ),
]
GimbalSigma = Annotated[
    float,
    typer.Option(
        help="Standard deviation of the gimbal attitudes in XMP, degrees, and of attitudes of "
        "--priors without sigma_deg.",
        min=0.01,
        max=180,
    ),
]
Further = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        help="Further file to write: GeoJSON (.geojson) for a GIS, KML (.kml) for a globe, a "
        "telemetry log of MAVLink (.tlog) for an autopilot's filter, a ROS 2 bag (.mcap); repeat "
        "the option for several.",
    ),
]
Undulation = Annotated[
    float | None,
    typer.Option(
        help="Height of the geoid above the ellipsoid at the place, metres, for heights above sea "
        "level. Without it, it is that of the grid us_nga_egm96_15.tif of PROJ, where this is "
        "installed; else marks of KML lie on the ground.",
        min=-200,
        max=200,
        show_default="unknown",
    ),
]
Crs = Annotated[
    str | None,
    typer.Option(
        metavar="EPSG:N",
        help="Coordinate reference system of additional columns x (east), y (north) and h, such "
        "as EPSG:32632; with heights of its own as EPSG:7415.",
        show_default="none",
    ),
]


@app.command()
# More than six parameters: each is an option or argument of the command.
def localize(
    place: Annotated[
        Path, typer.Option("--map", metavar="PLACE", help="Scene with its map, or a flight.")
    ],
    out: Poses,
    images: Images = None,
    video: VideoFile = None,
    srt: Subtitles = None,
    sequence: Sequenced = False,
    rate: Rate = None,
    method: Method = "objconnect",
    camera: CameraWords = None,
    priors: Priors = None,
    gps_sigma: GpsSigma = 10.0,
    gimbal_sigma: GimbalSigma = 5.0,
    also: Further = None,
    undulation: Undulation = None,
    crs: Crs = None,
    risk: Risk = None,
    overrides: Settings = None,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Find the poses of new photographs, or of the frames of a video, in a map.

    Writes POSES (name qw qx qy qz tx ty tz, world to camera) and beside it a CSV file with
    latitude, longitude, altitude above the ellipsoid, sigmas, time, yaw, pitch, roll, covariance,
    the probability that the pose is right, the camera that was used and, for photographs that were
    not found or cannot be read, the reason.
    Without --camera, a photograph has the map's camera of its size, else its calibration in XMP,
    the map's camera scaled, the focal length in EXIF, or an estimate. A video and --sequence take
    each pose as the prior of the next; a JSON file beside POSES records how. An interrupted run
    goes on where it stopped.
    """
    from objconnect.localization.pipeline import localize as job
    from objconnect.localization.pipeline.localization_map import open_map
    from objconnect.localization.pipeline.options import LocalizeOptions
    from objconnect.localization.pipeline.tracking import sequence_config

    flown = _choose_source(images, video, srt, priors, sequence, rate)
    settings = parse_settings(overrides)
    config = sequence_config(settings) if video is not None or sequence else None
    options = LocalizeOptions(
        camera=parse_camera(camera),
        priors=priors,
        gps_sigma_m=gps_sigma,
        gimbal_sigma_deg=gimbal_sigma,
        srt=srt,
        rate_hz=rate,
        sequence=config,
        also=also or (),
        undulation_m=undulation,
        projection=parse_crs(crs),
        cache=cache,
    )
    claim_folders([place, flown], cache)
    localizer = create_at_risk(method, settings, risk)
    run = job.localize if video is None else job.localize_video
    located = run(open_map(place), flown, localizer, out, options)
    localized = sum(item.is_localized for item in located)
    what = "photographs" if video is None else "frames"
    text = f"{out}: {localized} of {len(located)} {what} found"
    emit(Summary(text, {"poses": str(out), what: len(located), "found": localized}), as_json)


def _choose_source(
    images: Path | None,
    video: Path | None,
    srt: Path | None,
    priors: Path | None,
    sequence: bool,
    rate: float | None,
) -> Path:
    """Return the photographs or the video that are asked for.

    Raises:
        InputError: there is neither or both, or an option is of the other.
    """
    if video is not None and images is None:
        if priors is not None or sequence:
            raise InputError("a video is a sequence: leave out --priors and --sequence")
        return video
    if images is None or video is not None:
        raise InputError("give photographs with --images, or a video with --video")
    if srt is not None:
        raise InputError("--srt is the telemetry of a video: give --video instead of --images")
    if rate is not None and not sequence:
        raise InputError("--rate is that of a sequence: give --sequence too")
    return images


@app.command()
# More than six parameters: each is an option or argument of the command.
def evaluate(
    datasets: Datasets,
    method: Methods,
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.json.")
    ],
    overrides: Settings = None,
    start: Start = "prior",
    cache: Cache = None,
    jobs: Jobs = 1,
    cluster: ClusterAddress = None,
    as_json: Json = False,
) -> None:
    """Localize the queries of data sets and score the poses.

    Writes RESULTS/<dataset>/<method>.json and a picture of the query of median error, each when its
    last query is done, and once per data set album.h5, which the leaderboard's page shows. An
    interrupted run goes on where it stopped. Older results of the same name are replaced unless
    score wrote them; no other file is.
    """
    from benchmark.evaluation.evaluate import claim_evaluation, results_path
    from benchmark.evaluation.evaluate import evaluate as run
    from benchmark.evaluation.starts import parse_start
    from objconnect.methods import create

    # Everything that can be wrong is checked before the first minute is spent.
    check_jobs(jobs, cluster)
    check_methods(method)
    settings = parse_settings(overrides)
    localizers = {name: create(name, settings) for name in method}
    started_from = parse_start(start)
    opened = open_distinct_datasets(datasets)
    claim_folders(datasets, out, cache)
    for dataset in opened:
        for localizer in localizers.values():
            claim_evaluation(dataset, localizer, out)
    written = []
    for dataset in opened:
        for localizer in localizers.values():
            run(dataset, localizer, out, started_from, cache, jobs, cluster)
            written.append(results_path(out, dataset, localizer))
    emit(_summarize(written), as_json)


@app.command()
# More than six parameters: each is an option or argument of the command.
def basin(
    datasets: Datasets,
    method: Methods,
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.basin.json.")
    ],
    errors: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Sizes of the error, written 1m/2deg,3m/5deg. By default they go from 0m/0deg to "
            "30m/30deg.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed of the error directions.", min=0)] = 0,
    overrides: Settings = None,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Measure how recall falls with the error of the prior pose.

    Each query is localized once for each size, from its reference pose shifted and rotated by
    exactly that much, in the same direction for every method. Refiners start from this pose; sift
    looks at the map photographs nearest to it.
    """
    from benchmark.evaluation.basin import DEFAULT_SIZES, basin_path, parse_sizes
    from benchmark.evaluation.basin import basin as run
    from objconnect.methods import create

    check_methods(method)
    sizes = DEFAULT_SIZES if errors is None else parse_sizes(errors)
    settings = parse_settings(overrides)
    localizers = [create(name, settings) for name in method]
    opened = open_distinct_datasets(datasets)
    claim_folders(datasets, out, cache)
    basins = {}
    for dataset in opened:
        for localizer in localizers:
            measured = run(dataset, localizer, out, sizes, seed, cache)
            basins[str(basin_path(out, dataset, localizer))] = measured
    text = "\n".join(f"{path}\n{measured.text()}" for path, measured in basins.items())
    emit(Summary(text, {"basins": basins}), as_json)


@app.command()
def score(
    poses: Annotated[
        Path,
        typer.Argument(
            metavar="POSES", help="Text file in hloc's format: lines of name qw qx qy qz tx ty tz."
        ),
    ],
    reference: Annotated[
        list[Path],
        typer.Option(
            metavar="DATASET",
            help="Data set of the photographs, as for evaluate; repeat the option for several.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="RESULTS", help="Folder for <dataset>/<method>.json.")
    ],
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Name of the method; by default the name of the file."),
    ] = None,
    start: Start = "none",
    as_json: Json = False,
) -> None:
    """Score poses that another program found.

    A query without a line counts as failed. The start is what you declare, and nothing verifies it:
    tables print it "as declared". Older results of the same name are replaced if score
    wrote them; those of evaluate never are.
    """
    from benchmark.evaluation.external_poses import score as run

    opened = open_distinct_datasets(reference)
    claim_folders(reference, out)
    name = poses.stem if method is None else method
    emit(_summarize(run(poses, opened, name, out, start)), as_json)


@app.command()
def submit(
    path: Annotated[
        Path, typer.Argument(metavar="CMU", help="Extended CMU Seasons, or one slice of it.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for submission.txt.")],
    method: Method = "sift",
    overrides: Settings = None,
    cache: Cache = None,
    as_json: Json = False,
) -> None:
    """Write the poses of all query images in the format of visuallocalization.net.

    An interrupted run goes on after the last finished slice.
    """
    from benchmark.evaluation.submission import SUBMISSION
    from benchmark.evaluation.submission import submit as run
    from objconnect.methods import create

    claim_folders([path], out, cache)
    localized, images = run(path, create(method, parse_settings(overrides)), out, cache)
    text = f"{out / SUBMISSION}: {localized} of {images} images found"
    values = {"submission": str(out / SUBMISSION), "images": images, "found": localized}
    emit(Summary(text, values), as_json)


def _summarize(results: list[Path]) -> Summary:
    """Return the report of a command that wrote results files: their names and their tables."""
    from benchmark.report.markdown import markdown
    from benchmark.report.tables import tables

    boards = tables(results)
    values = {"results": [str(path) for path in results], "tables": boards}
    return Summary(markdown(boards), values)
