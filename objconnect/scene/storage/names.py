"""Quoting of image names in text files.

A name is written in double quotes with JSON's escapes in ASCII if it contains white space, a
control character or a byte that is not UTF-8, or begins with ``#`` or a quote. All other names are
written unchanged, as in hloc.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Final

_JSON: Final = json.JSONDecoder()
_WORD: Final = re.compile(r"\S+")
# Spreadsheets evaluate cells that begin like this as formulas.
_FORMULA: Final = ("=", "+", "-", "@")


def is_utf8(name: str) -> bool:
    """Return whether a name is UTF-8; Python represents other bytes of names by surrogates."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def quote_name(name: str) -> str:
    """Return a name as one word of a line, quoted if necessary.

    Examples:
        >>> quote_name("a.jpg"), quote_name("my photo.jpg")
        ('a.jpg', '"my photo.jpg"')
    """
    plain = name.isprintable() and " " not in name and not name.startswith(("#", '"'))
    return name if name and plain else json.dumps(name)


def quote_cell(name: str) -> str:
    """Return a name as a cell of a table, quoted if necessary; spaces inside need no quotes."""
    plain = name.isprintable() and name == name.strip() and not name.startswith(('"', *_FORMULA))
    return name if name and plain else json.dumps(name)


def unquote_cell(text: str) -> str:
    """Return the name in a cell that ``quote_cell`` or another program wrote.

    Raises:
        ValueError: the quoting is not JSON's, or a line break is outside quotes.
    """
    if text.startswith('"'):
        name, end = _parse_quoted(text, 0)
        if end < len(text):
            raise ValueError(f"{text!r} continues after its closing quote")
        return name
    if any(character in text for character in "\n\r\0"):
        raise ValueError(f"{text[:40]!r} is not a name: a quote may be missing")
    return text


def name_some(names: Sequence[str], most: int = 3) -> str:
    """Return the first names in one phrase, and the number of the others.

    Examples:
        >>> name_some(["a.jpg", "b.jpg", "c.jpg", "d.jpg"])
        'a.jpg, b.jpg, c.jpg and 1 more'
    """
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def split_words(line: str) -> list[str]:
    """Split a line into words; words in quotes are names that ``quote_name`` wrote.

    Raises:
        ValueError: the quoting is not JSON's.

    Examples:
        >>> split_words('"my photo.jpg" 1.5 2')
        ['my photo.jpg', '1.5', '2']
    """
    parts, offset = [], 0
    while (word := _WORD.search(line, offset)) is not None:
        text, offset = word.group(), word.end()
        if text.startswith('"'):
            text, offset = _parse_quoted(line, word.start())
        parts.append(text)
    return parts


def split_name(line: str, columns: int) -> tuple[str, list[str]]:
    """Split a line into a name and the words after it.

    A name without quotes may contain spaces.

    Args:
        line: non-empty line.
        columns: number of words after the name.

    Raises:
        ValueError: the quoting is not JSON's, or the number of words differs.
    """
    if line.startswith('"'):
        name, end = _parse_quoted(line, 0)
        rest = line[end:].split()
    else:
        name, *rest = line.rsplit(maxsplit=columns)
        # If the last of several words of a name is a number, the line probably has one column too
        # many.
        if name != (words_of := name.split())[0] and _is_number(words_of[-1]):
            rest = line.split()[1:]
    if len(rest) != columns:
        raise ValueError(f"got {1 + len(rest)}")
    return name, rest


def _parse_quoted(line: str, start: int) -> tuple[str, int]:
    """Return the quoted word that begins at ``start``, and the offset of its end."""
    try:
        name, end = _JSON.raw_decode(line, start)
    except ValueError:
        raise ValueError(f"{line[start : start + 40]!r} is not closed, or is not JSON") from None
    if end < len(line) and not line[end].isspace():
        raise ValueError(f"{line[start : end + 1]!r} continues after its closing quote")
    return str(name), end


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
