"""How much older than the photographs their GPS positions are.

A receiver computes, and a camera asks it now and then: what is written into a photograph is where
the aircraft was some time before. Over lines flown to and fro that is no shift of the whole flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ingest.split import flight_lines

Array = NDArray[np.float64]

# A lag is believed when of all ways to turn single flight lines about, at most this share explains
# the positions as well as the true courses do.
_BY_CHANCE = 0.05
# More lines than that are turned about at random; all ways of these are tried.
_ALL_WAYS = 10


@dataclass(frozen=True)
class Motion:
    """Flight line of a photograph, and velocity there: (3,) metres per second."""

    line: int
    velocity: Array


def motions(
    names: Sequence[str], centres: Mapping[str, Array], times: Mapping[str, float]
) -> dict[str, Motion]:
    """How the aircraft moved at photographs that know their time and have neighbours in their line.

    Args:
        names: in the order they were taken.
        centres: (3,) cameras by name, world metres.
        times: seconds since any moment, by name.
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


def find_lag(
    moving: Mapping[str, Motion], centres: Mapping[str, Array], fixes: Mapping[str, Array]
) -> float:
    """Seconds that fixes are behind the photographs; 0 where they do not tell it for certain.

    Horizontal least squares of ``fix = similarity(centre) - lag * velocity``. The errors of a
    receiver drift: within a flight line they are alike, and may look like a lag. So the lines speak
    for a lag, not the photographs, and what else could look like one is tried: the same
    velocities with some of the lines turned about. Fewer than six lines prove nothing.

    Args:
        moving: of ``motions``.
        centres: (3,) cameras by name, world metres, placed by the fixes.
        fixes: (3,) their measured positions by name; those without motion do not count.
    """
    names = [name for name in moving if name in fixes]
    if not names:
        return 0.0
    numbers = np.unique([moving[name].line for name in names], return_inverse=True)[1]
    ways = _ways(int(numbers.max()) + 1)
    if 1 / len(ways) > _BY_CHANCE:
        return 0.0
    velocity = np.array([moving[name].velocity[:2] for name in names])
    x, y = np.array([centres[name][:2] for name in names]).T
    one, zero = np.ones(len(names)), np.zeros(len(names))
    similarity = np.hstack([[one, zero, x, -y], [zero, one, y, x]]).T
    basis = np.linalg.qr(similarity)[0]

    def unexplained(values: Array) -> Array:
        stacked = values.T.ravel()
        return np.asarray(stacked - basis @ (basis.T @ stacked))

    off = unexplained(np.array([fixes[name][:2] - centres[name][:2] for name in names]))
    moved = np.array([unexplained(velocity * way[numbers, None]) for way in ways])
    along = moved @ off
    squares = np.square(moved).sum(1)
    explained = np.square(along) / np.maximum(squares, 1e-12)
    if (explained >= explained[0] * (1 - 1e-9)).mean() > _BY_CHANCE:
        return 0.0
    return float(-along[0] / squares[0])


def _ways(lines: int) -> Array:
    """Signs (K, lines), the true ones first; turning all lines about at once is no other way."""
    if lines <= _ALL_WAYS:
        return np.array([(1, *signs) for signs in product((1, -1), repeat=lines - 1)], float)
    signs = np.random.default_rng(0).choice([1.0, -1.0], (2**_ALL_WAYS, lines))
    signs[0] = 1
    return signs


def undo_lag(
    fixes: Mapping[str, Array], moving: Mapping[str, Motion], lag: float
) -> dict[str, Array]:
    """Where the receiver would have been without its lag, of the photographs that have a motion."""
    return {name: fixes[name] + lag * moving[name].velocity for name in moving if name in fixes}
