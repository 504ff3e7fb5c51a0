"""The leaderboard as one HTML page that needs no network and no server.

The page is made of ``templates/page.html``, ``page.css`` and ``page.js`` on top of ``shared``. All
figures are inserted as one block of JSON, and the script shows them as text only.
"""

from __future__ import annotations

import base64
import io
import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmark.evaluation.basin import Basin, load_basin
from benchmark.report.album import ALBUM, SIDE, Album, Entry, read_album, webp
from benchmark.report.paper import TITLE, Line, columns, note, side_by_side
from benchmark.report.self_contained import fill
from benchmark.report.tables import ALL, Group, Run, saturation, start_in_words, table
from benchmark.results.query_result import TOTAL, QueryResult
from benchmark.results.results_files import BASIN
from benchmark.scoring.clustered import difference_interval, permutation_p
from benchmark.scoring.paired import compare
from benchmark.scoring.score import THRESHOLDS, is_correct
from benchmark.scoring.summary import Percentage, Summary, Uncertainty
from benchmark.scoring.uncertainty import risk_coverage
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Status
from objconnect.scene.runtime.progress import progress_bar

log = logging.getLogger(__name__)

# Greatest size of all encoded photographs of a page. With the figures of 4 methods and 500 queries,
# which take less than 2 MB, a page stays below 15 MB.
PICTURE_BYTES: Final = 11_000_000
# Photographs are shrunk until they fit, but not to a longest side below this, pixels.
_MIN_SIDE: Final = 200
# The bytes of a photograph grow as its side to this power; on real flights it is 1.6 to 1.9.
_GROWTH: Final = 1.6
_BASE64: Final = 4 / 3
# Length of a photograph's longest side in the coordinates of drawings over it.
_UNITS: Final = 1000


def page(groups: Sequence[Group]) -> str:
    """Return the page.

    Args:
        groups: groups of runs. Thumbnails and basins of convergence are read beside their results.

    Raises:
        InputError: an album or a basin is damaged.
    """
    albums = [_album(group) for group in groups]
    photographs = _PagePhotographs(groups, albums)
    data = {
        "thresholds": [{"key": t.key, "text": str(t)} for t in THRESHOLDS],
        "boards": [
            _group_data(group, album, photographs)
            for group, album in zip(groups, albums, strict=True)
        ],
        "paper": paper_of(columns(), note(), side_by_side(groups)),
        "pictures": photographs.pictures,
    }
    return fill("page", data, base="shared")


def paper_of(columns: Sequence[str], note: str, lines: Sequence[Line]) -> dict[str, Any]:
    """Return the object-connect paper's table, beside the figures of this project, for a page."""
    return {
        "title": TITLE,
        "note": note,
        "columns": columns,
        "lines": [
            {
                "method": line.method,
                "source": line.source,
                "reported": line.reported,
                "cells": [
                    None if cell is None else {"value": cell.value, "text": cell.text()}
                    for cell in line.cells
                ],
            }
            for line in lines
        ],
    }


def _group_data(group: Group, album: Album | None, photographs: _PagePhotographs) -> dict[str, Any]:
    """Return the data of the page for a group of runs."""
    names = list(dict.fromkeys(q.name for run in group.runs for q in run.results.queries))
    condition_of = {q.name: q.condition for run in group.runs for q in run.results.queries}
    conditions = sorted(set(condition_of.values()))
    entries = {} if album is None else album.entries
    group_table = table(group)
    return {
        "track": group.track,
        "dataset": group.dataset,
        "start": start_in_words(group.start),
        "facts": group_table.facts(),
        "note": saturation(group_table) or "",
        "conditions": conditions,
        "map_conditions": group.map_conditions,
        "queries": [
            {
                "name": name,
                "condition": conditions.index(condition_of[name]),
                **_pictures(entries.get(name), album, photographs),
            }
            for name in names
        ],
        "runs": [_run(run, names, entries) for run in group.runs],
        "pairs": list(_pairs(group, names, [ALL, *conditions])),
        "pairs_note": _pairs_note(group),
    }


def _run(run: Run, names: Sequence[str], entries: Mapping[str, Entry]) -> dict[str, Any]:
    """Return the data of the page for a run; queries are in the order of ``names``."""
    results = run.results
    by_name = {query.name: query for query in results.queries}
    return {
        "label": run.label,
        "config": json.dumps(results.method.config),
        "weights": results.method.weights_sha256,
        "environment": results.environment.model_dump(),
        "summaries": {
            ALL: figures_of(results.summary),
            **{name: figures_of(part) for name, part in results.by_condition.items()},
        },
        # Queries that a run lacks are null; they count as failed where runs are paired.
        "queries": [
            _query(by_name[name], entries.get(name)) if name in by_name else None for name in names
        ],
        "basin": _basin(run),
        # Percentage of correct poses among the most certain k, at every judged threshold.
        "surest": [
            None
            if str(threshold) in results.dataset.unjudged
            else [round(100 - risk, 1) for _, risk in risk_coverage(results.queries, threshold)]
            for threshold in THRESHOLDS
        ],
        "nees": nees_of(results.summary.uncertainty),
    }


def nees_of(figures: Uncertainty | None) -> dict[str, Any] | None:
    """Return the consistency of covariances as a page shows it; None without any."""
    if figures is None:
        return None
    return {
        "mean": [round_figure(x) for x in (figures.nees_mean, figures.nees_low, figures.nees_high)],
        "median": round_figure(figures.nees_median),
        "queries": figures.queries,
        "within": _recall(figures.within_95),
    }


def figures_of(summary: Summary) -> dict[str, Any]:
    """Return the figures of queries as a page shows them."""
    return {
        "queries": summary.queries,
        "courses": summary.courses,
        "recall": [_recall(summary.recall[threshold.key]) for threshold in THRESHOLDS],
        "integrity": [_recall(share) for share in summary.integrity()],
        "t": round_figure(summary.median_t_m),
        "r": round_figure(summary.median_r_deg),
        "failed": summary.failed,
        "fallback": summary.fallback,
        "seconds": round_figure(summary.seconds.per_query.get(TOTAL)),
        "memory": round_figure(summary.peak_memory_mb),
    }


def _query(query: QueryResult, entry: Entry | None) -> dict[str, Any]:
    """Return the data of the page for the answer to a query."""
    points: list[int | None] = []
    if entry is not None and query.cam_from_world is not None:
        numbers = query.cam_from_world
        pose = Pose.from_quaternion(numbers[:4], numbers[4:])
        points = _units(entry.project_at(pose), entry.camera.width, entry.camera.height)
    return {
        "status": query.status.value,
        "reason": query.reason,
        "t": round_figure(query.t_err_m),
        "r": round_figure(query.r_err_deg),
        "sigma": round_figure(query.sigma_t_m),
        "seconds": round_figure(query.seconds.get(TOTAL)),
        "inliers": query.inliers,
        "points": points,
    }


def _pictures(
    entry: Entry | None, album: Album | None, photographs: _PagePhotographs
) -> dict[str, Any]:
    """Return the photographs of a query and its neighbour as the page shows them."""
    if entry is None or album is None:
        return {}
    camera = entry.camera
    shown: dict[str, Any] = {
        "picture": photographs.number(entry.photograph),
        "size": [camera.width, camera.height],
        "truth": _units(entry.truth, camera.width, camera.height),
    }
    if entry.neighbour is not None:
        neighbour = album.neighbours[entry.neighbour]
        shown["beside"] = {
            "name": entry.neighbour,
            "picture": photographs.number(neighbour.photograph),
            "size": [neighbour.width, neighbour.height],
            "points": _units(entry.seen, neighbour.width, neighbour.height),
        }
    return shown


def _units(xy: NDArray[np.float64], width: int, height: int) -> list[int | None]:
    """Return pixels (K, 2) as x, y, x, y ... in thousandths of the longest side.

    Pixels that are unknown or far outside the picture are null.
    """
    scaled = np.round(xy * (_UNITS / max(width, height)))
    known = np.isfinite(scaled).all(1) & (np.abs(np.nan_to_num(scaled)) < 3 * _UNITS).all(1)
    return [
        int(value) if good else None
        for row, good in zip(scaled.tolist(), known.tolist(), strict=True)
        for value in row
    ]


def _pairs(
    group: Group, names: Sequence[str], conditions: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Yield the change from the first to the second of every two runs.

    There is one entry for each condition and threshold that the reference poses judge.
    """
    queries_of = [{query.name: query for query in run.results.queries} for run in group.runs]
    known = {name: query for queries in queries_of for name, query in queries.items()}
    for condition in conditions:
        listed = [name for name in names if condition in (ALL, known[name].condition)]
        courses = [known[name].course_name for name in listed]
        for number, threshold in enumerate(THRESHOLDS):
            if str(threshold) in group.unjudged:
                continue
            correct = [
                [name in queries and is_correct(queries[name], threshold) for name in listed]
                for queries in queries_of
            ]
            for a, b in combinations(range(len(correct)), 2):
                where = {"condition": condition, "threshold": number, "a": a, "b": b}
                yield where | compare_paired(correct[a], correct[b], courses)


def compare_paired(
    before: Sequence[bool], after: Sequence[bool], courses: Sequence[str]
) -> dict[str, Any]:
    """Return the change of recall between two runs on the same queries, as a page shows it.

    The interval and p treat courses (flight paths) as units; None with one course. The interval is
    at least as wide as for independent queries: courses that change equally have no variance.

    Args:
        before: whether each query is correct in the first run.
        after: whether it is in the second.
        courses: course of each query.
    """
    change = compare(before, after)
    low = high = None
    if (ends := difference_interval(before, after, courses)) is not None:
        low, high = min(change.low, ends[0]), max(change.high, ends[1])
    return {
        "change": round_figure(change.change),
        "low": round_figure(low),
        "high": round_figure(high),
        "p": round_figure(permutation_p(before, after, courses)),
        "lost": change.lost,
        "won": change.won,
        "courses": len(set(courses)),
    }


def _pairs_note(group: Group) -> str:
    courses = len({query.course_name for run in group.runs for query in run.results.queries})
    if courses == 1:
        return "All queries are of one course, so intervals and p are unknown."
    return (
        f"Intervals are by course ({courses} here); p is from a permutation test that exchanges "
        "the methods course by course, and is at least 2 / 2^k with k courses."
    )


def _basin(run: Run) -> list[dict[str, Any]] | None:
    """Return the basin beside a run's results by size of error; None if there is none."""
    path = run.path.with_name(run.path.stem + BASIN)
    if not path.is_file():
        return None
    basin: Basin = load_basin(path)
    if (basin.dataset.sha256, basin.method) != (run.results.dataset.sha256, run.results.method):
        log.warning("%s is left out: it is of another method or data set than the results", path)
        return None
    return [
        {
            "t": level.prior_t_m,
            "r": level.prior_r_deg,
            "queries": level.queries,
            "recall": [
                None if str(t) in run.results.dataset.unjudged else _recall(level.recall(t.key))
                for t in THRESHOLDS
            ],
        }
        for level in basin.levels
    ]


def _recall(recall: Percentage | None) -> list[float | None] | None:
    if recall is None:
        return None
    # The page rounds to one decimal, which gives the same from six decimals as from all.
    ends = (recall.value, recall.low, recall.high)
    return [None if x is None else round(x, 6) for x in ends]


def round_figure(value: float | None) -> float | None:
    """Round a figure to four significant digits; None where it is unknown or not finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.4g}")


def _album(group: Group) -> Album | None:
    """Return the first album of the group's data set beside one of its results files."""
    albums = (read_album(run.path.with_name(ALBUM), group.sha256) for run in group.runs)
    return next((album for album in albums if album is not None), None)


class _PagePhotographs:
    """The photographs that fit on a page; those of the worst and the best queries come first.

    Attributes:
        pictures: encoded photographs.
    """

    def __init__(self, groups: Sequence[Group], albums: Sequence[Album | None]) -> None:
        ranked = list(dict.fromkeys(_iterate_by_rank(groups, albums)))
        total = sum(len(photograph) for photograph in ranked) * _BASE64
        side = max(_MIN_SIDE, math.floor(SIDE * (PICTURE_BYTES / max(total, 1)) ** (1 / _GROWTH)))
        self.pictures: list[str] = []
        self._numbers: dict[bytes, int] = {}
        bytes_left = PICTURE_BYTES
        with progress_bar("photographs", len(ranked)) as advance:
            for done, photograph in enumerate(ranked, 1):
                shrunk = photograph if side >= SIDE else shrink(photograph, side)
                text = "data:image/webp;base64," + base64.b64encode(shrunk).decode()
                if len(text) > bytes_left:
                    break
                bytes_left -= len(text)
                self._numbers[photograph] = len(self.pictures)
                self.pictures.append(text)
                advance(done)

    def number(self, photograph: bytes) -> int | None:
        """Return the index of a photograph in ``pictures``; None if it did not fit."""
        return self._numbers.get(photograph)


def shrink(photograph: bytes, side: int) -> bytes:
    """Encode a photograph again, as WebP whose longest side is at most ``side`` pixels."""
    with Image.open(io.BytesIO(photograph)) as image:
        return webp(np.asarray(image.convert("RGB")), side)


def _iterate_by_rank(groups: Sequence[Group], albums: Sequence[Album | None]) -> Iterator[bytes]:
    """Yield the photographs of every run's worst query, its best, its second worst, and so on."""
    ranked = [
        (album, [query.name for query in sorted(run.results.queries, key=_badness)])
        for group, album in zip(groups, albums, strict=True)
        if album is not None
        for run in group.runs
    ]
    for rank in range(max((len(names) for _, names in ranked), default=0)):
        for album, names in ranked:
            if rank >= len(names):
                continue
            # Ranks 0, 1, 2, 3 are the last name, the first, the last but one, the second.
            name = names[rank // 2] if rank % 2 else names[-1 - rank // 2]
            if (entry := album.entries.get(name)) is not None:
                yield entry.photograph
                if entry.neighbour is not None:
                    yield album.neighbours[entry.neighbour].photograph


def _badness(query: QueryResult) -> tuple[bool, bool, float]:
    """Return a sort key: localized queries by position error, then fallbacks, then failures."""
    return query.t_err_m is None, query.status is not Status.OK, query.t_err_m or 0.0
