"""Tables that compare results, one per data set and starting information."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.results.results import DatasetId, Results, rescore
from benchmark.results.results_files import load, results_files
from benchmark.scoring.score import THRESHOLDS
from benchmark.scoring.summary import Summary
from objconnect.scene.bundle.manifest import ALL_CONDITIONS
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.digests import sha256_of

log = logging.getLogger(__name__)

# The classical reference method, and the recall in percent from which a threshold is saturated.
_REFERENCE: Final = "sift"
_SATURATED: Final = 99.0

ALL: Final = ALL_CONDITIONS
AS_DECLARED: Final = "as declared, not verified,"
_STARTS: Final = {
    "prior": "each query's own prior",
    "none": "no prior",
    "retrieval": "the {} map photographs most like it, by VLAD of SIFT",
    "pairs": "map photographs of the pair list {}",
    "error": "a prior wrong by {}",
    "gravity": "roll and pitch alone, wrong by {}",
    "gps": "the position alone, wrong by {}",
}
# Starts whose value is the size of an error, as "3m,5deg".
_ERROR_STARTS: Final = frozenset(("error", "gravity", "gps"))
_METRES: Final = re.compile(r"(?<=\d)m\b")


@dataclass(frozen=True)
class Run:
    """A results file, with the label that distinguishes it within its group."""

    label: str
    path: Path
    results: Results


@dataclass(frozen=True)
class Group:
    """Runs that can be compared: on an identical data set, with the same starting information."""

    track: str
    dataset: str
    sha256: str
    start: str
    map_conditions: tuple[str, ...]
    runs: tuple[Run, ...]

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Return the thresholds for which the reference poses are too inexact."""
        return self.runs[0].results.dataset.unjudged


@dataclass(frozen=True)
class Row:
    """A line of a table: the figures of a method under one condition, or under "all"."""

    method: str
    condition: str
    summary: Summary


@dataclass(frozen=True)
class Table:
    """The table of a group.

    ``declared`` are methods whose starting information a user stated, which nothing verifies.
    ``unjudged`` are the thresholds for which the reference poses are too inexact.
    """

    track: str
    dataset: str
    sha256: str
    start: str
    map_conditions: tuple[str, ...]
    rows: tuple[Row, ...]
    declared: tuple[str, ...] = ()
    unjudged: tuple[str, ...] = ()

    def facts(self) -> str:
        """Return one line of facts that hold for every row."""
        start = start_in_words(self.start)
        if self.declared:
            start += f" ({AS_DECLARED} for {', '.join(self.declared)})"
        facts = (
            f"Start: {start}. Map: {', '.join(self.map_conditions)}. "
            f"Data set {self.sha256[:12]} (first digits of its SHA-256 digest)."
        )
        if self.unjudged:
            facts += f" The reference poses are too inexact to judge {' and '.join(self.unjudged)}."
        return facts


def groups(results: Sequence[Path]) -> list[Group]:
    """Group results by track, data set and starting information.

    Args:
        results: results files, or folders of them.

    Raises:
        InputError: there are no results, a file is not a results file or its summaries do not
            match its per-query results, or two files of one run differ.
    """
    loaded: dict[tuple[str, str, str, str], list[tuple[Path, Results]]] = {}
    for path, run in _load_distinct([file for source in results for file in results_files(source)]):
        key = (run.dataset.track, run.dataset.name, run.dataset.sha256, run.start)
        loaded.setdefault(key, []).append((path, run))
    _warn_of_versions(key[:3] for key in loaded)
    return [
        Group(*key, members[0][1].dataset.map_conditions, tuple(_runs(_unify_unjudged(members))))
        for key, members in sorted(loaded.items(), key=lambda item: item[0])
    ]


def table(group: Group) -> Table:
    """Return the table of a group, with a row for each method and condition."""
    return Table(
        group.track,
        group.dataset,
        group.sha256,
        group.start,
        group.map_conditions,
        tuple(row for run in group.runs for row in _rows(run)),
        tuple(run.label for run in group.runs if run.results.method.is_external),
        group.unjudged,
    )


def tables(results: Sequence[Path]) -> list[Table]:
    """Return all tables of the leaderboard.

    Raises:
        InputError: for the reasons of ``groups``.
    """
    return [table(group) for group in groups(results)]


def start_in_words(start: str) -> str:
    """Return a start in words: the information on each query that the methods had."""
    kind, _, value = start.partition("=")
    if kind in _ERROR_STARTS:
        value = _METRES.sub(" m", value).replace("deg", "°").replace(",", " and ")
    return _STARTS.get(kind, start).format(value)


def saturation(table: Table) -> str | None:
    """Return a note on the thresholds that ``sift`` saturates; None if there are none."""
    reference_rows = [
        row
        for row in table.rows
        if row.method.split()[0] == _REFERENCE and row.condition in table.map_conditions
    ]
    notes = []
    for condition in dict.fromkeys(row.condition for row in reference_rows):
        saturated = [
            str(threshold)
            for threshold in THRESHOLDS
            if any(
                row.condition == condition
                and (share := row.summary.recall[threshold.key]) is not None
                and share.value >= _SATURATED
                for row in reference_rows
            )
        ]
        if saturated:
            notes.append(
                f"Saturated: under `{_code(condition)}`, the map's own condition, `{_REFERENCE}` "
                f"already reaches {_SATURATED:g} % or more at {', '.join(saturated)}; another "
                "method can hardly exceed it there."
            )
    return "\n".join(notes) or None


def _code(name: str) -> str:
    """Return a name that can stand between the backticks of Markdown."""
    return for_terminal(name).replace("`", "'")


def _load_distinct(files: Sequence[Path]) -> Iterator[tuple[Path, Results]]:
    """Yield every run once, because queries that are counted twice make intervals too narrow."""
    by_bytes: dict[str, Path] = {}
    by_run: dict[str, Path] = {}
    for path in files:
        results = load(path)
        earlier = by_bytes.setdefault(sha256_of(path), path)
        if earlier is not path:
            log.warning("%s holds the same results as %s: they count once", path, earlier)
            continue
        first = by_run.setdefault(_run_key(results), path)
        if first is not path:
            raise InputError(
                f"{first} and {path} are two results of {results.method.name} with one "
                f"configuration on one data set ({results.dataset.name}) from one start: give one "
                "of them"
            )
        yield path.resolve(), results


def _run_key(results: Results) -> str:
    """Return a key that is equal for two results of the same run."""
    dataset, start = results.dataset.sha256, results.start
    queries = [query.name for query in results.queries]
    return json.dumps([dataset, start, queries, results.method.model_dump()], sort_keys=True)


def _warn_of_versions(datasets: Iterable[tuple[str, str, str]]) -> None:
    """Log which data sets (track, name, digest) share a name.

    They may be versions of one data set, and each has tables of its own.
    """
    versions: dict[tuple[str, str], dict[str, None]] = {}
    for track, name, sha256 in datasets:
        versions.setdefault((track, name), {})[sha256[:12]] = None
    for (_, name), digests in versions.items():
        if len(digests) > 1:
            log.warning(
                "results are of %d data sets called %s (%s): each has tables of its own; if it is "
                "one data set that was changed, leave out the earlier results",
                len(digests),
                name,
                ", ".join(digests),
            )


def _rows(run: Run) -> Iterator[Row]:
    if len(run.results.by_condition) > 1:
        yield Row(run.label, ALL, run.results.summary)
    for condition, summary in run.results.by_condition.items():
        yield Row(run.label, condition, summary)


def _unify_unjudged(members: Sequence[tuple[Path, Results]]) -> list[tuple[Path, Results]]:
    """Apply the longest list of unjudged thresholds in a group to all its results.

    The error of the reference poses may be stated after some results were written.
    """
    stated = max((run.dataset.unjudged for _, run in members), key=len)
    return [
        (path, run)
        if run.dataset.unjudged == stated
        else (path, rescore(run.model_copy(update={"dataset": _set_unjudged(run, stated)})))
        for path, run in members
    ]


def _set_unjudged(run: Results, unjudged: tuple[str, ...]) -> DatasetId:
    return run.dataset.model_copy(update={"unjudged": unjudged})


def _runs(members: Sequence[tuple[Path, Results]]) -> Iterator[Run]:
    """Yield the results of a group as runs, labelled by method and differing settings."""
    for path, run in sorted(members, key=lambda pair: pair[1].method.name):
        namesakes = [other for _, other in members if other.method.name == run.method.name]
        yield Run(_label(run, namesakes), path, run)


def _label(run: Results, namesakes: Sequence[Results]) -> str:
    """Return the method's name, with the settings that differ from other runs of the method."""
    settings = _settings(run)
    other_settings = [_settings(other) for other in namesakes]
    # A nested option that an older run lacks does not count as different.
    differing = [
        key
        for key, value in settings.items()
        if any(other.get(key, value if "." in key else None) != value for other in other_settings)
    ]
    if not differing:
        return run.method.name
    return f"{run.method.name} ({', '.join(f'{key}={settings[key]}' for key in differing)})"


def _flat(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a nested configuration by their dotted keys."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _settings(run: Results) -> dict[str, Any]:
    """Return the settings of a run; those of nested configurations by dotted keys."""
    weights = run.method.weights_sha256
    return dict(_flat(run.method.config)) | ({"weights": weights[:8]} if weights else {})
