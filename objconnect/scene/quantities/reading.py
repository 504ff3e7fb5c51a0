"""A quantity read from a file: a value with its source, or unknown with the reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from objconnect.scene.errors import InputError

T = TypeVar("T")
S = TypeVar("S")


@dataclass(frozen=True)
class Reading(Generic[T]):
    """A quantity read from a file.

    Attributes:
        value: the value, in the unit that the reader documents; None if unknown.
        source: field or fields of the value, such as ``GPSLatitude``.
        doubts: phrases that say what is missing or contradictory and name the fields, such as
            "GPSLatitudeRef is missing".
    """

    value: T | None
    source: str
    doubts: tuple[str, ...] = ()

    @property
    def is_known(self) -> bool:
        """Return whether there is a value."""
        return self.value is not None

    @property
    def why(self) -> str:
        """Return the doubts as one phrase; empty if there are none."""
        return "; ".join(self.doubts)

    def require(self, where: object, remedy: str) -> T:
        """Return the value.

        Args:
            where: file or part of a file, for the message.
            remedy: what to do if the value is unknown.

        Raises:
            InputError: the value is unknown.
        """
        if self.value is None:
            raise InputError(f"{where}: {self.source} is unknown ({self.why}): {remedy}")
        return self.value

    def map(self, change: Callable[[T], S]) -> Reading[S]:
        """Return the reading with a converted value; an unknown value stays unknown."""
        value = None if self.value is None else change(self.value)
        return Reading(value, self.source, self.doubts)

    def with_doubts(self, *doubts: str) -> Reading[T]:
        """Return the reading with further doubts."""
        return replace(self, doubts=(*self.doubts, *doubts))


def known(value: T, source: str, *doubts: str) -> Reading[T]:
    """Return a reading with a value."""
    return Reading(value, source, doubts)


def unknown(source: str, *doubts: str) -> Reading[T]:
    """Return a reading without a value; ``doubts`` say why."""
    return Reading(None, source, doubts)
