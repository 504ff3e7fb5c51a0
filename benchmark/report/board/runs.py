"""The stored results of a benchmark track, joined with the list of its queries."""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from benchmark.scoring.score import THRESHOLDS, is_correct, list_unjudged
from benchmark.submissions.scoring import read_submissions
from benchmark.submissions.submission import Card
from benchmark.tracks.compact import RESULTS
from benchmark.tracks.courses import track_courses
from benchmark.tracks.description import DESCRIPTION, Track, TrackPlace, load_track
from benchmark.tracks.difficulty import QueryRow
from benchmark.tracks.queries import SEEN, UNSEEN, read_queries
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.progress import progress_bar

log = logging.getLogger(__name__)

# Start, data set and method.
_Key = tuple[str, str, str]

# The track with which the page opens.
FIRST_TRACK: Final = "uav-seasons"

_ENDINGS: Final = (".json.xz", ".json")


@dataclass(frozen=True)
class BoardQuery:
    """A query of a track.

    Attributes:
        dataset: name of its data set.
        row: its row in the track's list of queries.
        course: its flight path, which repeated flights share, see ``benchmark.tracks.courses``.
        same: whether its condition in the results is a condition of the map. Nothing moved in these
            queries: a track flies sessions in which something moved under other conditions.
        novelty: "seen", or one of ``UNSEEN`` if its track holds its condition or its preset out of
            training; None if the track holds out nothing.
    """

    dataset: str
    row: QueryRow
    course: str
    same: bool
    novelty: str | None = None


@dataclass(frozen=True)
class BoardRun:
    """The answers of a method that was given one kind of starting information.

    Attributes:
        start: name of the starting information.
        method: name of the method.
        answers: answer to each query of the track; None in a data set without results.
        declared: whether a user stated the starting information, which nothing verifies.
        authors: who submitted the poses; None for runs of the track's owners.
        results: the results by data set.
    """

    start: str
    method: str
    answers: tuple[QueryResult | None, ...]
    declared: bool = False
    authors: str | None = None
    results: Mapping[str, Results] = field(default_factory=dict, repr=False)

    @property
    def label(self) -> str:
        """Return the name of the method, with its authors, or a note if its start is declared."""
        if self.authors is not None:
            return f"{self.method} (submitted by {self.authors})"
        return f"{self.method} (start as declared)" if self.declared else self.method

    @cached_property
    def has(self) -> NDArray[np.bool_]:
        """Return (N,) whether the run has a result of each query; a failure is a result."""
        return np.array([answer is not None for answer in self.answers], np.bool_)

    def answers_at(self, rows: NDArray[np.int64]) -> list[QueryResult]:
        """Return the answers to the queries of these rows (K,), if they have one."""
        return [answer for row in rows if (answer := self.answers[row]) is not None]

    def unjudged(self, datasets: Collection[str]) -> tuple[str, ...]:
        """Return the thresholds for which reference poses of these data sets are too inexact.

        Data sets without results of this run are ignored.
        """
        found = (self.results[name] for name in datasets if name in self.results)
        return tuple(dict.fromkeys(text for run in found for text in run.dataset.unjudged))

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
        missing: sentences that name starts, methods and data sets without results, and submissions
            that are left out.
        cards: what the authors of submissions state.
    """

    folder: Path
    track: Track
    queries: tuple[BoardQuery, ...]
    runs: tuple[BoardRun, ...]
    missing: tuple[str, ...]
    cards: tuple[Card, ...] = ()

    @cached_property
    def courses(self) -> NDArray[np.str_]:
        """Return (N,) the course of each query."""
        return np.array([query.course for query in self.queries])

    def datasets_at(self, rows: NDArray[np.int64]) -> tuple[str, ...]:
        """Return the data sets of the queries of these rows (K,)."""
        return tuple(dict.fromkeys(self.queries[row].dataset for row in rows))


def read_boards(folder: Path) -> list[TrackBoard]:
    """Read all tracks of a folder, ``FOLDER/<track>/track.yaml`` and what lies beside it.

    Tracks with results come before tracks without. In each group, ``FIRST_TRACK`` comes first, and
    the others follow by name.

    Raises:
        InputError: there is no track, a file is damaged, or results are not of the track's data.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder: give the folder of the tracks with --board")
    names = sorted(path.parent.name for path in folder.glob(f"*/{DESCRIPTION}"))
    if not names:
        raise InputError(f"folder of tracks {folder} holds no track (<track>/{DESCRIPTION})")
    boards = [read_board(name, folder) for name in names]
    return sorted(boards, key=lambda board: (not board.runs, board.track.name != FIRST_TRACK))


def read_board(name: str, tracks_folder: Path) -> TrackBoard:
    """Read one track.

    Combinations of prior, method and data set without results are listed as missing. A method that
    has results of only a few data sets is shown with the queries of these. A damaged submission is
    left out and listed as missing too.

    Raises:
        InputError: a file is damaged, results are of other data than the track names, or a query is
            in the results and not in the track's list, or the other way round.
    """
    track = load_track(name, tracks_folder)
    folder = tracks_folder / name
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
    submissions, left_out = read_submissions(track, tracks_folder)
    missing += left_out
    cards = tuple(scored.submission.card for scored in submissions)
    authors = {card.method: card.authors for card in cards}
    for card, scored in zip(cards, submissions, strict=True):
        for dataset, results in scored.results.items():
            loaded[card.start, dataset, card.method] = results
    track = track.model_copy(update={"methods": (*track.methods, *authors)})
    queries = tuple(_queries(folder, track, loaded))
    for line in missing:
        log.warning("%s: %s", track.name, line)
    runs = tuple(_runs(track, queries, loaded, authors))
    return TrackBoard(folder, track, queries, runs, tuple(missing), cards)


def _missing(track: Track, paths: Mapping[_Key, Path | None]) -> Iterator[str]:
    """Yield a sentence for the places that were not rendered yet, and one for each start and method
    that lacks results of a rendered place."""
    has_results = {dataset for (_, dataset, _), path in paths.items() if path is not None}
    known = [p for p in track.places if p.renders or p.dataset in has_results]
    if later := [place.dataset for place in track.places if place not in known]:
        count = f"{len(later)} of {len(track.places)} places"
        yield f"{count} are not rendered yet: {', '.join(later)}"
    names = [place.dataset for place in known]
    for start in track.starts:
        for method in track.methods:
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
    # lexists is true of a broken link: reading it then fails, instead of listing it as missing.
    return next((path for path in paths if os.path.lexists(path)), None)


def _read(path: Path, start: str, place: TrackPlace) -> Results:
    """Read results and refuse those of another render or start.

    The error of the reference poses that the track states decides which thresholds are unjudged.
    Stored summaries are not computed again, because the page pools queries.
    """
    results = load(path)
    if place.renders and results.dataset.sha256 not in place.renders:
        raise InputError(
            f"results {path} are of data set {results.dataset.sha256[:12]}, but the track's "
            f"{place.dataset} is {place.renders[0][:12]}: evaluate again on the track's data"
        )
    if results.start != start:
        raise InputError(
            f"results {path} are from start {results.start}, not {start}: store them with "
            "'objconnect leaderboard --store', which chooses the folder"
        )
    if place.reference_error is None:
        return results
    unjudged = {"unjudged": list_unjudged(place.reference_error)}
    return results.model_copy(update={"dataset": results.dataset.model_copy(update=unjudged)})


def _queries(folder: Path, track: Track, loaded: Mapping[_Key, Results]) -> Iterator[BoardQuery]:
    """Yield the queries of all places that have results."""
    course_of = track_courses(folder, track)
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
            flight = f"{place.dataset}/{row.flight}"
            course = course_of.get(flight, flight)
            yield BoardQuery(place.dataset, row, course, same, _novelty(track, place, row))


def _novelty(track: Track, place: TrackPlace, row: QueryRow) -> str | None:
    """Return "seen", or whether the track holds out the condition, the preset or both."""
    if track.held_out is None:
        return None
    condition = track.held_out.has_condition(row.condition)
    preset = place.preset in track.held_out.presets
    unseen_condition, unseen_place, unseen_both = UNSEEN
    if condition and preset:
        return unseen_both
    return unseen_condition if condition else unseen_place if preset else SEEN


def _check_queries(path: Path, rows: Mapping[str, QueryRow], what: str, run: Results) -> None:
    """Check that the results and the list hold the same queries."""
    answered = {query.name: None for query in run.queries}
    for name in answered:
        if name not in rows:
            raise InputError(
                f"{path} has no row for {name}, which is in the results of {what}: record the "
                "queries again with 'objconnect track --update'"
            )
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
    authors: Mapping[str, str],
) -> Iterator[BoardRun]:
    """Yield the runs of all starts and methods that have results."""
    for start in track.starts:
        for method in track.methods:
            results = {
                dataset: run
                for (its_start, dataset, its_method), run in loaded.items()
                if (its_start, its_method) == (start, method)
            }
            answers = {
                (dataset, answer.name): answer
                for dataset, run in results.items()
                for answer in run.queries
            }
            if answers:
                run_answers = tuple(_set_course(answers, query) for query in queries)
                declared = any(run.method.is_external for run in results.values())
                yield BoardRun(start, method, run_answers, declared, authors.get(method), results)


def _set_course(
    answers: Mapping[tuple[str, str], QueryResult], query: BoardQuery
) -> QueryResult | None:
    """Return the answer to a query, with its course within the track."""
    answer = answers.get((query.dataset, query.row.name))
    return answer and answer.model_copy(update={"course": query.course})
