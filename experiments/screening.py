"""How well a rough alignment ranks candidate poses, by the resolution of the image.

    python -m experiments.screening DATASET [DATASET ...] [--every N] [--cache CACHE]

Queries are localized by ``objconnect`` without a prior and without matches. Every candidate is
aligned roughly at several resolutions (``featuremetric/screening.py``) and in full. A candidate is
*right* if its full alignment is within 1 m, 5 degrees of the reference. The table states, for each
resolution, how often the highest peak is that of a right candidate (first), the least of the
highest peaks of right candidates, the 50, 90 and 99 % quantiles of the peaks of the others, and the
processor seconds of a rough alignment; the last line the seconds of a full one.
"""

from __future__ import annotations

from collections import defaultdict
from time import process_time
from typing import Final, NamedTuple

import numpy as np

from experiments.searches import SearchedQuery, measure_searches
from objconnect.localization.featuremetric.screening import rough_peak
from objconnect.scene.localizer import Stopwatch

# Metres per pixel as multiples of those of the map's photographs.
_PIXEL_RATIOS: Final = (1.0, 1.5, 2.0)
_RIGHT_M, _RIGHT_DEG = 1.0, 5.0


class ScreenedCandidate(NamedTuple):
    """A candidate with its rough alignments and its full one.

    Attributes:
        is_right: whether its full alignment is right.
        rough_peaks: peak-to-sidelobe ratios of the rough alignments, by ``_PIXEL_RATIOS``.
        seconds: processor seconds of the rough alignments, and of the full one.
    """

    is_right: bool
    rough_peaks: tuple[float, ...]
    seconds: tuple[float, ...]


def screen_query(searched: SearchedQuery) -> list[ScreenedCandidate]:
    """Align the candidates of a query roughly and in full."""
    search, query, truth = searched
    screened, clock = [], Stopwatch()
    for candidates in search.find(query, clock):
        for candidate in candidates:
            times, rough_peaks = [process_time()], []
            for pixel_ratio in _PIXEL_RATIOS:
                rough_peaks.append(rough_peak(search.refine, query, candidate, pixel_ratio))
                times.append(process_time())
            attempt = search.refine.align_near(query, candidate.pose, clock)
            times.append(process_time())
            is_right = False
            if not attempt.has_failed:
                metres, degrees = attempt.pose.error_to(truth)
                is_right = bool(metres < _RIGHT_M and degrees < _RIGHT_DEG)
            screened.append(ScreenedCandidate(is_right, tuple(rough_peaks), tuple(np.diff(times))))
    return screened


def _print_table(queries: list[list[ScreenedCandidate]]) -> None:
    findable = [each for each in queries if any(one.is_right for one in each)]
    seconds = np.mean([one.seconds for each in queries for one in each], axis=0)
    print(f"{len(findable)} of {len(queries)} queries have a right candidate")
    print("| pixel ratio | first | least right | others: 50, 90, 99 % | seconds |")
    print("|--:|--:|--:|--:|--:|")
    for k, pixel_ratio in enumerate(_PIXEL_RATIOS):
        peaks = defaultdict(list)
        for each in queries:
            for one in each:
                peaks[one.is_right].append(one.rough_peaks[k])
        first = sum(max(each, key=lambda one: one.rough_peaks[k]).is_right for each in findable)
        least = min(max(one.rough_peaks[k] for one in each if one.is_right) for each in findable)
        others = np.quantile(peaks[False], (0.5, 0.9, 0.99))
        shown = ", ".join(f"{value:.1f}" for value in others)
        print(f"| {pixel_ratio:g} | {first} | {least:.1f} | {shown} | {seconds[k]:.2f} |")
    print(f"full alignment: {seconds[-1]:.2f} s")


if __name__ == "__main__":
    _print_table(measure_searches(__doc__, screen_query))
