"""Screening: a rough alignment of each candidate, to find those worth a full alignment.

A full alignment of a candidate takes five times as long as a rough one, and most candidates of a
search are wrong. A rough alignment uses the coarsest level of an image that is coarser than the
map's photographs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from objconnect.localization.align.hypotheses import align_from_many
from objconnect.localization.coarse.search import Candidate
from objconnect.localization.featuremetric.evidence import peak_to_sidelobe
from objconnect.localization.featuremetric.priors import DEFAULT_RADIUS, exact_prior
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.scene.localizer import Query, Stopwatch
from objconnect.scene.runtime.threads import count_network_threads, map_in_threads

PIXEL_RATIO: Final = 1.5
"""Metres per pixel of a screened image as a multiple of those of the map's photographs. Of the
values 1, 1.5 and 2, 1.5 ranks right candidates best (``python -m experiments.screening``)."""


@dataclass(frozen=True)
class ScreenedCandidate:
    """A candidate and the peak-to-sidelobe ratio (``Evidence.peak``) of its rough alignment.

    The ratio is NaN if the picture is too small to measure it.
    """

    candidate: Candidate
    peak: float


def screen(
    refine: Refiner, query: Query, candidates: Sequence[Candidate], clock: Stopwatch
) -> Iterator[ScreenedCandidate]:
    """Align candidates roughly, and yield them with their peaks in their order.

    As many are aligned at a time as threads may run the network.

    Args:
        refine: the refiner that would align them in full.
        query: the image.
        candidates: starts of the alignments.
        clock: sums the seconds of the stage ``screening``.
    """
    threads = count_network_threads()
    for first in range(0, len(candidates), threads):
        part = candidates[first : first + threads]
        with clock.stage("screening"):
            peaks = [*map_in_threads(partial(rough_peak, refine, query), part, threads)]
        yield from map(ScreenedCandidate, part, peaks)


def rough_peak(
    refine: Refiner, query: Query, candidate: Candidate, pixel_ratio: float = PIXEL_RATIO
) -> float:
    """Return the peak-to-sidelobe ratio after an alignment on the coarsest level; 0 if it fails.

    It is NaN if the picture is too small to measure it.

    Args:
        refine: the refiner that would align the candidate in full.
        query: the image.
        candidate: start of the alignment.
        pixel_ratio: metres per pixel of the image as a multiple of the map photographs'.
    """
    builder, width = refine.problems, refine.search_width
    reference_rows = refine.choose_references(replace(query, prior=exact_prior(candidate.pose)))
    view = builder.warp(query, reference_rows, candidate.pose, pixel_ratio)
    maps = builder.features(view, levels=1)
    problem = builder.build(
        view, maps, reference_rows, candidate.pose, width.coarse_points
    ).coarsest()
    aligned = align_from_many(problem, DEFAULT_RADIUS, width)
    return 0.0 if aligned.has_failed[0] else peak_to_sidelobe(problem, aligned.pose)
