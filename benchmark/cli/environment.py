"""The command about the installation itself."""

from __future__ import annotations

import typer

from benchmark.cli.boundary import INPUT_AT_FAULT
from benchmark.cli.options import Json
from benchmark.cli.output import emit

app = typer.Typer(rich_markup_mode=None)


@app.command()
def doctor(as_json: Json = False) -> None:
    """Report what is installed, what is missing and how to install it.

    Use it after installing, or if a command reports that something is missing. Exits with 2 if a
    requirement is not met. If this command itself cannot start, run python -m benchmark.doctor.
    """
    from benchmark.doctor import doctor as run

    diagnosis = run()
    emit(diagnosis, as_json)
    if not diagnosis.ok:
        raise typer.Exit(INPUT_AT_FAULT)
