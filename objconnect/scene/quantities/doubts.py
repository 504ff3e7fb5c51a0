"""Summary of the doubts (warnings about metadata) of many files in a few lines."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from objconnect.scene.runtime.escaping import for_terminal

# Largest number of kinds of doubts that are listed.
_MAX_KINDS: Final = 8


def summarize_doubts(doubts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return a line for each kind of doubt, with the first file that has it.

    Doubts that differ only in numbers are of one kind.

    Args:
        doubts: phrases of ``Reading.doubts`` by name of the file.

    Examples:
        >>> doubt = "GPSAltitude is missing"
        >>> summarize_doubts({"a.jpg": [doubt], "b.jpg": [doubt]})
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
    for kind, (name, phrase) in list(first.items())[:_MAX_KINDS]:
        more = f" and {count[kind] - 1} more" if count[kind] > 1 else ""
        lines.append(f"{for_terminal(name)}{more}: {for_terminal(phrase)}")
    left = len(first) - len(lines)
    return [*lines, f"{left} more kinds of doubts"] if left > 0 else lines
