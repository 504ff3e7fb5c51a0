"""Which photographs may show the same ground: those near by GPS, and those taken one after another.

GPS alone would do for a good receiver; one that lags or fails at times needs the order too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

_NEAREST = 12
_FOLLOWING = 3
# A photograph without a position is held against so many before and after it.
_BLIND = 10


def choose_pairs(
    names: Sequence[str], fixes: Mapping[str, NDArray[np.float64]]
) -> list[tuple[str, str]]:
    """Pairs of photographs worth matching, each once.

    Args:
        names: photographs in the order they were taken.
        fixes: (3,) positions of those that have one, metres; altitudes do not count.
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
