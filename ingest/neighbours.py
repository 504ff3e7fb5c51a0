"""Pairs of photographs that may show the same ground: neighbours by GPS and neighbours in time.

GPS alone would do for a good receiver. The order of the photographs helps where positions are late
or missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

# A photograph is matched with so many nearest ones by GPS, and with so many that follow it.
_NEAREST = 12
_FOLLOWING = 3
# A photograph without a position is matched with so many before and so many after it.
_BLIND = 10


def choose_pairs(
    names: Sequence[str], fixes: Mapping[str, NDArray[np.float64]]
) -> list[tuple[str, str]]:
    """Return the pairs of photographs worth matching, each once.

    Args:
        names: Photographs in the order they were taken.
        fixes: Positions (3,) in metres of the photographs that have one; altitudes do not count.
    """
    place = np.array([fixes[n][:2] if n in fixes else (np.nan, np.nan) for n in names])
    pairs = set()
    for i, name in enumerate(names):
        after = _FOLLOWING
        if name in fixes:
            distance = np.linalg.norm(place - place[i], axis=1)
            distance[i] = np.nan
            nearest = np.argsort(distance, kind="stable")  # NaN comes last
            known = int(np.isfinite(distance).sum())
            pairs |= {(i, int(j)) for j in nearest[: min(_NEAREST, known)]}
        else:
            after = _BLIND
            pairs |= {(j, i) for j in range(max(i - _BLIND, 0), i)}
        pairs |= {(i, j) for j in range(i + 1, min(i + after + 1, len(names)))}
    return [(names[i], names[j]) for i, j in sorted({(min(p), max(p)) for p in pairs})]
