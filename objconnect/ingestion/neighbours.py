"""Choose pairs of photographs to match: neighbours by GPS, in time and by features.

GPS alone suffices with a good receiver. The order of the photographs helps where positions are
delayed or missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.options import IngestOptions
from objconnect.scene.colmap.options import MAX_RATIO
from objconnect.scene.maps.features import Features, unit_descriptors
from objconnect.scene.maps.matching import match
from objconnect.scene.runtime.progress import progress_bar

_DEFAULTS: Final = IngestOptions()
# A photograph without a position is matched with this many before it and after it in time.
_NEIGHBOURS_IN_TIME: Final = 10
# Number of the largest features of a photograph that ``choose_similar`` compares.
_MAX_FEATURES: Final = 500


def choose_pairs(
    names: Sequence[str],
    fixes: Mapping[str, NDArray[np.float64]],
    options: IngestOptions = _DEFAULTS,
) -> list[tuple[str, str]]:
    """Return the pairs of photographs to match, each once.

    Args:
        names: Photographs in the order they were taken.
        fixes: Positions (3,) in metres of the photographs that have one; altitudes are ignored.
        options: How many photographs each one is matched with.
    """
    xy = np.array([fixes[n][:2] if n in fixes else (np.nan, np.nan) for n in names])
    pairs = set()
    for i, name in enumerate(names):
        following = options.following
        if name in fixes:
            distance = np.linalg.norm(xy - xy[i], axis=1)
            distance[i] = np.nan
            nearest = np.argsort(distance, kind="stable")  # NaN comes last
            with_fix = int(np.isfinite(distance).sum())
            pairs |= {(i, int(j)) for j in nearest[: min(options.nearest, with_fix)]}
        else:
            following = _NEIGHBOURS_IN_TIME
            pairs |= {(j, i) for j in range(max(i - following, 0), i)}
        pairs |= {(i, j) for j in range(i + 1, min(i + following + 1, len(names)))}
    return [(names[i], names[j]) for i, j in sorted({(min(p), max(p)) for p in pairs})]


def choose_similar(
    names: Sequence[str],
    map_names: Sequence[str],
    features: Mapping[str, Features],
    options: IngestOptions,
) -> list[tuple[str, str]]:
    """Pair photographs without a position with the most similar photographs of a map.

    Similarity is the number of matches among their largest features, which persist over changes of
    distance and appearance (preemptive matching; Wu, "Towards linear-time incremental structure
    from motion", 2013).

    Args:
        names: Photographs without a position.
        map_names: Photographs of a map.
        features: Features of all these photographs.
        options: How many photographs of the map each one is matched with.
    """
    largest = {}
    for name in (*map_names, *names):
        item = features[name]
        chosen = np.argsort(-item.scale, kind="stable")[:_MAX_FEATURES]
        largest[name] = unit_descriptors(item.descriptors[chosen])
    pairs = []
    with progress_bar("compare photographs", len(names)) as advance:
        for done, name in enumerate(names, 1):
            votes = [len(match(largest[other], largest[name], MAX_RATIO)) for other in map_names]
            best = np.argsort(-np.array(votes), kind="stable")[: options.nearest]
            pairs += [(map_names[k], name) for k in sorted(best.tolist()) if votes[k]]
            advance(done)
    return pairs
