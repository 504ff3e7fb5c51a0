"""Detection of poses that belong to other photographs: all shifted or shuffled, or some wrong.

The search runs if the poses agree with the photographs in no convention. It also runs if most poses
agree, because single poses may still be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.agreement import CHECK, RIGHT_SHARE, Rays, agreement_by_pair, mean_agreement
from benchmark.auditing.findings import Finding, wrong
from benchmark.auditing.statements import centres

Array = NDArray[np.float64]

SHIFTS = tuple(k for distance in range(1, 6) for k in (distance, -distance))
"""The shifts to try, in photographs; a positive one gives a photograph the pose of a later one."""

# A photograph with a smaller share of agreeing matches contradicts the others.
_MIN_AGREEMENT = 0.3
# Swapped names are sought among at most this many bad photographs, because every two are tried.
_MOST_SWAPPED = 12
# In the right order, photographs that share matches are nearer to each other, in the median, than
# this factor times the median distance of any two photographs.
_MAX_DISTANCE_RATIO = 0.7
# A line names at most this many photographs, or pairs of swapped ones.
_MAX_NAMED = 4


def find_order(
    rays: Sequence[Rays], poses: Array, names: Sequence[str]
) -> tuple[Finding, Array | None] | None:
    """Return a finding if poses belong to other photographs, and the poses in the right order.

    The result is None without such a finding; the poses are None if their order is unknown.

    Args:
        rays: matches of the photographs.
        poses: cam_from_world (N, 4, 4), in the order of the names.
        names: names of the photographs.
    """
    as_stated = mean_agreement(rays, poses)
    if as_stated < RIGHT_SHARE:
        shifted = {k: mean_agreement(rays, np.roll(poses, -k, axis=0)) for k in SHIFTS}
        best = max(shifted, key=lambda k: shifted[k])
        # Poses at the ends wrap around to wrong photographs, so that fewer matches agree.
        if shifted[best] > max(2 * as_stated, RIGHT_SHARE - 0.15):
            direction = "earlier" if best > 0 else "later"
            detail = (
                f"each pose belongs to the photograph {_count(abs(best))} {direction}: with this "
                f"shift {shifted[best]:.0%} of the matches agree, as stated {as_stated:.0%}"
            )
            finding = wrong(CHECK, "poses-shifted", detail, agreeing=as_stated, photographs=-best)
            return finding, np.roll(poses, -best, axis=0)
    return _find_contradictions(rays, poses, names, as_stated)


def _count(k: int) -> str:
    return "one" if k == 1 else str(k)


def _find_contradictions(
    rays: Sequence[Rays], poses: Array, names: Sequence[str], as_stated: float
) -> tuple[Finding, Array | None] | None:
    """Find single photographs that contradict the others, and whether two are swapped."""
    agreement = agreement_by_photograph(rays, poses)
    bad = [row for row, value in agreement.items() if value < _MIN_AGREEMENT]
    if not bad:
        return None
    swapped = _find_swaps(rays, poses, bad)
    if swapped:
        pairs = ", ".join(f"{names[a]} and {names[b]}" for a, b in swapped[:_MAX_NAMED])
        reordered = poses.copy()
        for a, b in swapped:
            reordered[[a, b]] = reordered[[b, a]]
        detail = f"photographs have each other's poses: {pairs}"
        return wrong(
            CHECK, "names-swapped", detail, agreeing=as_stated, pairs=len(swapped)
        ), reordered
    ratio = _overlap_distance(rays, poses)
    if len(bad) > len(agreement) / 2 and ratio > _MAX_DISTANCE_RATIO:
        detail = (
            f"{as_stated:.0%} of the matches agree, and the median distance between overlapping "
            f"photographs is {ratio:.1f} times that of all pairs: names are shuffled, or positions "
            "belong to another flight"
        )
        return wrong(CHECK, "names-shuffled", detail, agreeing=as_stated, ratio=ratio), None
    if len(bad) > len(agreement) / 2:
        return None
    first_names = ", ".join(names[row] for row in bad[:_MAX_NAMED])
    more = f" and {len(bad) - _MAX_NAMED} more" if len(bad) > _MAX_NAMED else ""
    detail = f"the poses of {first_names}{more} contradict those of the other photographs"
    return wrong(CHECK, "poses-off", detail, agreeing=as_stated, photographs=len(bad)), poses


def agreement_by_photograph(rays: Sequence[Rays], poses: Array) -> dict[int, float]:
    """Return the share of agreeing matches of each photograph, by its row.

    The share is the median over its pairs. A photograph in a single pair is left out.
    """
    by_row: dict[int, list[float]] = {}
    for r, value in zip(rays, agreement_by_pair(rays, poses), strict=True):
        for row in (r.pair.first, r.pair.second):
            by_row.setdefault(row, []).append(float(value))
    return {row: float(np.median(values)) for row, values in by_row.items() if len(values) > 1}


def _find_swaps(rays: Sequence[Rays], poses: Array, bad: Sequence[int]) -> list[tuple[int, int]]:
    """Return the pairs of photographs that agree with the others once their poses are swapped."""
    swaps: list[tuple[int, int]] = []
    if len(bad) > _MOST_SWAPPED:
        return swaps
    reordered, remaining = poses.copy(), set(bad)
    for a, b in combinations(bad, 2):
        if a not in remaining or b not in remaining:
            continue
        with_either = [r for r in rays if {a, b} & {r.pair.first, r.pair.second}]
        trial = reordered.copy()
        trial[[a, b]] = trial[[b, a]]
        after = agreement_by_photograph(with_either, trial)
        if min(after.get(a, 0.0), after.get(b, 0.0)) > RIGHT_SHARE:
            reordered = trial
            remaining -= {a, b}
            swaps.append((a, b))
    return swaps


def _overlap_distance(rays: Sequence[Rays], poses: Array) -> float:
    """Return the median distance of pairs that share matches, divided by that of all pairs."""
    positions = centres(poses)
    rows = sorted({row for r in rays for row in (r.pair.first, r.pair.second)})
    matched = [np.linalg.norm(positions[r.pair.first] - positions[r.pair.second]) for r in rays]
    any_two = [np.linalg.norm(positions[a] - positions[b]) for a, b in combinations(rows, 2)]
    return float(np.median(matched) / max(float(np.median(any_two)), 1e-9))
