"""Detection of poses that belong to other photographs: shifted, swapped, shuffled, or single ones.

It runs for poses that do not agree with the photographs in any convention.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.agreement import CHECK, RIGHT_SHARE, Rays, share, shares
from benchmark.auditing.findings import Finding, wrong
from benchmark.auditing.statements import centres

Array = NDArray[np.float64]

SHIFTS = tuple(k for distance in range(1, 6) for k in (distance, -distance))
"""The shifts to try, in photographs; a positive one gives a photograph the pose of a later one."""

# A photograph with a smaller share of agreeing matches contradicts the others.
_CONTRADICTS = 0.3
# Most bad photographs among which swapped names are sought; every two of them are tried.
_MOST_SWAPPED = 12
# Photographs that overlap are closer together than this share of the usual distance.
_NEAR = 0.7
# Most photographs that a line names.
_NAMED = 4


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
    ours = share(rays, poses)
    if ours < RIGHT_SHARE:
        shifted = {k: share(rays, np.roll(poses, -k, axis=0)) for k in SHIFTS}
        best = max(shifted, key=lambda k: shifted[k])
        # Poses at the ends wrap around to wrong photographs, so that fewer matches agree.
        if shifted[best] > max(2 * ours, RIGHT_SHARE - 0.15):
            when = "earlier" if best > 0 else "later"
            detail = (
                f"poses are those of photographs {_count(abs(best))} {when}: so read, "
                f"{shifted[best]:.0%} of the matches agree, as stated {ours:.0%}"
            )
            finding = wrong(CHECK, "poses-shifted", detail, agreeing=ours, photographs=-best)
            return finding, np.roll(poses, -best, axis=0)
    return _find_single(rays, poses, names, ours)


def _count(k: int) -> str:
    return "one" if k == 1 else str(k)


def _find_single(
    rays: Sequence[Rays], poses: Array, names: Sequence[str], ours: float
) -> tuple[Finding, Array | None] | None:
    """Find single photographs that contradict the others, and whether two are swapped."""
    each = by_photograph(rays, poses)
    bad = [row for row, value in each.items() if value < _CONTRADICTS]
    if not bad:
        return None
    swapped = _find_swaps(rays, poses, bad)
    if swapped:
        pairs = ", ".join(f"{names[a]} and {names[b]}" for a, b in swapped[:_NAMED])
        read = poses.copy()
        for a, b in swapped:
            read[[a, b]] = read[[b, a]]
        detail = f"photographs have each other's poses: {pairs}"
        return wrong(CHECK, "names-swapped", detail, agreeing=ours, pairs=len(swapped)), read
    ratio = _overlap_distance(rays, poses)
    if len(bad) > len(each) / 2 and ratio > _NEAR:
        detail = (
            f"{ours:.0%} of the matches agree, and photographs that overlap are {ratio:.1f} times "
            "as far apart as any two: names are shuffled, or positions are of another flight"
        )
        return wrong(CHECK, "names-shuffled", detail, agreeing=ours, ratio=ratio), None
    if len(bad) > len(each) / 2:
        return None
    listed = ", ".join(names[row] for row in bad[:_NAMED])
    more = f" and {len(bad) - _NAMED} more" if len(bad) > _NAMED else ""
    detail = f"the poses of {listed}{more} contradict those of the other photographs"
    return wrong(CHECK, "poses-off", detail, agreeing=ours, photographs=len(bad)), poses


def by_photograph(rays: Sequence[Rays], poses: Array) -> dict[int, float]:
    """Return the median over its pairs of the share of matches that agree, by photograph."""
    by_row: dict[int, list[float]] = {}
    for r, value in zip(rays, shares(rays, poses), strict=True):
        for row in (r.pair.first, r.pair.second):
            by_row.setdefault(row, []).append(float(value))
    return {row: float(np.median(values)) for row, values in by_row.items() if len(values) > 1}


def _find_swaps(rays: Sequence[Rays], poses: Array, bad: Sequence[int]) -> list[tuple[int, int]]:
    """Return the pairs of photographs that agree with the others once their poses are swapped."""
    swaps: list[tuple[int, int]] = []
    if len(bad) > _MOST_SWAPPED:
        return swaps
    read, left = poses.copy(), set(bad)
    for a, b in combinations(bad, 2):
        if a not in left or b not in left:
            continue
        near = [r for r in rays if {a, b} & {r.pair.first, r.pair.second}]
        trial = read.copy()
        trial[[a, b]] = trial[[b, a]]
        after = by_photograph(near, trial)
        if min(after.get(a, 0.0), after.get(b, 0.0)) > RIGHT_SHARE:
            read = trial
            left -= {a, b}
            swaps.append((a, b))
    return swaps


def _overlap_distance(rays: Sequence[Rays], poses: Array) -> float:
    """Return the distance of photographs that share matches, over that of any two."""
    positions = centres(poses)
    rows = sorted({row for r in rays for row in (r.pair.first, r.pair.second)})
    near = [np.linalg.norm(positions[r.pair.first] - positions[r.pair.second]) for r in rays]
    every = [np.linalg.norm(positions[a] - positions[b]) for a, b in combinations(rows, 2)]
    return float(np.median(near) / max(float(np.median(every)), 1e-9))
