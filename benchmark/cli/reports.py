"""Commands that compare and show results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmark.cli.boundary import REGRESSION
from benchmark.cli.options import Json, MappedScene
from benchmark.cli.output import Summary, emit
from objconnect.scene.errors import InputError

app = typer.Typer(rich_markup_mode=None)


@dataclass(frozen=True)
class _Leaderboard:
    """The leaderboard as Markdown; its tables are read again only for ``--json``."""

    results: Sequence[Path]
    markdown: str
    stored: Sequence[Path]

    def text(self) -> str:
        return "\n".join([self.markdown, *(f"stored {path}" for path in self.stored)])

    def as_dict(self) -> dict[str, Any]:
        from benchmark.report.tables import tables

        stored = {"stored": [str(path) for path in self.stored]} if self.stored else {}
        return {"tables": tables(self.results), **stored}


@app.command()
def leaderboard(
    results: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[RESULTS]", help="Results files, or folders that evaluate wrote."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for leaderboard.md, .tex and .html.")
    ] = None,
    board: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of tracks, whose stored results are shown instead of RESULTS; "
            "leaderboard.tex is not written.",
        ),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(
            metavar="TRACK",
            help="Folder of a track, such as benchmark/tracks/uav-seasons, to store RESULTS in: "
            "rounded and compressed to a tenth of their size, with the same figures.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare results in one table per data set and starting information.

    Prints Markdown. With --out, also writes it as LaTeX tables and as one HTML page that opens as a
    file, with charts, paired comparisons and every query. The page also shows the small pictures
    of queries and the basins of convergence that evaluate and basin wrote into the same folders.

    With --board, the queries of all data sets of a benchmark track are pooled by starting
    information, season and kind of site.
    """
    from benchmark.report.board.command import board as run_board
    from benchmark.report.leaderboard import leaderboard as run
    from benchmark.tracks.compact import store as store_results
    from benchmark.tracks.compact import targets_of

    if (board is None) == (not results):
        raise InputError("give either RESULTS or --board")
    if board is not None:
        if store is not None:
            raise InputError("--store stores RESULTS and --board shows stored ones: give one")
        emit(run_board(board, out), as_json)
        return
    paths = results or []
    targets = {} if store is None else targets_of(paths, store)
    text = run(paths, out)
    emit(_Leaderboard(paths, text, store_results(targets)), as_json)


@app.command()
def gate_scene(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the data set, new or empty.")
    ],
    name: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="gate: 90 queries of the map's season. gate-snow: 40 queries, 32 in snow.",
        ),
    ] = "gate",
    as_json: Json = False,
) -> None:
    """Write a small flight data set that comes with the package.

    It holds rendered photographs of a town, 256 x 192 pixels each: gate has 4.1 MB, gate-snow
    2.5 MB. Use it for a first evaluation, or in continuous integration before you have data of
    your own.
    """
    from benchmark.gate.scene import gate_scene as run

    dataset = str(run(out, name))
    emit(Summary(dataset, {"dataset": dataset}), as_json)


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
    """Compare results with recorded ones and exit with 1 if a metric dropped.

    The figures are recall, and integrity: the shares of queries without a false fix, without an
    answer wrong by more than 1 m, and without one worse than its prior. A drop is a missing query,
    or a loss that is significant in McNemar's exact test on the same queries, at 5 % over all
    comparisons of recall of a method on a data set, and at 5 % over those of integrity. Use it in
    continuous integration.
    """
    from benchmark.regression import regress as run
    from benchmark.regression import update as record

    if update:
        written = [str(path) for path in record(results, against)]
        emit(Summary("\n".join(written), {"written": written}), as_json)
        return
    comparisons = run(results, against)
    lines = [comparison.text() for comparison in comparisons]
    values = [comparison.as_dict() for comparison in comparisons]
    emit(Summary("\n".join(lines), {"comparisons": values}), as_json)
    if any(comparison.dropped for comparison in comparisons):
        raise typer.Exit(REGRESSION)


@app.command()
def view(
    scene: MappedScene,
    results: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RESULTS",
            help="Results file, or folder that evaluate wrote, whose poses of the scene's queries "
            "are shown; repeat the option for several.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="HTML", help="File for the page; by default SCENE/pictures/view.html."
        ),
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    as_json: Json = False,
) -> None:
    """Write a scene as an interactive page and as a picture.

    The page shows the cameras with their photographs, the points of the map and those added to it,
    the dense cloud, objects coloured by whether they have points of the map, and the estimated
    poses of the queries. It opens as a file, without a server or a network.
    """
    import webbrowser

    from benchmark.report.view import view as run

    written = run(scene, results or (), out)
    if show and not webbrowser.open(written.page.resolve().as_uri()):
        raise InputError(f"no browser was found: open {written.page} in one")
    page, picture = str(written.page), str(written.picture)
    emit(Summary(page, {"page": page, "picture": picture, "points": written.points}), as_json)
