"""Printing of the result of a command as text, or as JSON where ``--json`` is given."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol


class Report(Protocol):
    """A result that a command can print."""

    def text(self) -> str:
        """Return the result for a person."""

    def as_dict(self) -> dict[str, Any]:
        """Return the result for a program, of types that pydantic can write as JSON."""


@dataclass(frozen=True)
class Summary:
    """The result of a command in words and as values for a program."""

    words: str
    values: Mapping[str, Any]

    def text(self) -> str:
        """Return the result for a person."""
        return self.words

    def as_dict(self) -> dict[str, Any]:
        """Return the result for a program."""
        return dict(self.values)


def emit(report: Report, as_json: bool) -> None:
    """Print a report on standard output, as JSON or as text that ends in one line break."""
    if not as_json:
        text = report.text()
        print(text, end="" if text.endswith("\n") else "\n")
        return
    from pydantic import TypeAdapter

    plain = TypeAdapter(dict[str, Any]).dump_python(report.as_dict(), mode="json")
    print(json.dumps(plain, indent=1, allow_nan=False))
