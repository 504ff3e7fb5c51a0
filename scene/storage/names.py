"""Names of photographs in text files, of which a file system allows more than a line does.

A name that would not stand for itself is written in double quotes with JSON's escapes, all ASCII:
one with white space, a control character, a byte that is not UTF-8, or a leading ``#`` or quote.
No name can end its line, or begin another. Other names stand as they are, as hloc's.
"""

from __future__ import annotations

import json
import re
from typing import Final

_JSON: Final = json.JSONDecoder()
_WORD: Final = re.compile(r"\S+")
# A spreadsheet takes cells that begin so for formulas.
_FORMULA: Final = ("=", "+", "-", "@")


def is_utf8(name: str) -> bool:
    """Whether a name is text: a file system also allows bytes that are none, which Python holds as
    halves of surrogates."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def written(name: str) -> str:
    """A name as one word of a line."""
    plain = name.isprintable() and " " not in name and not name.startswith(("#", '"'))
    return name if name and plain else json.dumps(name)


def written_cell(name: str) -> str:
    """A name as a cell of a table, where spaces within are no harm."""
    plain = name.isprintable() and name == name.strip() and not name.startswith(('"', *_FORMULA))
    return name if name and plain else json.dumps(name)


def from_cell(text: str) -> str:
    """The name in a cell that ``written_cell``, or another program, wrote.

    Raises:
        ValueError: a quote that is none of JSON's, or a line break outside of one.
    """
    if text.startswith('"'):
        name, end = _quoted(text, 0)
        if end < len(text):
            raise ValueError(f"{text!r} goes on after its closing quote")
        return name
    if any(character in text for character in "\n\r\0"):
        raise ValueError(f"{text[:40]!r} is no name: is a quote missing?")
    return text


def words(line: str) -> list[str]:
    """The words of a line; those in quotes are names that ``written`` wrote.

    Raises:
        ValueError: a quote that is none of JSON's.
    """
    found, at = [], 0
    while (word := _WORD.search(line, at)) is not None:
        text, at = word.group(), word.end()
        if text.startswith('"'):
            text, at = _quoted(line, word.start())
        found.append(text)
    return found


def leading_name(line: str, columns: int) -> tuple[str, list[str]]:
    """The name that a line begins with, and the words after it.

    A name without quotes may hold spaces where so many columns follow it.

    Args:
        line: not empty.
        columns: after the name.

    Raises:
        ValueError: a quote that is none of JSON's, or another number of columns.
    """
    if line.startswith('"'):
        name, end = _quoted(line, 0)
        rest = line[end:].split()
    else:
        name, *rest = line.rsplit(maxsplit=columns)
        # A name whose last word is a number is more likely a column too many.
        if name != (words_of := name.split())[0] and _is_number(words_of[-1]):
            rest = line.split()[1:]
    if len(rest) != columns:
        raise ValueError(f"got {1 + len(rest)}")
    return name, rest


def _quoted(line: str, start: int) -> tuple[str, int]:
    """The quoted word that begins there, and where it ends."""
    try:
        name, end = _JSON.raw_decode(line, start)
    except ValueError:
        raise ValueError(f"{line[start : start + 40]!r} is not closed, or is no JSON") from None
    if end < len(line) and not line[end].isspace():
        raise ValueError(f"{line[start : end + 1]!r} goes on after its closing quote")
    return str(name), end


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
