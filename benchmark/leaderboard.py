"""Results files side by side: one table per data set and starting information."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.results import TOTAL, Recall, Results, Summary, load
from benchmark.score import THRESHOLDS
from scene.errors import InputError
from scene.files import write_text

# The classical method that sets the bar, and the recall (percent) that leaves none to reach.
_BAR: Final = "sift"
_SATURATED: Final = 99.0

_ALL: Final = "all"
_STARTS: Final = {
    "prior": "each query's own prior",
    "none": "no prior",
    "retrieval": "the {} map photographs most like it, by VLAD of SIFT",
    "pairs": "map photographs of the pair list {}",
    "error": "a prior wrong by {}",
}


@dataclass(frozen=True)
class Row:
    """One line of a table: a method under one condition, or under "all" of several."""

    method: str
    condition: str
    summary: Summary


@dataclass(frozen=True)
class Table:
    """Methods that can be compared: the same data set, bit for bit, and the same start."""

    track: str
    dataset: str
    sha256: str
    start: str
    map_conditions: tuple[str, ...]
    rows: tuple[Row, ...]


def leaderboard(results: Sequence[Path], out: Path | None = None) -> str:
    """Compare results files.

    Args:
        results: results files, or folders of them.
        out: where to write ``leaderboard.md``, or None.

    Returns:
        The Markdown text.

    Raises:
        InputError: no results, or a file that is none or whose figures do not follow from its
            queries.
    """
    text = markdown(tables(results))
    if out is not None:
        write_text(out / "leaderboard.md", text)
    return text


def tables(results: Sequence[Path]) -> list[Table]:
    """The leaderboard as data, by track, data set and start.

    Raises:
        InputError: as ``leaderboard``.
    """
    groups: dict[tuple[str, str, str, str], list[Results]] = {}
    for path in dict.fromkeys(file for given in results for file in _files(given)):
        run = load(path)
        key = (run.dataset.track, run.dataset.name, run.dataset.sha256, run.start)
        groups.setdefault(key, []).append(run)
    return [
        Table(*key, group[0].dataset.map_conditions, tuple(_rows(group)))
        for key, group in sorted(groups.items())
    ]


def _files(path: Path) -> list[Path]:
    """The results files below ``RESULTS`` or ``RESULTS/<dataset>``, or the file itself."""
    if path.is_file():
        return [path.resolve()]
    if not path.is_dir():
        raise InputError(f"results {path} do not exist")
    found = sorted(file.resolve() for level in ("*.json", "*/*.json") for file in path.glob(level))
    if not found:
        raise InputError(f"{path} holds no results file (<dataset>/<method>.json)")
    return found


def _rows(group: Sequence[Results]) -> Iterator[Row]:
    for run in sorted(group, key=lambda run: run.method.name):
        name = _label(run, [other for other in group if other.method.name == run.method.name])
        if len(run.by_condition) > 1:
            yield Row(name, _ALL, run.summary)
        for condition, summary in run.by_condition.items():
            yield Row(name, condition, summary)


def _label(run: Results, namesakes: Sequence[Results]) -> str:
    """The method's name, and what sets it apart from other runs of the same method."""
    own = _settings(run)
    differing = [
        key for key in own if any(_settings(other).get(key) != own[key] for other in namesakes)
    ]
    if not differing:
        return run.method.name
    return f"{run.method.name} ({', '.join(f'{key}={own[key]}' for key in differing)})"


def _settings(run: Results) -> dict[str, Any]:
    weights = run.method.weights_sha256
    return run.method.config | ({"weights": weights[:8]} if weights else {})


def markdown(boards: Sequence[Table]) -> str:
    """The leaderboard as Markdown."""
    lines = [
        "# Leaderboard",
        "",
        "Recall is the percentage of all listed queries whose pose is closer than both thresholds, "
        "with its Wilson 95 % interval; failed queries and fallback poses count as wrong. Medians "
        "are over the queries with a pose. Only rows of one table can be compared.",
    ]
    for board in boards:
        lines += ["", f"## {board.track}: {board.dataset}", ""]
        lines += [
            f"Start: {_start(board.start)}. Map: {', '.join(board.map_conditions)}. "
            f"Data set {board.sha256[:12]}.",
            "",
            *_table(board),
        ]
        if note := saturation(board):
            lines += ["", note]
    return "\n".join(lines) + "\n"


def saturation(board: Table) -> str | None:
    """What the table cannot show: thresholds that plain SIFT + PnP leaves no room under."""
    same = [
        row
        for row in board.rows
        if row.method.split()[0] == _BAR and row.condition in board.map_conditions
    ]
    notes = []
    for condition in dict.fromkeys(row.condition for row in same):
        full = [
            str(threshold)
            for threshold in THRESHOLDS
            if any(
                row.condition == condition and row.summary.recall[threshold.key].value >= _SATURATED
                for row in same
            )
        ]
        if full:
            notes.append(
                f"Saturated: under `{condition}`, the map's own condition, SIFT + PnP already "
                f"reaches {_SATURATED:g} % or more at {', '.join(full)}; another method can only "
                "keep up there."
            )
    return "\n".join(notes) or None


def _start(name: str) -> str:
    """The starting information in words."""
    kind, _, value = name.partition("=")
    return _STARTS.get(kind, name).format(value)


def _table(board: Table) -> Iterator[str]:
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["method", "condition", "queries", *recalls, "median m", "median °"]
    header += ["failed + fallback", "s/query"]
    yield _line(header)
    yield _line(["---", "---", *["--:"] * (len(header) - 2)])
    for row in board.rows:
        summary = row.summary
        yield _line(
            [
                row.method,
                row.condition,
                str(summary.queries),
                *(_recall(summary.recall[threshold.key]) for threshold in THRESHOLDS),
                _number(summary.median_t_m),
                _number(summary.median_r_deg),
                f"{summary.failed} + {summary.fallback}",
                _number(summary.seconds.per_query.get(TOTAL)),
            ]
        )


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _recall(recall: Recall) -> str:
    return f"{recall.value:.1f} [{recall.low:.1f}, {recall.high:.1f}]"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
