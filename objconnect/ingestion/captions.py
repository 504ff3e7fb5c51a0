"""The words of a subtitle that a drone wrote: fields, numbers in parentheses, and short words.

A value is the whole text of a field. Nothing is cut from it here, so that a reader sees a unit, a
second number or a mark that it does not know.
"""

from __future__ import annotations

import html
import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.decimal_marks import DecimalMarks
from objconnect.scene.storage.subtitles import Subtitle

_TAG: Final = re.compile(r"<[^<>]*>|\{\\[^{}]*\}")
_PARENTHESES: Final = re.compile(r"(?<![\w.])([A-Za-z][\w.]*)\s{0,8}:?\s{0,8}\(([^()]{0,200})\)")
_FIELD: Final = re.compile(r"(?<![\w.-])([A-Za-z][\w-]*)\s{0,8}:")
# Words of compact subtitles, which have no colon. A field's value ends before them.
_SHORT: Final = r"(?:H\.S|V\.S|DZOOM|ISO|EV|SS|F/|GPS|RTK|HOME|[FG]\.PRY|H|D)"
_SHORT_WORD: Final = re.compile(r"(?<![\w.])(H\.S|DZOOM|H|D)[ \t]+(?=[-+\d])")
_END: Final = re.compile(rf"[\[\];\n|]|,\s*(?=[A-Za-z])|\s(?={_SHORT}(?:[\s(/]|$))")
# A longer value is no number, and is not cut to be one.
_LONGEST: Final = 200
_VALUE: Final = re.compile(r"([-+]?[\d.,]*\d[\d.,]*(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?")
_LETTER: Final = re.compile(r"(?:([NSEW])\s*:?\s*)?(.*?)\s*([NSEW])?")
# The second stands for a byte of another encoding.
DEGREE_SIGNS: Final = ("", "°", "\ufffd", "º", "deg", "degrees")
"""Marks after an angle in degrees."""


@dataclass(frozen=True)
class Caption:
    """What a subtitle says, in its own words.

    Attributes:
        subtitle: The subtitle.
        text: Its text without tags.
        fields: Texts of values by name in lower case, such as ``focal_len``, ``h.s`` or
            ``barometer``.
        tuples: Texts in parentheses by name in lower case, such as ``gps``.
    """

    subtitle: Subtitle
    text: str
    fields: Mapping[str, str]
    tuples: Mapping[str, str]

    @staticmethod
    def of(subtitle: Subtitle) -> Caption:
        """Take a subtitle apart.

        A value in a bracket that is not closed was cut short, and is left out. Of two values of one
        name that differ, neither is a number.
        """
        text = html.unescape(_TAG.sub(" ", subtitle.text)).replace("\xa0", " ")
        tuples = _unique((name.lower(), inner) for name, inner in _PARENTHESES.findall(text))
        plain = _PARENTHESES.sub(";", text)
        opened = plain.rfind("[")
        if opened > plain.rfind("]"):
            plain = plain[:opened]
        fields = _unique(_fields(plain))
        # ``BAROMETER(60.0)`` is a field in parentheses.
        fields |= {name: inner for name, inner in tuples.items() if name not in fields}
        return Caption(subtitle, text, fields, tuples)

    def numbers(self, *names: str) -> Iterator[str]:
        """Yield the texts of the numbers of some fields, and of those in parentheses."""
        for name in names:
            if name in self.fields and (found := _VALUE.fullmatch(self.fields[name].strip())):
                yield found[1]
        for inner in self.tuples.values():
            for part in parts_of(inner):
                if found := _VALUE.fullmatch(_without_letter(part)):
                    yield found[1]


def _unique(items: Iterator[tuple[str, str]] | list[tuple[str, str]]) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, text in items:
        text = text.strip()
        found[name] = text if found.get(name, text) == text else f"{found[name]} and {text}"
    return found


def _fields(text: str) -> Iterator[tuple[str, str]]:
    names = list(_FIELD.finditer(text))
    starts = [*(found.start() for found in names), len(text)]
    for found in (*names, *_SHORT_WORD.finditer(text)):
        after = starts[bisect_right(starts, found.start())]
        whole = after - found.end() <= _LONGEST
        value = text[found.end() : min(after, found.end() + _LONGEST)].lstrip(" \t")
        end = _END.search(value)
        value = (value[: end.start()] if end else value).rstrip(" \t,")
        yield found[1].lower(), value if end or whole else "..."


def parts_of(inner: str) -> list[str]:
    """Return the parts of a text in parentheses, as its own marks divide them.

    A comma divides numbers that have points. Where they have none, a comma before white space
    divides, and a comma between digits may be a decimal mark. One part is returned where the marks
    do not tell.

    Example:
        >>> parts_of("8.5,47.1,17"), parts_of("8,5000, 47,1000, 17"), parts_of("8,5,47,1,17")
        (['8.5', '47.1', '17'], ['8,5000', '47,1000', '17'], ['8,5,47,1,17'])
    """
    if ";" in inner:
        return [part.strip() for part in inner.split(";")]
    if re.search(r"\d\.\d", inner):
        return [part.strip() for part in inner.split(",")]
    return [part.strip() for part in re.split(r",\s+", inner)]


def split_letter(part: str) -> tuple[str, str]:
    """Return the letter of a direction (N, S, E, W or none) and the rest of a part of a pair.

    Example:
        >>> split_letter("W: 97.6"), split_letter("8.5"), split_letter("47.1° N")
        (('W', '97.6'), ('', '8.5'), ('N', '47.1°'))
    """
    found = _LETTER.fullmatch(part.strip())
    if found is None or (found[1] and found[3]):
        return "?", part
    return found[1] or found[3] or "", found[2]


def _without_letter(part: str) -> str:
    return split_letter(part)[1]


def quantity(text: str | None, marks: DecimalMarks) -> tuple[float | None, str]:
    """Return the number and the unit of a value; no number where the value is anything else."""
    found = _VALUE.fullmatch((text or "").strip())
    if found is None:
        return None, ""
    return marks.parse(found[1]), (found[2] or "").strip()


def angle(text: str | None, marks: DecimalMarks) -> float | None:
    """Return an angle in degrees; None where the value is anything else."""
    number, unit = quantity(text, marks)
    return number if unit.lower() in DEGREE_SIGNS else None
