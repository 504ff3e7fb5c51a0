"""Reading of a track's list of the queries of a data set, ``queries/<dataset>.csv``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from benchmark.tracks.difficulty import Difficulty, QueryRow
from objconnect.scene.bundle.manifest import ALL_CONDITIONS
from objconnect.scene.errors import InputError
from objconnect.scene.storage.tables import read_table

SAME: Final = "same"
"""Name of the queries under the map's own condition; no condition may have this name."""
CHANGED: Final = "changed"
"""Name of the queries under all other conditions; no condition may have this name."""
SEEN: Final = "seen"
"""Name of the queries whose condition and kind of place are not held out of training."""
UNSEEN: Final = ("unseen-condition", "unseen-place", "unseen-both")
"""Names of the queries whose condition, kind of place or both are held out of training; no
condition may have these names."""

_RESERVED: Final = (ALL_CONDITIONS, SAME, CHANGED, SEEN, *UNSEEN)
_COLUMNS: Final = (*QueryRow._fields[:-1], *Difficulty._fields)
_MOST_DAYS: Final = 182
# A scale above this means that the file is damaged.
_MOST_SCALE: Final = 1e6


def read_queries(path: Path) -> tuple[QueryRow, ...]:
    """Read the list that ``benchmark.tracks.difficulty.write_queries`` wrote.

    Raises:
        InputError: the file cannot be read, a column is missing, a query is listed twice, or a
            value is empty or impossible; the message names the line.
    """
    rows: dict[str, QueryRow] = {}
    for where, values in read_table(path, "list of a track's queries", _COLUMNS):
        row = _row(where, values)
        if row.name in rows:
            raise InputError(f"{where}: query {row.name} is listed twice")
        rows[row.name] = row
    if not rows:
        raise InputError(f"{path} lists no query: record them with 'objconnect track --update'")
    return tuple(rows.values())


def _row(where: str, values: Mapping[str, str]) -> QueryRow:
    for column in ("name", "condition", "flight", "part"):
        if not values[column]:
            raise InputError(f"{where}: the {column} is empty: fill it in")
        if not values[column].isprintable():
            raise InputError(
                f"{where}: the {column} {values[column]!r} has a control character: remove it"
            )
    for column, reserved in (("condition", _RESERVED), ("part", ("all",))):
        if values[column] in reserved:
            raise InputError(
                f"{where}: the {column} {values[column]!r} is a reserved name: choose another"
            )
    overlap = _number(where, values, "overlap", 1)
    if overlap is None:
        raise InputError(f"{where}: the overlap is empty: give a share from 0 to 1")
    days = _number(where, values, "days", _MOST_DAYS)
    difficulty = Difficulty(
        overlap,
        _number(where, values, "scale", _MOST_SCALE),
        _number(where, values, "angle_deg", 180),
        None if days is None else round(days),
    )
    return QueryRow(
        values["name"], values["condition"], values["flight"], values["part"], difficulty
    )


def _number(where: str, values: Mapping[str, str], column: str, maximum: float) -> float | None:
    """Return a number from 0 to ``maximum``; None for an empty cell."""
    text = values[column]
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 <= number <= maximum:
        raise InputError(f"{where}: {column} {text!r} is not a number from 0 to {maximum:g}")
    return number
