"""Commands that localize new photographs or the queries of data sets, and that score poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.arguments import (
    check_folders,
    check_jobs,
    check_methods,
    create_with_risk,
    open_distinct_datasets,
    parse_camera,
    parse_crs,
    parse_settings,
)
from benchmark.cli.localize_options import (
    AdditionalOutputs,
    Crs,
    GimbalSigma,
    GpsSigma,
    Images,
    Poses,
    Priors,
    Rate,
    Sequenced,
    Subtitles,
    Undulation,
    VideoFile,
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


ContainerImage = Annotated[
    str | None,
    typer.Option(
        metavar="IMAGE", help="Docker image of a program that finds the poses, instead of a method."
    ),
]


@app.command()
# More than six parameters: each is an option or argument of the command.
def localize(
    source: Annotated[
        Path, typer.Option("--map", metavar="MAP", help="Scene with its map, or a flight.")
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
    also: AdditionalOutputs = None,
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
    the probability that the pose is right, the camera that was used and, for photographs that are
    not localized or cannot be read, the reason.
    Without --camera, the calibration is the first of these that is known: the map's camera of the
    same size, the calibration in XMP, the map's camera scaled, the focal length in EXIF, an
    estimate. With a video or --sequence, each pose gives the prior of the next; a JSON file beside
    POSES records the method and its options. An interrupted run goes on where it stopped.
    """
    from objconnect.localization.pipeline import localize as job
    from objconnect.localization.pipeline.localization_map import open_map
    from objconnect.localization.pipeline.options import LocalizeOptions
    from objconnect.localization.pipeline.tracking import sequence_config

    queries = _choose_queries(images, video, srt, priors, sequence, rate)
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
    check_folders([source, queries], cache)
    localizer = create_with_risk(method, settings, risk)
    run = job.localize if video is None else job.localize_video
    answers = run(open_map(source), queries, localizer, out, options)
    localized = sum(answer.is_localized for answer in answers)
    unit = "photographs" if video is None else "frames"
    text = f"{out}: {localized} of {len(answers)} {unit} found"
    emit(Summary(text, {"poses": str(out), unit: len(answers), "found": localized}), as_json)


def _choose_queries(
    images: Path | None,
    video: Path | None,
    srt: Path | None,
    priors: Path | None,
    sequence: bool,
    rate: float | None,
) -> Path:
    """Return the folder of photographs or the video to localize.

    Raises:
        InputError: neither or both are given, or an option is for photographs and a video is given,
            or the reverse.
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
        raise InputError("--rate describes a sequence: give --sequence too")
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
    container: ContainerImage = None,
    as_json: Json = False,
) -> None:
    """Localize the queries of data sets and score the poses.

    Writes RESULTS/<dataset>/<method>.json, a picture of the query with the median error, and once
    per data set album.h5 with the pictures of the leaderboard's page. An interrupted run goes on
    where it stopped. Replaces older results of the same name unless score wrote them.

    With --container, a program in a container finds the poses. It reads /data and writes
    /output/poses.txt, without a network. --method is its name in the results, and --set takes its
    limits memory_gb, cpus and minutes. It starts again if interrupted.
    """
    from benchmark.containers.command import evaluate_container as run_image
    from benchmark.evaluation.evaluate import check_evaluation_outputs, results_path
    from benchmark.evaluation.evaluate import evaluate as run
    from benchmark.evaluation.starts import parse_start
    from objconnect.methods import create

    # All arguments and outputs are checked before the first query is localized.
    check_jobs(jobs, cluster)
    check_methods(method)
    settings = parse_settings(overrides)
    if container is not None:
        if len(method) > 1 or cache is not None or cluster is not None or jobs != 1:
            raise InputError(
                "--container runs one --method, and takes neither --cache, --jobs nor --cluster"
            )
        check_folders(datasets, out)
        opened = open_distinct_datasets(datasets)
        results = run_image(container, method[0], settings, opened, out, parse_start(start))
        emit(_summarize(results), as_json)
        return
    localizers = {name: create(name, settings) for name in method}
    starting_information = parse_start(start)
    opened = open_distinct_datasets(datasets)
    check_folders(datasets, out, cache)
    for dataset in opened:
        for localizer in localizers.values():
            check_evaluation_outputs(dataset, localizer, out)
    written = []
    for dataset in opened:
        for localizer in localizers.values():
            run(dataset, localizer, out, starting_information, cache, jobs, cluster)
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
            help="Sizes of the error, such as 1m/2deg,3m/5deg. By default six from 0m/0deg to "
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
    matches map photographs near it.
    """
    from benchmark.evaluation.basin import DEFAULT_ERRORS, basin_path, parse_errors
    from benchmark.evaluation.basin import basin as run
    from objconnect.methods import create

    check_methods(method)
    prior_errors = DEFAULT_ERRORS if errors is None else parse_errors(errors)
    settings = parse_settings(overrides)
    localizers = [create(name, settings) for name in method]
    opened = open_distinct_datasets(datasets)
    check_folders(datasets, out, cache)
    basins = {}
    for dataset in opened:
        for localizer in localizers:
            measured = run(dataset, localizer, out, prior_errors, seed, cache)
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
    """Score the poses that another program estimated.

    A query without a line counts as failed. Nothing verifies --start, the information that the
    program had on each query: tables print it "as declared". Replaces older results of the same
    name if score wrote them, and never results of evaluate.
    """
    from benchmark.evaluation.external_poses import score as run

    opened = open_distinct_datasets(reference)
    check_folders(reference, out)
    name = poses.stem if method is None else method
    emit(_summarize(run(poses, opened, name, out, start)), as_json)


def _summarize(results: list[Path]) -> Summary:
    """Return the summary of results files: their paths and their tables."""
    from benchmark.report.markdown import markdown
    from benchmark.report.tables import tables

    all_tables = tables(results)
    values = {"results": [str(path) for path in results], "tables": all_tables}
    return Summary(markdown(all_tables), values)
