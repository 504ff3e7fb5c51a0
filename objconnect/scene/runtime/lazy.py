"""Attributes of a package that are imported on demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any


def lazy_attributes(
    package: str, targets: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions ``__getattr__`` and ``__dir__`` of a package.

    Args:
        package: name of the package.
        targets: module of each attribute; "module:name" where the name differs.

    Examples:
        >>> get, names = lazy_attributes("geometry", {"root": "math:sqrt", "pi": "math"})
        >>> get("root")(9), names()
        (3.0, ['pi', 'root'])
        >>> get("tau")
        Traceback (most recent call last):
        AttributeError: module 'geometry' has no attribute 'tau'
    """

    def get(name: str) -> Any:
        if name not in targets:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, attribute = targets[name].partition(":")
        return attrgetter(attribute or name)(import_module(module))

    return get, lambda: sorted(targets)
