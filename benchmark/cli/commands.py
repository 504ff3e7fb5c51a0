"""The list of all commands, and the group that loads each from its module."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Any, Final

from typer.main import get_group

from benchmark.cli.boundary import Boundary

COMMANDS: Final[Mapping[str, Mapping[str, str]]] = {
    "simulation": {
        "simulate": "Render a scene with exact camera poses.",
        "track": "Render and map the sites of a benchmark track, or check its flights.",
        "calibrate": "Calibrate the simulated camera from rendered chessboards.",
    },
    "scenes": {
        "ingest": "Turn a folder of photographs with GPS positions into a scene.",
        "export": "Write the poses and cameras of a scene in the format of another program.",
        "publish": "Write scenes as a data set for a data hub, with a card and metadata.",
        "validate": "Check the conventions and the exactness of a scene or a flight.",
        "audit": "Check the poses of any data set against its photographs, without ground truth.",
    },
    "maps": {
        "map": "Build the sparse map of a scene, or of an orthophoto with a surface model.",
        "landmarks": "Find the objects in a map: cars, trees, roofs, lamps and the like.",
        "dense": "Estimate depth maps of a map's photographs and fuse them into a point cloud.",
        "diagnose": "Report which objects in a map's photographs have points in the map.",
        "supplement": "Add points on small standing objects that have none in the map.",
    },
    "localization": {
        "localize": "Find the poses of new photographs, or of the frames of a video, in a map.",
        "evaluate": "Localize the queries of data sets and score the poses.",
        "basin": "Measure how recall falls with the error of the prior pose.",
        "score": "Score the poses that another program estimated.",
    },
    "submissions": {
        "submit": "Write the poses of all queries, to hand them in.",
        "submission": "Check a submission to a track, and score its poses without photographs.",
    },
    "methods": {
        "options": "List the options of a localizer with their defaults.",
        "train": "Train a method on rendered scenes, or resume its training.",
        "publish-weights": "Write weights as a model for a hub, with a card and results.",
    },
    "planning": {
        "forecast": "Forecast where along a flight a method finds a fix, by season and light.",
    },
    "reports": {
        "leaderboard": "Compare results in one table per data set and starting information.",
        "gate-scene": "Write a small flight data set that comes with the package.",
        "regress": "Compare results with recorded ones and exit with 1 if a metric dropped.",
        "view": "Write a scene as an interactive page and as a picture.",
    },
    "environment": {
        "doctor": "Report what is installed, what is missing and how to install it.",
    },
}
"""The commands of each module of this package, with the first sentence of their help."""


class CommandGroup(Boundary):
    """The group of all commands in ``COMMANDS``.

    A command's module is imported when the command is used; the help of the group imports none.
    """

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = _LoadedCommands()

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section of the help for each module of commands."""
        width = max(len(name) for name in self.commands)
        for module, summaries in COMMANDS.items():
            with formatter.section(module.capitalize()):
                formatter.write_dl([(name.ljust(width), text) for name, text in summaries.items()])


class _LoadedCommands(Mapping[str, Any]):
    """The commands by name; looking one up imports its module."""

    def __getitem__(self, name: str) -> Any:
        for module, summaries in COMMANDS.items():
            if name in summaries:
                return _commands_in(module)[name]
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        for summaries in COMMANDS.values():
            yield from summaries

    def __len__(self) -> int:
        return sum(len(summaries) for summaries in COMMANDS.values())


@cache
def _commands_in(module: str) -> Mapping[str, Any]:
    return get_group(import_module(f"benchmark.cli.{module}").app).commands
