"""The decimal mark of a file, point or comma, inferred from its numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.numbers import parse_number

_WITH_COMMA: Final = re.compile(r"[-+]?\d*,\d+")
_WITH_POINT: Final = re.compile(r"[-+]?\d*\.\d+")
# A mark before three digits may separate thousands.
_THOUSANDS: Final = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")


@dataclass(frozen=True)
class DecimalMarks:
    """The decimal marks of a file's numbers.

    Attributes:
        comma: whether a comma is a decimal mark.
        point: whether a point is a decimal mark, even before three digits.
        doubt: why commas are not understood; empty if there is no doubt.
    """

    comma: bool
    point: bool
    doubt: str = ""

    @staticmethod
    def of(texts: Iterable[str]) -> DecimalMarks:
        """Infer the decimal marks of a file from the texts of its numbers.

        A comma is a decimal mark if no number has a point and some comma cannot separate
        thousands; otherwise numbers with a comma are not understood. If numbers have points and
        some comma cannot separate thousands, a point that may separate them is not understood
        either.

        Examples:
            >>> DecimalMarks.of(["47,0004", "60,000"]).parse("60,000")
            60.0
            >>> DecimalMarks.of(["47.0004", "1,234"]).parse("1,234") is None
            True
        """
        written = set(texts)
        commas = [text for text in written if _WITH_COMMA.fullmatch(text)]
        points = [text for text in written if _WITH_POINT.fullmatch(text)]
        if not commas:
            return DecimalMarks(comma=False, point=True)
        decimal_commas = [text for text in commas if not _THOUSANDS.fullmatch(text)]
        if decimal_commas and not points:
            return DecimalMarks(comma=True, point=False)
        example = min(decimal_commas or commas)
        return DecimalMarks(
            comma=False,
            point=not decimal_commas,
            doubt=f"the comma of {example} may be a decimal mark or separate thousands",
        )

    def parse(self, text: str) -> float | None:
        """Return the number in a text; None if it is ambiguous or not a number."""
        text = text.strip()
        if "," in text and not self.comma:
            return None
        if not self.point and _THOUSANDS.fullmatch(text) and "." in text:
            return None
        return parse_number(text)
