"""Split the photographs of a flight into map photographs and queries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError

Split = Literal["photo", "line", "none"]
# A flight line ends where the flight direction turns by more than this. Wind turns it by less.
_LINE_TURN_DEG: Final = 40.0


def choose_queries(
    names: Sequence[str],
    fixes: Mapping[str, NDArray[np.float64]],
    split: Split,
    every: int,
) -> set[str]:
    """Choose the photographs that are queries, by name.

    Args:
        names: Photographs in the order they were taken.
        fixes: Positions (3,) in metres of the photographs that have one.
        split: "photo" takes every ``every``-th photograph, "line" all photographs of every
            ``every``-th flight line, "none" no photographs.
        every: See ``split``; 2 or more.

    Raises:
        InputError: The flight has at most ``every // 2`` lines, so none is a query line.
    """
    if split == "none":
        return set()
    first = every // 2
    if split == "photo":
        return set(names[first::every])
    lines = flight_lines(names, fixes)
    if max(lines) < first:
        raise InputError(
            f"the flight has {max(lines) + 1} lines, too few for a query line among every {every}: "
            "take a smaller --every or --split photo"
        )
    return {name for name, line in zip(names, lines, strict=True) if line % every == first}


def flight_lines(
    names: Sequence[str],
    fixes: Mapping[str, NDArray[np.float64]],
) -> list[int]:
    """Return the number of the flight line of each photograph.

    A line ends where the flight direction turns. A photograph without a fix belongs to the line
    of the preceding photograph.
    """
    known = [name for name in names if name in fixes]
    course: NDArray[np.float64] | None = None
    line, line_of = 0, dict.fromkeys(known[:1], 0)
    for previous, name in pairwise(known):
        step = fixes[name][:2] - fixes[previous][:2]
        length = float(np.linalg.norm(step))
        if length > 0:
            direction = step / length
            if course is not None and course @ direction < np.cos(np.radians(_LINE_TURN_DEG)):
                line += 1
                course = None  # the step from one line to the next has the direction of neither
            else:
                course = direction
        line_of[name] = line
    numbers, current = [], 0
    for name in names:
        current = line_of.get(name, current)
        numbers.append(current)
    return numbers
