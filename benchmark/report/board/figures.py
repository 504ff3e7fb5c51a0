"""All numbers that the leaderboard page of the tracks shows; the page computes none itself.

Keys of the data: ``courses`` is the number of flight paths, ``bounded`` the recall at bounded risk,
``surest`` the risk-coverage curve, and ``same`` whether a query shows the map's season. Recall at a
threshold is *judged* if the reference poses are exact enough for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.report.board.cells import (
    Cell,
    cells,
    conditions,
    parts,
    recall_at_risk,
    shared_cells,
)
from benchmark.report.board.difficulty import AXES, Axis, Bin, bin_recall
from benchmark.report.board.pairing import reason_against
from benchmark.report.board.runs import BoardRun, TrackBoard
from benchmark.report.page import compare_paired, figures_of, nees_of, round_figure
from benchmark.report.tables import start_in_words
from benchmark.results.query_result import QueryResult
from benchmark.scoring.intervals import Interval
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import summarize
from benchmark.scoring.uncertainty import risk_coverage
from objconnect.scene.localizer import Status

# Points of a risk-coverage curve on the page.
_POINTS: Final = 50
# Numbers of the statuses in the data of the page; ``board.js`` lists them in the same order.
_STATUS: Final = {Status.OK: 0, Status.FALLBACK: 1, Status.FAILED: 2}


def track_figures(board: TrackBoard) -> dict[str, Any]:
    """Return the numbers of a track that the page shows."""
    return {
        "name": board.track.name,
        "title": board.track.title,
        "parts": parts(board.queries),
        "conditions": conditions(board.queries),
        "methods": board.track.methods,
        "missing": board.missing,
        "cards": [card.model_dump(mode="json") for card in board.cards],
        "datasets": [[place.dataset, ", ".join(place.renders)] for place in board.track.places],
        "queries": _list_queries(board),
        "starts": [
            {
                "name": start,
                "words": start_in_words(start),
                "runs": [_answers(board, run) for run in runs],
                "cells": [_cell(board, cell, runs) for cell in cells(board.queries)],
                "shared": [_cell(board, cell, runs) for cell in shared_cells(board.queries, runs)],
            }
            for start in board.track.starts
            if (runs := [run for run in board.runs if run.start == start])
        ],
    }


def _list_queries(board: TrackBoard) -> dict[str, Any]:
    """Return the list of queries by column, because there are many."""
    places = [place.dataset for place in board.track.places]
    part_names, condition_names = parts(board.queries), conditions(board.queries)
    return {
        "name": [query.row.name for query in board.queries],
        "dataset": [places.index(query.dataset) for query in board.queries],
        "part": [part_names.index(query.row.part) for query in board.queries],
        "condition": [condition_names.index(query.row.condition) for query in board.queries],
        "same": [int(query.same) for query in board.queries],
        "novelty": [query.novelty for query in board.queries],
        **{
            axis.key: [
                round_figure(getattr(query.row.difficulty, axis.key)) for query in board.queries
            ]
            for axis in AXES
        },
    }


def _answers(board: TrackBoard, run: BoardRun) -> dict[str, Any]:
    """Return the errors of every query by column; None for queries without results."""
    answers = run.answers
    return {
        "method": board.track.methods.index(run.method),
        "label": run.label,
        "t": [None if a is None else _round(a.t_err_m) for a in answers],
        "r": [None if a is None else _round(a.r_err_deg) for a in answers],
        "sigma": [None if a is None else _round(a.sigma_t_m) for a in answers],
        "status": [None if a is None else _STATUS[a.status] for a in answers],
    }


def _round(value: float | None) -> float | None:
    """Round a figure to three significant digits, because there are thousands of queries."""
    return None if value is None else float(f"{value:.3g}")


def _cell(board: TrackBoard, cell: Cell, runs: Sequence[BoardRun]) -> dict[str, Any]:
    return {
        "season": cell.season,
        "part": cell.part,
        "queries": len(cell.rows),
        "courses": len(np.unique(board.courses[cell.rows])),
        "places": len(board.datasets_at(cell.rows)),
        "runs": [_run(board, cell, run) for run in runs],
        "pairs": [list(_pairs(board, cell, runs, number)) for number in range(len(THRESHOLDS))],
    }


def _run(board: TrackBoard, cell: Cell, run: BoardRun) -> dict[str, Any] | None:
    """Return the figures of a run in a cell; None if it has no results there."""
    rows = cell.rows[run.has[cell.rows]]
    answers = run.answers_at(rows)
    if not answers:
        return None
    unjudged = run.unjudged(board.datasets_at(rows))
    summary = summarize(answers, unjudged=unjudged)
    judged = [str(threshold) not in unjudged for threshold in THRESHOLDS]
    bounded = [
        recall_at_risk(answers, threshold) if is_judged else None
        for threshold, is_judged in zip(THRESHOLDS, judged, strict=True)
    ]
    return {
        "summary": figures_of(summary),
        "places": len(board.datasets_at(rows)),
        "nees": nees_of(summary.uncertainty),
        "bounded": [None if share is None else _interval(share) for share in bounded],
        "surest": [
            _sample_risk_coverage(answers, k) if is_judged else None
            for k, is_judged in enumerate(judged)
        ],
        "difficulty": [
            [_bin(bins, judged) for bins in zip(*_curves(board, rows, run, axis), strict=True)]
            for axis in AXES
        ],
    }


def _interval(interval: Interval) -> list[float | None]:
    return [None if value is None else round(value, 2) for value in interval]


def _sample_risk_coverage(
    answers: Sequence[QueryResult], threshold_number: int
) -> list[list[float]]:
    """Return points (coverage, share of correct poses) in percent, most certain queries first."""
    curve = risk_coverage(answers, THRESHOLDS[threshold_number])
    chosen = np.unique(np.linspace(0, len(curve) - 1, _POINTS).round().astype(int))
    return [[round(curve[k][0], 1), round(100 - curve[k][1], 1)] for k in chosen]


def _curves(
    board: TrackBoard, rows: NDArray[np.int64], run: BoardRun, axis: Axis
) -> Iterator[list[Bin]]:
    """Yield the bins of an axis at every threshold."""
    bins = axis.bins([getattr(board.queries[row].row.difficulty, axis.key) for row in rows])
    for correct in run.correct:
        yield bin_recall(bins, correct[rows], board.courses[rows].tolist(), len(axis.labels))


def _bin(by_threshold: Sequence[Bin], judged: Sequence[bool]) -> list[Any]:
    """Return a bin's number of queries, then its recall at each threshold; None if unjudged."""
    recalls = [
        found.recall if is_judged else None
        for found, is_judged in zip(by_threshold, judged, strict=True)
    ]
    return [by_threshold[0].queries, *(None if r is None else _interval(r) for r in recalls)]


def _pairs(
    board: TrackBoard, cell: Cell, runs: Sequence[BoardRun], threshold_number: int
) -> Iterator[dict[str, Any]]:
    """Yield the comparison of every two runs on the queries of both, or why there is none."""
    for (a, first), (b, second) in combinations(enumerate(runs), 2):
        both = cell.rows[first.has[cell.rows] & second.has[cell.rows]]
        datasets = dict.fromkeys(board.queries[row].dataset for row in both)
        reason = reason_against(board.track.controls, first, second, datasets)
        if (name := str(THRESHOLDS[threshold_number])) in first.unjudged(datasets):
            reason = f"the reference poses are too inexact to judge {name}"
        if reason:
            yield {"a": a, "b": b, "reason": reason}
        elif len(both):
            before, after = (
                first.correct[threshold_number, both],
                second.correct[threshold_number, both],
            )
            courses = board.courses[both].tolist()
            change = compare_paired(before.tolist(), after.tolist(), courses)
            yield {"a": a, "b": b} | change
