"""The committed results of a track, joined with the list of its queries."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from benchmark.scoring.score import THRESHOLDS, is_correct
from benchmark.tracks.compact import RESULTS
from benchmark.tracks.description import DESCRIPTION, Track, TrackPlace, load_track
from benchmark.tracks.difficulty import QueryRow
from benchmark.tracks.queries import read_queries
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.progress import progress_bar

log = logging.getLogger(__name__)

# Start, data set and method.
_Key = tuple[str, str, str]

# The track with which the page opens.
OPENING: Final = "uav-seasons"

_ENDINGS: Final = (".json.xz", ".json")


@dataclass(frozen=True)
class BoardQuery:
    """A query of a track.

    Attributes:
        dataset: name of its data set.
        row: what the track says of it.
        same: whether its results say that its condition is the map's. Sessions of a track in which
            something moved are under other conditions.
    """

    dataset: str
    row: QueryRow
    same: bool


@dataclass(frozen=True)
class BoardRun:
    """The answers of a method from one start.

    Attributes:
        start: name of the starting information.
        method: name of the method.
        answers: answer to each query of the track; None in a data set without results.
        declared: whether the start is one that somebody declared, and nothing verifies.
    """

    start: str
    method: str
    answers: tuple[QueryResult | None, ...]
    declared: bool = False

    @property
    def label(self) -> str:
        """Return the name of the method, which says where its start is declared."""
        return f"{self.method} (start as declared)" if self.declared else self.method

    @cached_property
    def has(self) -> NDArray[np.bool_]:
        """Return (N,) whether each query has an answer, be it a failure."""
        return np.array([answer is not None for answer in self.answers], np.bool_)

    def of(self, rows: NDArray[np.int64]) -> list[QueryResult]:
        """Return the answers to some queries, without those that have none."""
        return [answer for row in rows if (answer := self.answers[row]) is not None]

    @cached_property
    def correct(self) -> NDArray[np.bool_]:
        """Return (T, N) whether each query is correct at each threshold."""
        return np.array(
            [[a is not None and is_correct(a, t) for a in self.answers] for t in THRESHOLDS],
            np.bool_,
        )


@dataclass(frozen=True)
class TrackBoard:
    """A track with its results.

    Attributes:
        folder: folder of the track.
        track: description of the track.
        queries: queries of all data sets that have results.
        runs: runs in the order of the track's starts and methods.
        missing: what has no results, one sentence each.
    """

    folder: Path
    track: Track
    queries: tuple[BoardQuery, ...]
    runs: tuple[BoardRun, ...]
    missing: tuple[str, ...]

    @cached_property
    def flights(self) -> NDArray[np.str_]:
        """Return (N,) the flight of each query, with its data set."""
        return np.array([f"{query.dataset}/{query.row.flight}" for query in self.queries])


def read_boards(folder: Path) -> list[TrackBoard]:
    """Read all tracks of a folder, ``FOLDER/<track>/track.yaml`` and what lies beside it.

    Tracks with results come first, among them the one of aircraft, with which the page opens; the
    others follow in the order of their names.

    Raises:
        InputError: there is no track, a file is damaged, or results are not of the track's data.
    """
    if not folder.is_dir():
        raise InputError(f"board {folder} does not exist, or is no folder")
    names = sorted(path.parent.name for path in folder.glob(f"*/{DESCRIPTION}"))
    if not names:
        raise InputError(f"board {folder} holds no track (<track>/{DESCRIPTION})")
    boards = [read_board(name, folder) for name in names]
    return sorted(boards, key=lambda board: (not board.runs, board.track.name != OPENING))


def read_board(name: str, board: Path) -> TrackBoard:
    """Read one track.

    A start without any results of a method is one that the method cannot take. A method that has
    results of some data sets only is shown with the queries it has, and is listed as missing.

    Raises:
        InputError: a file is damaged, results are of other data than the track names, or a query is
            in the results and not in the track's list, or the other way round.
    """
    track = load_track(name, board)
    folder = board / name
    paths = {
        (start, place.dataset, method): _results_path(
            folder / RESULTS / start / place.dataset, method
        )
        for start in track.starts
        for method in track.methods
        for place in track.places
    }
    missing = list(_missing(track, paths))
    loaded = _load(track, {key: path for key, path in paths.items() if path is not None})
    if not loaded:
        missing = ["no results yet"]
    queries = tuple(_queries(folder, track, loaded))
    for line in missing:
        log.warning("%s: %s", track.name, line)
    return TrackBoard(folder, track, queries, tuple(_runs(track, queries, loaded)), tuple(missing))


def _missing(track: Track, paths: Mapping[_Key, Path | None]) -> Iterator[str]:
    """Yield a sentence for each start and method that lacks results of a data set."""
    for start in track.starts:
        for method in track.methods:
            names = [place.dataset for place in track.places]
            lacking = [name for name in names if paths[start, name, method] is None]
            if lacking:
                which = "any data set" if lacking == names else ", ".join(lacking)
                yield f"no results of {method} from start {start} on {which}"


def _load(track: Track, paths: Mapping[_Key, Path]) -> dict[_Key, Results]:
    places = {place.dataset: place for place in track.places}
    loaded = {}
    with progress_bar(f"{track.name} results", len(paths)) as advance:
        for (start, dataset, method), path in paths.items():
            loaded[start, dataset, method] = _read(path, start, places[dataset])
            advance(len(loaded))
    return loaded


def _results_path(folder: Path, method: str) -> Path | None:
    paths = (folder / f"{method}{ending}" for ending in _ENDINGS)
    # lexists: a broken link is refused by the reader, not reported as missing.
    return next((path for path in paths if os.path.lexists(path)), None)


def _read(path: Path, start: str, place: TrackPlace) -> Results:
    results = load(path)
    if place.renders and results.dataset.sha256 not in place.renders:
        raise InputError(
            f"results {path} are of data set {results.dataset.sha256[:12]}, but the track's "
            f"{place.dataset} is {place.renders[0][:12]}: evaluate again on the track's data"
        )
    if results.start != start:
        raise InputError(f"results {path} are from start {results.start}, not {start}")
    return results


def _queries(folder: Path, track: Track, loaded: Mapping[_Key, Results]) -> Iterator[BoardQuery]:
    for place in track.places:
        runs = {key: run for key, run in loaded.items() if key[1] == place.dataset}
        if not runs:
            continue
        path = folder / "queries" / f"{place.dataset}.csv"
        rows = {row.name: row for row in read_queries(path)}
        for (start, _, method), run in runs.items():
            _check_queries(path, rows, f"{method} from start {start}", run)
        run = next(iter(runs.values()))
        condition = {query.name: query.condition for query in run.queries}
        for row in rows.values():
            same = condition[row.name] in run.dataset.map_conditions
            yield BoardQuery(place.dataset, row, same)


def _check_queries(path: Path, rows: Mapping[str, QueryRow], what: str, run: Results) -> None:
    """Check that the results and the list hold the same queries."""
    answered = {query.name: None for query in run.queries}
    for name in answered:
        if name not in rows:
            raise InputError(f"{path} has no row for {name}, which is in the results of {what}")
    lost = [name for name in rows if name not in answered]
    if lost:
        raise InputError(
            f"the results of {what} on {run.dataset.name} lack {len(lost)} queries of {path}, "
            f"{lost[0]} first: evaluate all of them"
        )


def _runs(
    track: Track,
    queries: Sequence[BoardQuery],
    loaded: Mapping[_Key, Results],
) -> Iterator[BoardRun]:
    for start in track.starts:
        for method in track.methods:
            answers = {
                (dataset, answer.name): answer
                for (its_start, dataset, its_method), run in loaded.items()
                if (its_start, its_method) == (start, method)
                for answer in run.queries
            }
            if answers:
                listed = (answers.get((query.dataset, query.row.name)) for query in queries)
                yield BoardRun(start, method, tuple(listed), _is_declared(start, method, loaded))


def _is_declared(start: str, method: str, loaded: Mapping[_Key, Results]) -> bool:
    """Return whether somebody declared the start of a method to ``score``."""
    return any(
        run.method.is_external
        for (its_start, _, its_method), run in loaded.items()
        if (its_start, its_method) == (start, method)
    )
