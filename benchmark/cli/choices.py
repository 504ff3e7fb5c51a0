"""Options of the command line that take a name from a registry.

The help lists the built-in names. Names that installed packages add are looked up only when the
option is used, so that the help is printed at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer

from objconnect.scene.registry import Registry


def list_choices(registry: Registry[Any]) -> str:
    """Return the built-in names as the placeholder of an option: "<colmap|tum>"."""
    return f"<{'|'.join(registry.built_in)}>"


def describe_choices(registry: Registry[Any]) -> str:
    """Return help that explains every built-in name by its summary."""
    return " ".join(f"{name}: {summary}." for name, summary in registry.summaries().items())


def restrict_to(registry: Registry[Any]) -> Callable[[str | None], str | None]:
    """Return the callback of an option that accepts only the names of a registry.

    The callback raises ``typer.BadParameter`` for any other name; the message lists all names,
    including those of installed packages.
    """

    def check(name: str | None) -> str | None:
        if name is not None and name not in registry:
            names = ", ".join(repr(known) for known in registry)
            raise typer.BadParameter(f"{name!r} is not one of {names}.")
        return name

    return check
