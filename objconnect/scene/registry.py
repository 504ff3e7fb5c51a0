"""Registries of entries that are chosen by name, built in or added by an installed package.

A registry lists its built-in entries in a fixed order and imports an entry when it is first used.
An installed package adds an entry by an entry point in its ``pyproject.toml``::

    [project.entry-points."objconnect.exports"]
    mine = "my_package.my_format:write"

A built-in entry takes precedence over an entry point of the same name.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar, cast

from objconnect.scene.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Lazy:
    """A built-in entry that is imported when it is first used.

    Attributes:
        target: "module:attribute".
        summary: phrase beside the name in the command line's help.
    """

    target: str
    summary: str = ""

    def load(self) -> Any:
        """Import the module and return its attribute."""
        module, _, attribute = self.target.partition(":")
        return getattr(import_module(module), attribute)


@lru_cache(maxsize=64)
def _list_entry_points(group: str, folders: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    """Return the entry points of a group by name; if two have one name, the first that is found.

    The result is cached, because reading the metadata of all installed packages takes 20 ms, and
    opening a data set needs it. A running process does not see packages that are installed
    meanwhile.

    Args:
        group: group of the entry points.
        folders: ``sys.path``, part of the cache's key: a changed path is searched again.
    """
    return {each.name: each for each in reversed(tuple(entry_points(group=group)))}


@dataclass(eq=False)
class Registry(Mapping[str, T], Generic[T]):
    """Entries of one kind by name.

    Built-in names come first in their order, then those of installed packages, sorted.

    Attributes:
        kind: noun for an entry in error messages, for example "format".
        group: group of the entry points of installed packages.
        built_in: entries of the project, in listing order.
        accepts: returns whether the object of an entry point is a valid entry.
        unknown_message: error message for an unknown name, with the fields ``kind``, ``name``
            and ``names``.
    """

    kind: str
    group: str
    built_in: Mapping[str, Lazy | T]
    accepts: Callable[[Any], bool] = callable
    unknown_message: str = "unknown {kind} {name!r}: choose one of {names}"

    def __iter__(self) -> Iterator[str]:
        added = _list_entry_points(self.group, tuple(sys.path)).keys() - self.built_in.keys()
        return iter((*self.built_in, *sorted(added)))

    def __len__(self) -> int:
        return sum(1 for _ in self)  # tuple(self) would ask for the length

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (
            name in self.built_in or self.entry_point(name) is not None
        )

    def __getitem__(self, name: str) -> T:
        if name not in self:
            raise KeyError(name)
        return self.load(name)

    def entry_point(self, name: str) -> EntryPoint | None:
        """Return the entry point that adds a name, or None for built-in and unknown names."""
        if name in self.built_in:
            return None
        return _list_entry_points(self.group, tuple(sys.path)).get(name)

    def load(self, name: str, failure: str = "cannot be loaded") -> T:
        """Import and return an entry.

        Args:
            name: name of the entry.
            failure: verb phrase of the error message if the import fails.

        Raises:
            InputError: the name is unknown, its entry point cannot be imported, or the imported
                object is not of this registry's kind.
        """
        if name in self.built_in:
            entry = self.built_in[name]
            return cast("T", entry.load()) if isinstance(entry, Lazy) else entry
        entry_point = self.entry_point(name)
        if entry_point is None:
            names = ", ".join(self)
            raise InputError(self.unknown_message.format(kind=self.kind, name=name, names=names))
        with self.convert_errors(name, failure):
            loaded = entry_point.load()
        if not self.accepts(loaded):
            raise InputError(
                f"{self.kind} {name!r} ({entry_point.value}) {failure}: {entry_point.value} is of "
                f"type {type(loaded).__name__}"
            )
        return cast("T", loaded)

    def summaries(self) -> dict[str, str]:
        """Return the help phrases of the built-in entries by name."""
        lazy = {name: entry for name, entry in self.built_in.items() if isinstance(entry, Lazy)}
        return {name: entry.summary for name, entry in lazy.items() if entry.summary}

    @contextmanager
    def convert_errors(self, name: str, failure: str) -> Iterator[None]:
        """Turn any exception of an installed package's entry into an InputError that names it.

        Exceptions of built-in entries pass through.

        Args:
            name: name of the entry that the ``with`` block uses.
            failure: verb phrase of the message, for example "cannot be loaded".

        Raises:
            InputError: the entry is of an installed package and the block raised.
        """
        try:
            yield
        except InputError:
            raise
        except Exception as error:
            entry_point = self.entry_point(name)
            if entry_point is None:
                raise
            raise InputError(
                f"{self.kind} {name!r} ({entry_point.value}) {failure}: "
                f"{type(error).__name__}: {error}"
            ) from error
