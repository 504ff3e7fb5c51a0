"""Strict readers of CSV tables; every error names file and line."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import read_text


def read_table(
    path: Path, what: str, columns: Sequence[str]
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the location of each row of a CSV file, as ``file:line``, and its values by column.

    The table may have further columns. White space around values and blank lines are ignored.

    Args:
        path: file to read.
        what: noun for the file in messages.
        columns: required columns.

    Raises:
        InputError: the file is unreadable, a column is missing or named twice, a row has more or
            fewer values than the header, or a value is longer than the csv module allows. The
            last two also happen where a quote is never closed.
    """
    rows = csv.reader(io.StringIO(read_text(path, what), newline=""))
    line = 1
    try:
        header = [name.strip() for name in next(rows, [])]
        missing = [column for column in columns if column not in header]
        if missing:
            require_commas(header, f"{path}:1: {what}")
            raise InputError(f"{path}:1: {what} lacks the column {', '.join(missing)}")
        twice = [name for name, count in Counter(header).items() if name and count > 1]
        if twice:
            raise InputError(f"{path}:1: {what} has the column {twice[0]!r} twice")
        line = rows.line_num + 1
        for values in rows:
            where, is_multiline, line = f"{path}:{line}", rows.line_num > line, rows.line_num + 1
            if not any(values):
                continue
            if len(values) != len(header):
                hint = ": a quote may be unclosed" if is_multiline else ""
                raise InputError(
                    f"{where}: expected {len(header)} columns, got {len(values)}{hint}"
                )
            yield where, dict(zip(header, (value.strip() for value in values), strict=True))
    except csv.Error as error:
        raise InputError(f"{path}:{line}: {error}: a quote may be unclosed") from None


def read_header(path: Path, what: str) -> list[str]:
    """Return the column names of a CSV file.

    Args:
        path: file to read.
        what: noun for the file in messages.

    Raises:
        InputError: the file is unreadable, or its columns are not separated by commas.
    """
    try:
        header = next(csv.reader(io.StringIO(read_text(path, what), newline="")), [])
    except csv.Error as error:
        raise InputError(f"{path}:1: {error}: a quote may be unclosed") from None
    require_commas(header, f"{path}:1: {what}")
    return [name.strip() for name in header]


def require_commas(header: Sequence[str], what: str) -> None:
    """Refuse a header with semicolons or tabs as separators.

    Args:
        header: column names, split at commas.
        what: beginning of the message.

    Raises:
        InputError: the header has one name with semicolons or tabs.
    """
    if len(header) == 1 and any(separator in header[0] for separator in ";\t"):
        raise InputError(f"{what} has other separators than commas: use commas")
