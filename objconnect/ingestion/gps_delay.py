"""The delay of GPS positions behind the photographs they are written into.

A receiver needs time to compute, and a camera asks it only now and then, so that a photograph holds
where the aircraft was some time before. Over lines flown in both directions this is not a shift of
the whole flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.split import flight_lines

Array = NDArray[np.float64]

# Largest share of the ways to reverse single flight lines that may explain the positions as well as
# the true courses do.
_MAX_CHANCE: Final = 0.05
# Up to this many lines, all ways are tried. For more, the same number of ways is drawn at random.
_ENUMERATED_LINES: Final = 10


@dataclass(frozen=True)
class Motion:
    """The motion of the aircraft at a photograph.

    Attributes:
        line: Number of the flight line.
        velocity: Velocity (3,) in metres per second.
    """

    line: int
    velocity: Array


def motions(
    names: Sequence[str],
    centres: Mapping[str, Array],
    times: Mapping[str, float],
) -> dict[str, Motion]:
    """Return the motion at photographs whose time is known and that have neighbours on their line.

    Args:
        names: Photographs in the order they were taken.
        centres: Camera centres (3,) by name, world metres.
        times: Seconds since any one moment, by name.
    """
    known = [name for name in names if name in centres and name in times]
    lines = flight_lines(known, centres)
    moving = {}
    for k, name in enumerate(known):
        near = [j for j in (k - 1, k, k + 1) if 0 <= j < len(known) and lines[j] == lines[k]]
        first, last = known[near[0]], known[near[-1]]
        if times[last] > times[first]:
            velocity = (centres[last] - centres[first]) / (times[last] - times[first])
            moving[name] = Motion(lines[k], velocity)
    return moving


def find_delay(
    moving: Mapping[str, Motion],
    centres: Mapping[str, Array],
    fixes: Mapping[str, Array],
) -> float:
    """Return the seconds that fixes are behind the photographs, or 0 where they are uncertain.

    The delay is found by horizontal least squares of
    ``fix = similarity(centre) - delay * velocity``. The errors of a receiver drift: within a
    flight line they are alike, and may look like a delay. The evidence is therefore counted in
    lines and not in photographs: the fit is repeated with some of the lines reversed, which shows
    how well chance explains the fixes. Fewer than six lines prove nothing.

    Args:
        moving: The motions that ``motions`` returned.
        centres: Camera centres (3,) by name, world metres, placed by the fixes.
        fixes: Measured positions (3,) by name; those without a motion do not count.
    """
    names = [name for name in moving if name in fixes]
    if not names:
        return 0.0
    numbers = np.unique([moving[name].line for name in names], return_inverse=True)[1]
    ways = _ways(int(numbers.max()) + 1)
    if 1 / len(ways) > _MAX_CHANCE:
        return 0.0
    velocity = np.array([moving[name].velocity[:2] for name in names])
    x, y = np.array([centres[name][:2] for name in names]).T
    one, zero = np.ones(len(names)), np.zeros(len(names))
    similarity = np.hstack([[one, zero, x, -y], [zero, one, y, x]]).T
    basis = np.linalg.qr(similarity)[0]

    def residuals_at(values: Array) -> Array:
        stacked = values.T.ravel()
        return np.asarray(stacked - basis @ (basis.T @ stacked))

    off = residuals_at(np.array([fixes[name][:2] - centres[name][:2] for name in names]))
    moved = np.array([residuals_at(velocity * way[numbers, None]) for way in ways])
    along = moved @ off
    squares = np.square(moved).sum(1)
    explained = np.square(along) / np.maximum(squares, 1e-12)
    if (explained >= explained[0] * (1 - 1e-9)).mean() > _MAX_CHANCE:
        return 0.0
    return float(-along[0] / squares[0])


def _ways(lines: int) -> Array:
    """Return signs (K, lines) that reverse lines, the true ones first.

    Reversing all lines at once is the same as reversing none.
    """
    if lines <= _ENUMERATED_LINES:
        return np.array([(1, *signs) for signs in product((1, -1), repeat=lines - 1)], float)
    signs = np.random.default_rng(0).choice([1.0, -1.0], (2**_ENUMERATED_LINES, lines))
    signs[0] = 1
    return signs


def undo_delay(
    fixes: Mapping[str, Array], moving: Mapping[str, Motion], delay: float
) -> dict[str, Array]:
    """Return the fixes (3,) without their delay, for the photographs that have a motion."""
    return {name: fixes[name] + delay * moving[name].velocity for name in moving if name in fixes}
