"""Doubts of many files as a few lines."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from objconnect.scene.runtime.escaping import for_terminal

# Most kinds of doubts that are told one by one.
_SHOWN: Final = 8


def said_of(doubts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the doubts of files, a line for each kind with the file that first had it.

    Doubts that differ in their numbers alone are of one kind.

    Example:
        >>> said_of({"a.jpg": ["GPSAltitude is missing"], "b.jpg": ["GPSAltitude is missing"]})
        ['a.jpg and 1 more: GPSAltitude is missing']
    """
    first: dict[str, tuple[str, str]] = {}
    count: dict[str, int] = {}
    for name, phrases in doubts.items():
        for phrase in phrases:
            kind = re.sub(r"\d+(\.\d+)?", "#", phrase)
            first.setdefault(kind, (name, phrase))
            count[kind] = count.get(kind, 0) + 1
    lines = []
    for kind, (name, phrase) in list(first.items())[:_SHOWN]:
        more = f" and {count[kind] - 1} more" if count[kind] > 1 else ""
        lines.append(f"{for_terminal(name)}{more}: {for_terminal(phrase)}")
    left = len(first) - len(lines)
    return [*lines, f"{left} more kinds of doubts"] if left > 0 else lines
