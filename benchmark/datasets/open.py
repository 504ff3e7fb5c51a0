"""The readers of data sets by name, and the opening of any data set."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Protocol, runtime_checkable

from benchmark.datasets.dataset import Dataset
from objconnect.scene.errors import InputError
from objconnect.scene.registry import Lazy, Registry


@runtime_checkable
class Reader(Protocol):
    """Reads one kind of data set."""

    @property
    def name(self) -> str:
        """Name of the kind, as in the registry."""
        ...

    @property
    def holds(self) -> str:
        """Phrase for error messages: the files of the folder, then the kind in parentheses."""
        ...

    def recognizes(self, path: Path) -> bool:
        """Return whether a path is a data set of this kind, whether or not it is complete."""
        ...

    def open(self, path: Path) -> list[Dataset]:
        """Open a path that ``recognizes`` accepts.

        Raises:
            InputError: a file is missing or wrong.
        """
        ...


# Readers are tried in this order. A slice of Extended CMU Seasons has a folder "sparse", as a
# flight has, so that flights come after it.
READERS: Final[Registry[Reader]] = Registry(
    "reader",
    "objconnect.datasets",
    {
        "published": Lazy("benchmark.publishing.reader:READER"),
        "scene": Lazy("benchmark.datasets.simulated:READER"),
        "cmu": Lazy("benchmark.datasets.cmu:READER"),
        "flight": Lazy("benchmark.datasets.flight:READER"),
        "aerialextrematch": Lazy("benchmark.datasets.aerialextrematch:READER"),
    },
    accepts=lambda reader: isinstance(reader, Reader),
)


def open_datasets(path: Path) -> list[Dataset]:
    """Open the data sets of a path with the first reader that supports it.

    A scene is one data set, and a published folder or ``hf://OWNER/NAME@COMMIT`` one for each of
    its scenes. A flight is one, or two with its hard split, whose name ends in
    ``-sparse``; a path with that ending opens the hard split alone. Extended CMU Seasons is one
    data set for each slice with public query poses; the folder of a slice opens that slice alone.
    AerialExtreMatch-Localization is one data set for each quality that has a map.

    A package adds a reader by an entry point of the group ``objconnect.datasets``: an object with
    the attributes of ``Reader``.

    Raises:
        InputError: the path does not exist, no reader supports it, or anything inside it is wrong.
    """
    reader = require_reader(path)
    with READERS.convert_errors(reader.name, f"cannot read {path}"):
        return reader.open(path)


def require_reader(path: Path) -> Reader:
    """Return the first reader that supports a path.

    Raises:
        InputError: the path does not exist, or no reader supports it.
    """
    reader = reader_of(path)
    if reader is not None:
        return reader
    if not path.exists():
        raise InputError(f"data set {path} does not exist: check the path")
    kinds = ", nor ".join(READERS.load(name).holds for name in READERS)
    raise InputError(f"{path} is not a data set: it has neither {kinds}")


def reader_of(path: Path) -> Reader | None:
    """Return the first reader that supports a path; None if there is none."""
    for name in READERS:
        reader = READERS.load(name)
        with READERS.convert_errors(name, f"cannot read {path}"):
            if reader.recognizes(path):
                return reader
    return None
