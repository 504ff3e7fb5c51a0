"""Generate the relief of the terrain."""

from __future__ import annotations

from typing import Final

import numpy as np

from simulate.place.world import Heightfield

Point = tuple[float, float]

_SPACING_M = 2.0
_MAX_NODES = 500  # a side; enough, because the shortest wave is 90 m long
_VALLEYS_M = 900.0  # distance between valleys; the ground is level between them
_ORIGIN: Final[Point] = (0.0, 0.0)


def relief(side_m: float, rng: np.random.Generator, centre: Point = _ORIGIN) -> Heightfield:
    """Return rolling ground: nine long waves, with slopes of 6 % in the root mean square.

    Equal generators give equal heights at equal world positions, also if ``side_m`` and ``centre``
    (world metres) differ. The nodes of the height field are relative to the centre.
    """
    n = int(np.ceil(side_m / max(_SPACING_M, side_m / _MAX_NODES))) + 1
    axis = np.linspace(-0.5 * side_m, 0.5 * side_m, n)
    x, y = axis[None] + centre[0], axis[:, None] + centre[1]
    z = np.zeros((n, n))
    for length in rng.uniform(90.0, 330.0, 9):
        heading, phase = rng.uniform(0, 2 * np.pi, 2)
        k = 2 * np.pi / length
        wave = k * (np.cos(heading) * x + np.sin(heading) * y) + phase
        z += 0.0045 * length * np.sin(wave)
    return Heightfield(z, float(axis[1] - axis[0]))


def valley(side_m: float, rng: np.random.Generator, centre: Point = _ORIGIN) -> Heightfield:
    """Return rolling ground in a valley, whose sides rise by 30 to 45 m.

    The arguments are those of ``relief``.

    In a large place, parallel valleys lie ``_VALLEYS_M`` apart. The steepest slope is 23 to 41 % in
    60 places of 300 m, with a median of 30 %.
    """
    rolling = relief(side_m, rng, centre)
    axis = rolling.spacing_m * np.arange(len(rolling.nodes)) - rolling.half_side_m
    x, y = axis[None] + centre[0], axis[:, None] + centre[1]
    heading = rng.uniform(0, np.pi)
    height, width = rng.uniform(30.0, 45.0), rng.uniform(130.0, 160.0)
    along = np.cos(heading) * x + np.sin(heading) * y
    across = np.cos(heading) * y - np.sin(heading) * x
    across = across + 18.0 * np.sin(along / 90.0 + rng.uniform(0, 2 * np.pi))
    across = across - _VALLEYS_M * np.round(across / _VALLEYS_M)
    rise = height * (1 - np.exp(-((across / width) ** 2)))
    return Heightfield(rolling.nodes + rise, rolling.spacing_m)
