"""Pairs of photographs that may show the same ground: neighbours by GPS and neighbours in time.

GPS alone would do for a good receiver. The order of the photographs helps where positions are late
or missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ingest.options import PairOptions

_DEFAULTS: Final = PairOptions()


def choose_pairs(
    names: Sequence[str],
    fixes: Mapping[str, NDArray[np.float64]],
    options: PairOptions = _DEFAULTS,
) -> list[tuple[str, str]]:
    """Return the pairs of photographs worth matching, each once.

    Args:
        names: Photographs in the order they were taken.
        fixes: Positions (3,) in metres of the photographs that have one; altitudes do not count.
        options: How many photographs each one is matched with.
    """
    place = np.array([fixes[n][:2] if n in fixes else (np.nan, np.nan) for n in names])
    pairs = set()
    for i, name in enumerate(names):
        after = options.following
        if name in fixes:
            distance = np.linalg.norm(place - place[i], axis=1)
            distance[i] = np.nan
            nearest = np.argsort(distance, kind="stable")  # NaN comes last
            known = int(np.isfinite(distance).sum())
            pairs |= {(i, int(j)) for j in nearest[: min(options.nearest, known)]}
        else:
            after = options.blind
            pairs |= {(j, i) for j in range(max(i - after, 0), i)}
        pairs |= {(i, j) for j in range(i + 1, min(i + after + 1, len(names)))}
    return [(names[i], names[j]) for i, j in sorted({(min(p), max(p)) for p in pairs})]
