"""Commands that write poses to hand in, and that check and score them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from benchmark.cli.arguments import check_folders, list_given_options, parse_settings
from benchmark.cli.boundary import INPUT_AT_FAULT
from benchmark.cli.options import Cache, Jobs, Json, Method, Settings, Start
from benchmark.cli.output import Summary, emit
from objconnect.scene.errors import InputError

app = typer.Typer(rich_markup_mode=None)

Pairs = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="For Extended CMU Seasons: pair list of hloc, lines 'query reference' for every test "
        "image. By default the method retrieves map photographs itself, for all query images.",
    ),
]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="For Extended CMU Seasons: write nothing, and list the files that are missing.",
    ),
]

# Options that only Extended CMU Seasons takes, and what to do on other data sets.
_FOR_CMU: Final = {
    "--pairs": "give --start pairs=FILE",
    "--dry-run": "leave it out",
}


@app.command()
# More than six parameters: each is an option or argument of the command.
def submit(
    context: typer.Context,
    path: Annotated[
        Path,
        typer.Argument(
            metavar="DATASET",
            help="Data set of a track, whose query poses may be withheld; or Extended CMU Seasons, "
            "or one slice of it.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder for poses/<dataset>.txt, or submission.txt of CMU Seasons."
        ),
    ],
    method: Method = "sift",
    overrides: Settings = None,
    start: Start = "prior",
    pairs: Pairs = None,
    jobs: Jobs = 1,
    cache: Cache = None,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Write the poses of all queries, to hand them in.

    The file of a data set of a track is part of a submission. The file of Extended CMU Seasons has
    the format of visuallocalization.net. The same command continues an interrupted run. A folder
    holds the poses of one method with one --start and one set of options; give another --out for
    any other.

    Extended CMU Seasons takes no --start, and only it takes --pairs and --dry-run. --dry-run prints
    everything that is missing from the data set and the pairs, and what to do about it, and exits
    with 2 if anything is missing.
    """
    from benchmark.datasets.open import reader_of, require_reader
    from benchmark.evaluation.starts import parse_start
    from benchmark.evaluation.submission import SUBMISSION, check_submission
    from benchmark.evaluation.submission import submit as run
    from benchmark.submissions.answers import write_answers
    from objconnect.methods import create

    check_folders([path], out, cache)
    localizer = create(method, parse_settings(overrides))
    given = list_given_options(context)
    # A dry run also reports on a download of Extended CMU Seasons that lacks almost everything.
    reader = reader_of(path) if dry_run else require_reader(path)
    if reader is not None and reader.name != "cmu":
        for option in (option for option in given if option in _FOR_CMU):
            raise InputError(
                f"{option} is for Extended CMU Seasons, and {path} is not: {_FOR_CMU[option]}"
            )
        emit(write_answers(path, localizer, out, parse_start(start), cache, jobs), as_json)
        return
    if "--start" in given:
        raise InputError(
            f"{path} is read as Extended CMU Seasons, which has no starts: leave out --start"
        )
    if dry_run:
        report = check_submission(path, pairs)
        emit(report, as_json)
        if not report.ok:
            raise typer.Exit(INPUT_AT_FAULT)
        return
    localized, images = run(path, localizer, out, pairs=pairs, cache=cache, jobs=jobs)
    text = f"{out / SUBMISSION}: {localized} of {images} images found"
    values = {"submission": str(out / SUBMISSION), "images": images, "found": localized}
    emit(Summary(text, values), as_json)


@app.command()
def submission(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Folder with card.yaml and poses/<dataset>.txt."),
    ],
    board: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of tracks; by default the tracks of the project."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check a submission to a track, and score its poses without photographs.

    Refuses damaged files, poses of data sets that the track does not record, and the method name or
    the poses of another submission. A query without a pose counts as failed.
    """
    from benchmark.submissions.command import submission as run
    from benchmark.tracks.description import TRACKS_FOLDER

    emit(run(folder, board or TRACKS_FOLDER), as_json)
