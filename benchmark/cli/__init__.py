"""The command line ``objconnect``.

Each group of commands is a module of this package, listed in ``benchmark.cli.commands``. A module
is imported only when one of its commands is used, so that the help and the error of a mistyped
command are printed at once.
"""

from __future__ import annotations

import logging
from typing import Annotated

import typer

from benchmark.cli.boundary import PrintedFormatter
from benchmark.cli.commands import CommandGroup
from objconnect.scene.runtime.tuning import ProcessTuning

app = typer.Typer(
    name="objconnect",
    cls=CommandGroup,
    help="Simulate, build and compare 6-DoF localization of UAV cameras across seasons.",
    epilog="Exit codes: 0 done, 1 regression found, 2 the input or the environment is at fault, "
    "3 a fault of the program.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """Run the command line in a process of its own; the console script enters here."""
    with ProcessTuning():
        app()


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"objconnect {version('objconnect')}")
        except PackageNotFoundError:
            print("objconnect, not installed as a package")
        raise typer.Exit


@app.callback()
def _set_up(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", is_eager=True, callback=_print_version
        ),
    ] = False,
) -> None:
    """Send warnings to standard error, one line each."""
    handler = logging.StreamHandler()
    handler.setFormatter(PrintedFormatter())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
