"""``regress``: did recall drop by more than chance since the baseline was recorded?"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.paired import PairedChange, compare
from benchmark.report.tables import ALL
from benchmark.results import Results, load, method_in, results_files
from benchmark.score import THRESHOLDS, is_correct
from scene.errors import InputError
from scene.runtime.printed import printed
from scene.storage.files import written_whole
from scene.storage.outputs import claim, claim_folder

# Probability of a false alarm per baseline file, shared out among its comparisons (Bonferroni).
_ALPHA: Final = 0.05


@dataclass(frozen=True)
class Comparison:
    """One method on one data set, at one threshold, over all queries or those of a condition.

    Attributes:
        method: that was run.
        track: of the data set.
        dataset: its name.
        condition: of the queries, or "all".
        threshold: as "0.5m_5deg".
        change: of recall, paired by query.
        vanished: queries of the baseline that the results lack; they count as wrong.
        dropped: recall fell by more than chance, or a query vanished, which is not chance at all.
    """

    method: str
    track: str
    dataset: str
    condition: str
    threshold: str
    change: PairedChange
    vanished: int
    dropped: bool

    def text(self) -> str:
        """One line for a person."""
        c = self.change
        verdict = "DROP" if self.dropped else "ok  "
        return printed(
            f"{verdict} {self.method} on {self.dataset} ({self.track}), {self.condition}, "
            f"{self.threshold}: {c.change:+.1f} points [{c.low:+.1f}, {c.high:+.1f}], "
            f"{c.lost} lost and {c.won} won of {c.queries}, p = {c.p_drop:.2g}"
            + (f"; {self.vanished} queries vanished" if self.vanished else "")
        )

    def as_dict(self) -> dict[str, Any]:
        """For a program."""
        return asdict(self) | {"change": self.change._asdict()}


def regress(results: Path, baseline: Path) -> list[Comparison]:
    """Compare every results file of a baseline with the one of the same place in ``results``.

    A query that the new results lack counts as wrong.

    Args:
        results: folder that ``evaluate`` wrote.
        baseline: folder that ``update`` wrote.

    Raises:
        InputError: no baseline, a results file missing or damaged, or made from other data or
            another start.
    """
    comparisons: list[Comparison] = []
    for name in _files(baseline):
        if not (results / name).is_file():
            raise InputError(f"{results} lacks {name}, which the baseline {baseline} has")
        comparisons += _compare(load(baseline / name), load(results / name), str(name))
    return comparisons


def update(results: Path, baseline: Path) -> list[Path]:
    """Make the results the baseline: copies every results file; returns those written.

    Raises:
        InputError: no results, or one of them is damaged or cannot be written.
    """
    names = _files(results)
    claim_folder(baseline, [results])
    claim([baseline / name for name in names], [results / name for name in names])
    for name in names:
        method_in(baseline / name)
        load(results / name)  # a damaged file must not become the measure of others
    for name in names:
        with written_whole(baseline / name) as partial:
            shutil.copyfile(results / name, partial)
    return [baseline / name for name in names]


def _files(folder: Path) -> list[Path]:
    """Results files below a folder, relative to it."""
    return [path.relative_to(folder) for path in results_files(folder)]


def _compare(before: Results, after: Results, name: str) -> Iterator[Comparison]:
    if before.dataset.sha256 != after.dataset.sha256:
        raise InputError(
            f"{name}: the results are of data set {after.dataset.sha256[:12]}, the baseline of "
            f"{before.dataset.sha256[:12]}: where photographs, map or poses changed, recall cannot "
            "be compared; if the change was meant, record it again with --update"
        )
    if before.start != after.start:
        raise InputError(
            f"{name}: the results start from {after.start}, the baseline from {before.start}; "
            "evaluate from the same, or record it again with --update"
        )
    by_name = {query.name: query for query in after.queries}
    conditions = dict.fromkeys(query.condition for query in before.queries)
    scopes: Sequence[str] = [ALL, *conditions] if len(conditions) > 1 else [ALL]
    level = _ALPHA / (len(scopes) * len(THRESHOLDS))
    for scope in scopes:
        queries = [q for q in before.queries if scope in (ALL, q.condition)]
        for threshold in THRESHOLDS:
            was = [is_correct(query, threshold) for query in queries]
            found = [by_name.get(query.name) for query in queries]
            now = [query is not None and is_correct(query, threshold) for query in found]
            change = compare(was, now)
            yield Comparison(
                method=before.method.name,
                track=before.dataset.track,
                dataset=before.dataset.name,
                condition=scope,
                threshold=threshold.key,
                change=change,
                vanished=found.count(None),
                dropped=change.p_drop < level or None in found,
            )
