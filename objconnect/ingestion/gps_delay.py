"""Estimate and remove the delay of GPS positions behind their photographs.

A receiver needs time to compute, and a camera polls it at intervals. A photograph may therefore
hold an earlier position of the aircraft. If lines are flown in both directions, a delay shifts them
in opposite directions, which distinguishes it from a shift of the whole flight.
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

# Significance level of the permutation test: the largest share of line reversals that may fit the
# positions as well as the true flight directions do.
_MAX_CHANCE: Final = 0.05
# Up to this many lines, all reversals are tested. For more lines, two to the power of this
# many reversals are drawn at random.
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


def estimate_motions(
    names: Sequence[str],
    centres: Mapping[str, Array],
    times: Mapping[str, float],
) -> dict[str, Motion]:
    """Estimate the motion at photographs with a time and neighbours on their flight line.

    Args:
        names: Photographs in the order they were taken.
        centres: Camera centres (3,) by name, world metres.
        times: Time stamps in seconds, by name.
    """
    known = [name for name in names if name in centres and name in times]
    lines = flight_lines(known, centres)
    motions = {}
    for k, name in enumerate(known):
        neighbours = [j for j in (k - 1, k, k + 1) if 0 <= j < len(known) and lines[j] == lines[k]]
        first, last = known[neighbours[0]], known[neighbours[-1]]
        if times[last] > times[first]:
            velocity = (centres[last] - centres[first]) / (times[last] - times[first])
            motions[name] = Motion(lines[k], velocity)
    return motions


def find_delay(
    motions: Mapping[str, Motion],
    centres: Mapping[str, Array],
    fixes: Mapping[str, Array],
) -> float:
    """Return the seconds by which fixes lag behind the photographs, or 0 where uncertain.

    The delay is the horizontal least-squares solution of
    ``fix = similarity(centre) - delay * velocity``. Errors of a receiver are correlated within a
    flight line and may look like a delay. A permutation test over lines therefore decides whether
    the delay is significant: the fit is repeated with some of the lines reversed. Fewer than six
    lines are never significant.

    Args:
        motions: Result of ``estimate_motions``.
        centres: Camera centres (3,) by name, world metres, georegistered by the fixes.
        fixes: Measured positions (3,) by name; those without a motion are ignored.
    """
    names = [name for name in motions if name in fixes]
    if not names:
        return 0.0
    numbers = np.unique([motions[name].line for name in names], return_inverse=True)[1]
    reversals = _list_reversals(int(numbers.max()) + 1)
    if 1 / len(reversals) > _MAX_CHANCE:
        return 0.0
    velocity = np.array([motions[name].velocity[:2] for name in names])
    x, y = np.array([centres[name][:2] for name in names]).T
    one, zero = np.ones(len(names)), np.zeros(len(names))
    similarity = np.hstack([[one, zero, x, -y], [zero, one, y, x]]).T
    basis = np.linalg.qr(similarity)[0]

    def residuals_at(values: Array) -> Array:
        stacked = values.T.ravel()
        return np.asarray(stacked - basis @ (basis.T @ stacked))

    offsets = residuals_at(np.array([fixes[name][:2] - centres[name][:2] for name in names]))
    velocities = np.array([residuals_at(velocity * signs[numbers, None]) for signs in reversals])
    products = velocities @ offsets
    squares = np.square(velocities).sum(1)
    explained = np.square(products) / np.maximum(squares, 1e-12)
    if (explained >= explained[0] * (1 - 1e-9)).mean() > _MAX_CHANCE:
        return 0.0
    return float(-products[0] / squares[0])


def _list_reversals(lines: int) -> Array:
    """Return signs (K, lines) that reverse flight lines; the first row reverses none.

    Reversing all lines at once is the same as reversing none.
    """
    if lines <= _ENUMERATED_LINES:
        return np.array([(1, *signs) for signs in product((1, -1), repeat=lines - 1)], float)
    signs = np.random.default_rng(0).choice([1.0, -1.0], (2**_ENUMERATED_LINES, lines))
    signs[0] = 1
    return signs


def undo_delay(
    fixes: Mapping[str, Array], motions: Mapping[str, Motion], delay: float
) -> dict[str, Array]:
    """Return the fixes (3,) with the delay removed, for the photographs that have a motion."""
    return {name: fixes[name] + delay * motions[name].velocity for name in motions if name in fixes}
