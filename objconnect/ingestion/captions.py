"""Split the text of a drone's subtitle into fields and tuples.

A value is the whole text of a field. Nothing is removed from it here, so that the code that
parses it notices a unit, a second number or an unknown character.
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
# Keys of compact subtitles, which have no colon. A field's value ends before them.
_SHORT: Final = r"(?:H\.S|V\.S|DZOOM|ISO|EV|SS|F/|GPS|RTK|HOME|[FG]\.PRY|H|D)"
_SHORT_WORD: Final = re.compile(r"(?<![\w.])(H\.S|DZOOM|H|D)[ \t]+(?=[-+\d])")
_END: Final = re.compile(rf"[\[\];\n|]|,\s*(?=[A-Za-z])|\s(?={_SHORT}(?:[\s(/]|$))")
# Maximum length of a value. A longer one is not a number and is replaced by "...".
_MAX_LENGTH: Final = 200
_VALUE: Final = re.compile(r"([-+]?[\d.,]*\d[\d.,]*(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?")
_LETTER: Final = re.compile(r"(?:([NSEW])\s*:?\s*)?(.*?)\s*([NSEW])?")
# U+FFFD is a degree sign that was written in another encoding.
DEGREE_SIGNS: Final = ("", "°", "\ufffd", "º", "deg", "degrees")
"""Units of an angle in degrees."""


@dataclass(frozen=True)
class Caption:
    """A subtitle split into fields and tuples, as text.

    Attributes:
        text: Text without tags.
        fields: Values by name in lower case, such as ``focal_len``, ``h.s`` or ``barometer``.
        tuples: Texts in parentheses by name in lower case, such as ``gps``.
    """

    subtitle: Subtitle
    text: str
    fields: Mapping[str, str]
    tuples: Mapping[str, str]

    @staticmethod
    def parse(subtitle: Subtitle) -> Caption:
        """Split a subtitle.

        A value in an unclosed bracket counts as truncated and is dropped. Two different values
        of one name are joined, so that neither is read as a number.
        """
        text = html.unescape(_TAG.sub(" ", subtitle.text)).replace("\xa0", " ")
        tuples = _merge((name.lower(), inner) for name, inner in _PARENTHESES.findall(text))
        plain = _PARENTHESES.sub(";", text)
        opened = plain.rfind("[")
        if opened > plain.rfind("]"):
            plain = plain[:opened]
        fields = _merge(_iterate_fields(plain))
        # ``BAROMETER(60.0)`` is a field in parentheses.
        fields |= {name: inner for name, inner in tuples.items() if name not in fields}
        return Caption(subtitle, text, fields, tuples)

    def numbers(self, *names: str) -> Iterator[str]:
        """Yield the numbers of the named fields and of all tuples, as text."""
        for name in names:
            if name in self.fields and (match := _VALUE.fullmatch(self.fields[name].strip())):
                yield match[1]
        for inner in self.tuples.values():
            for part in split_tuple(inner):
                if match := _VALUE.fullmatch(split_letter(part)[1]):
                    yield match[1]


def _merge(items: Iterator[tuple[str, str]] | list[tuple[str, str]]) -> dict[str, str]:
    """Return texts by name; two different texts of one name are joined."""
    merged: dict[str, str] = {}
    for name, text in items:
        text = text.strip()
        merged[name] = text if merged.get(name, text) == text else f"{merged[name]} and {text}"
    return merged


def _iterate_fields(text: str) -> Iterator[tuple[str, str]]:
    """Yield names in lower case and values of fields with a colon and of compact fields."""
    names = list(_FIELD.finditer(text))
    starts = [*(match.start() for match in names), len(text)]
    for match in (*names, *_SHORT_WORD.finditer(text)):
        after = starts[bisect_right(starts, match.start())]
        whole = after - match.end() <= _MAX_LENGTH
        value = text[match.end() : min(after, match.end() + _MAX_LENGTH)].lstrip(" \t")
        end = _END.search(value)
        value = (value[: end.start()] if end else value).rstrip(" \t,")
        yield match[1].lower(), value if end or whole else "..."


def split_tuple(inner: str) -> list[str]:
    """Split the text in parentheses at its separators.

    Commas separate numbers with decimal points. Without points, only commas before white space
    separate, because a comma between digits may be a decimal mark. An ambiguous text is one part.

    Examples:
        >>> [split_tuple(text) for text in ("8.5,47.1,17", "8,50, 47,10, 17", "8,5,47,1,17")]
        [['8.5', '47.1', '17'], ['8,50', '47,10', '17'], ['8,5,47,1,17']]
    """
    if ";" in inner:
        return [part.strip() for part in inner.split(";")]
    if re.search(r"\d\.\d", inner):
        return [part.strip() for part in inner.split(",")]
    return [part.strip() for part in re.split(r",\s+", inner)]


def split_letter(part: str) -> tuple[str, str]:
    """Split a coordinate into the letter of its direction (N, S, E, W or none) and the rest.

    The letter is "?" if there are two.

    Examples:
        >>> split_letter("W: 97.6"), split_letter("8.5"), split_letter("47.1° N")
        (('W', '97.6'), ('', '8.5'), ('N', '47.1°'))
    """
    match = _LETTER.fullmatch(part.strip())
    if match is None or (match[1] and match[3]):
        return "?", part
    return match[1] or match[3] or "", match[2]


def parse_quantity(text: str | None, marks: DecimalMarks) -> tuple[float | None, str]:
    """Return the number and the unit of a value; None and "" where it is not a quantity."""
    match = _VALUE.fullmatch((text or "").strip())
    if match is None:
        return None, ""
    return marks.parse(match[1]), (match[2] or "").strip()


def parse_angle(text: str | None, marks: DecimalMarks) -> float | None:
    """Return an angle in degrees; None where the value is not an angle."""
    number, unit = parse_quantity(text, marks)
    return number if unit.lower() in DEGREE_SIGNS else None
