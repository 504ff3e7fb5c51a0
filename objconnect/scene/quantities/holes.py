"""Detection of no-data heights that a surface model does not declare."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError

LOWEST_M: Final = -500.0
"""No ground on earth is lower: the shore of the Dead Sea lies at -440 m."""
HIGHEST_M: Final = 9_000.0
"""No ground on earth is higher."""

_BINS = round(HIGHEST_M - LOWEST_M)
# A no-data constant is at least this far below all other heights, metres.
_STEP_M = 10
# Such a constant above all other heights is at least this far above them, metres.
_CLIFF_M = 100
# Heights of 0 are reported if at least this share of the pixels has them. If 0 is the lowest
# height, all others must also be at least ``_REMARK_M`` (m) higher.
_REMARK_SHARE, _REMARK_M = 0.01, 1
# Heights of 0 between others are reported if the number of pixels within a metre of 0, divided by
# that of pixels of exactly 0, is at most this. In rasters with steps of 0.1 m, heights of exactly 0
# are common.
_MAX_ZERO_RATIO = 4
# Smallest number of pixels of a no-data constant, and their smallest share.
_MIN_PIXELS, _MIN_SHARE = 16, 1e-4
# Largest number of pixels within ``_STEP_M`` above a low constant, or within ``_CLIFF_M`` below a
# high one, as a share of the constant's pixels. Resampling leaves a few there.
_MAX_BETWEEN_SHARE = 0.1
_MAX_HOLES = 4
# A raster is a synthetic surface if no step of a metre holds two heights, and fewer steps than
# this, or a smaller share of the steps of its range, are occupied.
_MIN_STEPS, _MIN_STEP_SHARE = 5, 0.5
# Heights next to missing data that are this far outside all others (m) come from resampling.
_BELOW_M, _ABOVE_M = 10.0, 100.0
# The lowest and highest ground is taken from pixels farther than this from no data (pixels).
_MARGIN_PX = 2
# Smallest number of pixels that determine the lowest and the highest ground.
_MIN_GROUND_PIXELS = 256

Heights = NDArray[np.float32]


@dataclass
class Histogram:
    """A histogram of heights in steps of a metre.

    Attributes:
        counts: number of pixels in each step from ``LOWEST_M``.
        low: lowest height in each step, infinite if it is empty.
        high: highest height in each step, minus infinity if it is empty.
        edge: heights at the edge of the raster.
        zeros: number of pixels of height 0.
    """

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    low: Heights = field(default_factory=lambda: np.full(_BINS, np.inf, np.float32))
    high: Heights = field(default_factory=lambda: np.full(_BINS, -np.inf, np.float32))
    edge: set[float] = field(default_factory=set)
    zeros: int = 0

    def add(self, heights: Heights) -> None:
        """Count finite heights between ``LOWEST_M`` and ``HIGHEST_M``."""
        self.zeros += int((heights == 0).sum())
        steps = (np.floor(heights) - LOWEST_M).astype(np.intp)
        self.counts += np.bincount(steps, minlength=_BINS)
        np.minimum.at(self.low, steps, heights)
        np.maximum.at(self.high, steps, heights)

    def add_edge(self, heights: Heights) -> None:
        """Add finite heights at the edge of the raster."""
        self.edge.update(np.unique(heights).tolist())


@dataclass(frozen=True)
class Hole:
    """A height that means no data, certainly or possibly.

    Attributes:
        height: the height, metres.
        share: share of the pixels that have it.
        sure: whether it certainly means no data; otherwise it may be a plain.
        relation: its relation to the other heights, a phrase for messages.
        remark: whether it may be water; it is then only reported and not removed.
    """

    height: float
    share: float
    sure: bool
    relation: str = "far below all others"
    remark: bool = False


def find_holes(histogram: Histogram) -> list[Hole]:
    """Return the constant heights of many pixels that lie far below or above all others.

    A flat plain with flat-roofed towers has the same histogram if the plain fills most of the
    raster, so holes above 0 that fill most of the raster are uncertain. Heights of 0 a little below
    all others, or between them, may be the sea and are only reported.
    """
    counts = histogram.counts.copy()
    total = int(counts.sum())
    found: list[Hole] = []
    while len(found) < _MAX_HOLES:
        steps = np.flatnonzero(counts)
        if not steps.size:
            break
        first = int(steps[0])
        height, share = float(histogram.low[first]), counts[first] / total
        rest = int(counts.sum() - counts[first])
        constant = histogram.low[first] == histogram.high[first]
        enough = counts[first] >= _MIN_PIXELS and share >= _MIN_SHARE
        # Water and plains reach the edge too, but no cliff rises from them.
        may_be_hole = height in histogram.edge or height == 0
        if not (constant and enough and may_be_hole and rest) or _is_synthetic(
            histogram, steps[1:]
        ):
            break
        if counts[first + 1 : first + 1 + _STEP_M].sum() > _MAX_BETWEEN_SHARE * counts[first]:
            higher = counts[first + 1 : first + 1 + _REMARK_M].sum()
            if height == 0 and not higher and share >= _REMARK_SHARE:
                found.append(Hole(height, float(share), False, "below all others", remark=True))
            break
        found.append(Hole(height, float(share), sure=counts[first] <= rest or height <= 0))
        counts[first] = 0
    found += _find_above(histogram, counts, total)
    if total and not any(hole.height == 0 for hole in found):
        found += _find_zeros(histogram, counts, total)
    return found


def _find_above(histogram: Histogram, counts: NDArray[np.int64], total: int) -> list[Hole]:
    """Return the constant far above all other heights, and clear its count."""
    steps = np.flatnonzero(counts)
    if len(steps) < 2:
        return []
    last = int(steps[-1])
    height, share = float(histogram.high[last]), counts[last] / total
    constant = histogram.low[last] == histogram.high[last] and height in histogram.edge
    enough = counts[last] >= _MIN_PIXELS and share >= _MIN_SHARE
    has_slope = counts[max(0, last - _CLIFF_M) : last].sum() > _MAX_BETWEEN_SHARE * counts[last]
    if not (constant and enough) or has_slope or _is_synthetic(histogram, steps[:-1]):
        return []
    sure = bool(2 * counts[last] <= counts.sum())
    counts[last] = 0
    return [Hole(height, float(share), sure, "far above all others")]


def _find_zeros(histogram: Histogram, counts: NDArray[np.int64], total: int) -> list[Hole]:
    """Return many heights of exactly 0 between others, as a remark."""
    zero = round(-LOWEST_M)
    steps_below = np.flatnonzero(counts[:zero])
    share = histogram.zeros / total
    near_zero = int(counts[zero - 1 : zero + 1].sum())
    only_constants = bool((histogram.low[steps_below] == histogram.high[steps_below]).all())
    if only_constants or share < _REMARK_SHARE or _MAX_ZERO_RATIO * histogram.zeros < near_zero:
        return []
    return [Hole(0.0, float(share), False, "between the others", remark=True)]


@dataclass(frozen=True)
class Ground:
    """The valid heights of a surface model.

    Attributes:
        lowest: lower heights are no data, metres.
        highest: higher heights are no data, metres.
        holes: heights that mean no data, metres.
        doubts: phrases for warnings.
    """

    lowest: float = LOWEST_M
    highest: float = HIGHEST_M
    holes: tuple[float, ...] = ()
    doubts: tuple[str, ...] = ()


def find_ground(
    strips: Callable[[], Iterator[Heights]], declares_no_data: bool, pixel_m: float, where: str
) -> Ground:
    """Find the no-data heights that a surface model does not declare.

    Args:
        strips: returns pieces of the raster from top to bottom, (H, W) metres; NaN where there is
            declared no data or an impossible height.
        declares_no_data: whether the file declares a no-data value.
        pixel_m: size of a pixel on the ground, metres.
        where: name of the raster in messages.

    Raises:
        InputError: most pixels have one height far from all others, which may mean no data or be a
            plain.
    """
    histogram, unknown, last = Histogram(), False, None
    for strip in strips():
        finite = np.isfinite(strip)
        unknown |= not finite.all()
        histogram.add(strip[finite])
        sides = np.concatenate(
            [strip[:, 0], strip[:, -1], *([] if last is not None else [strip[0]])]
        )
        histogram.add_edge(sides[np.isfinite(sides)])
        last = strip[-1]
    if last is not None:
        histogram.add_edge(last[np.isfinite(last)])
    doubts, values = [], []
    for hole in find_holes(histogram):
        share = f"{100 * hole.share:.1f} % of the pixels have the height {hole.height:g} m"
        fact = f"{share}, {hole.relation}"
        if hole.remark:
            doubts.append(f"{fact}: if it is no data, gdal_edit -a_nodata declares it")
        elif not hole.sure and not declares_no_data:
            raise InputError(
                f"{where}: {fact}: no data or a plain. If it is no data, run gdal_edit -a_nodata "
                f"{hole.height:g}; if it is a plain, declare another value with gdal_edit -a_nodata"
            )
        elif hole.sure:
            doubts.append(f"{fact}: treated as no data, although the file does not declare it")
            values.append(hole.height)
    if not (unknown or values):
        return Ground(doubts=tuple(doubts))
    lowest, highest = _ground_range(strips(), values)
    slope = 2 * _MARGIN_PX * pixel_m
    return Ground(
        max(LOWEST_M, lowest - _BELOW_M - slope),
        min(HIGHEST_M, highest + _ABOVE_M + slope),
        tuple(values),
        tuple(doubts),
    )


def _ground_range(strips: Iterator[Heights], values: list[float]) -> tuple[float, float]:
    """Return the lowest and the highest height of pixels that are not next to missing data.

    With too few such pixels they are ``LOWEST_M`` and ``HIGHEST_M``.
    """
    low, high, count = np.inf, -np.inf, 0
    for heights, rows in _overlap_strips(strips):
        unknown = ~np.isfinite(heights) | np.isin(heights, np.array(values, np.float32))
        ground = heights[rows][~_dilate(unknown)[rows]]
        count += ground.size
        if ground.size:
            low, high = min(low, float(ground.min())), max(high, float(ground.max()))
    return (low, high) if count >= _MIN_GROUND_PIXELS else (LOWEST_M, HIGHEST_M)


def _overlap_strips(strips: Iterator[Heights]) -> Iterator[tuple[Heights, slice]]:
    """Yield strips with rows of their neighbours, and the slice of rows that are new."""
    last_rows: Heights | None = None
    for strip in strips:
        joined = strip if last_rows is None else np.concatenate([last_rows, strip])
        yield joined, slice(0 if last_rows is None else _MARGIN_PX, -_MARGIN_PX)
        last_rows = joined[-2 * _MARGIN_PX :]
    if last_rows is not None:
        yield last_rows, slice(-_MARGIN_PX, None)


def _dilate(unknown: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels within ``_MARGIN_PX`` pixels of an unknown one."""
    dilated = np.pad(unknown, _MARGIN_PX)
    for axis, size in enumerate(unknown.shape):
        parts = [np.take(dilated, range(k, k + size), axis) for k in range(2 * _MARGIN_PX + 1)]
        dilated = np.logical_or.reduce(parts)
    return np.asarray(dilated)


def _is_synthetic(histogram: Histogram, others: NDArray[np.intp]) -> bool:
    """Return whether the other heights are a few constants, as in synthetic surfaces.

    Ground in whole metres consists of constants too, but in most steps of its range.
    """
    if not (histogram.low[others] == histogram.high[others]).all():
        return False
    span = int(others[-1] - others[0]) + 1 if others.size else 0
    return len(others) < _MIN_STEPS or len(others) < _MIN_STEP_SHARE * span
