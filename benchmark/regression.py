"""The command ``regress``, which tests whether recall or integrity dropped since a baseline.

Integrity drops if more answers are wrong by over 1 m, by over 5 m or 10 degrees, or are farther off
than the query's prior.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from benchmark.report.tables import ALL
from benchmark.results.query_result import QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load, method_in, results_files
from benchmark.scoring.paired import PairedChange, compare
from benchmark.scoring.score import (
    FALSE_FIX,
    THRESHOLDS,
    WRONG_TEXT,
    is_correct,
    is_false_fix,
    is_worse_than_prior,
    is_wrong,
)
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.outputs import check_output_folder, check_outputs

log = logging.getLogger(__name__)

# Probability of a false alarm per baseline file, divided among its comparisons of recall, and once
# more among those of integrity (Bonferroni).
_ALPHA: Final = 0.05

_IsGood = Callable[[QueryResult], bool]


@dataclass(frozen=True)
class Comparison:
    """The comparison of one method on one data set by one metric.

    Attributes:
        method: name of the method.
        track: track of the data set.
        dataset: name of the data set.
        condition: condition of the compared queries, or "all".
        threshold: name of the metric: the key of a threshold of recall, such as "0.5m_5deg", or
            "not_false_fix", "not_wrong_1m" or "not_worse_than_prior".
        change: change of the share of queries that are good by this metric, paired by query.
        vanished: number of baseline queries that the results lack; they count as losses.
        dropped: whether the share fell by more than chance explains, or a query vanished.
        can_drop: whether losing all good queries would count as a drop.
    """

    method: str
    track: str
    dataset: str
    condition: str
    threshold: str
    change: PairedChange
    vanished: int
    dropped: bool
    can_drop: bool

    def text(self) -> str:
        """Return the comparison as one line for a person."""
        c = self.change
        verdict = "DROP" if self.dropped else "ok  "
        return for_terminal(
            f"{verdict} {self.method} on {self.dataset} ({self.track}), {self.condition}, "
            f"{self.threshold}: {c.change:+.1f} points [{c.low:+.1f}, {c.high:+.1f}], "
            f"{c.lost} lost and {c.won} won of {c.queries}, p = {c.p_drop:.2g}"
            + (f"; {self.vanished} queries vanished" if self.vanished else "")
        )

    def warning(self) -> str:
        """Return the warning for a baseline that is too small for any loss to be significant."""
        return for_terminal(
            f"{self.method} on {self.dataset} ({self.track}), {self.condition}, {self.threshold}: "
            "no loss could be significant, because too few of the baseline's "
            f"{self.change.queries} queries can be lost: record more queries, or easier ones"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison for a program."""
        return asdict(self) | {"change": self.change._asdict()}


def regress(results: Path, baseline: Path) -> list[Comparison]:
    """Compare every results file of a baseline with the file of the same name in ``results``.

    A query that the new results lack counts as lost. A warning names each comparison in which so
    few queries of the baseline are right that even losing all of them would not be significant.

    Args:
        results: folder that ``evaluate`` wrote.
        baseline: folder that ``update`` wrote.

    Raises:
        InputError: there is no baseline, it is ``results`` itself, or a results file is missing,
            damaged, from other data or other starting information than the baseline, or with
            reference poses that are too inexact for any metric.
    """
    if results.resolve() == baseline.resolve():
        raise InputError(f"{results} is compared with itself: name the baseline with --against")
    comparisons: list[Comparison] = []
    for name in _files(baseline):
        if not (results / name).is_file():
            raise InputError(
                f"{results} lacks {name}, which the baseline {baseline} has: evaluate this method "
                "on this data set too"
            )
        comparisons += _compare(load(baseline / name), load(results / name), str(name))
    for comparison in comparisons:
        if not comparison.can_drop:
            log.warning("%s", comparison.warning())
    return comparisons


def update(results: Path, baseline: Path) -> list[Path]:
    """Copy every results file to the baseline.

    Returns:
        The files that were written.

    Raises:
        InputError: there are no results, or one of them is damaged or cannot be written.
    """
    names = _files(results)
    check_output_folder(baseline, [results])
    check_outputs([baseline / name for name in names], [results / name for name in names])
    for name in names:
        method_in(baseline / name)  # another program's file must not be replaced
        load(results / name)  # a damaged file must not become the baseline
    for name in names:
        with atomic_write(baseline / name) as partial:
            shutil.copyfile(results / name, partial)
    return [baseline / name for name in names]


def _files(folder: Path) -> list[Path]:
    """Return the results files below a folder, relative to it."""
    return [path.relative_to(folder) for path in results_files(folder)]


def _compare(before: Results, after: Results, name: str) -> Iterator[Comparison]:
    """Yield the comparisons of one results file, by condition, of recall and then of integrity."""
    if before.dataset.sha256 != after.dataset.sha256:
        raise InputError(
            f"{name}: the results are of data set {after.dataset.sha256[:12]}, the baseline of "
            f"{before.dataset.sha256[:12]}: recall cannot be compared after photographs, map or "
            "poses changed; if the change is intended, record the baseline again with --update"
        )
    if before.start != after.start:
        raise InputError(
            f"{name}: the results were made with --start {after.start}, the baseline with "
            f"{before.start}; evaluate with the same --start, or record the baseline again with "
            "--update"
        )
    by_name = {query.name: query for query in after.queries}
    conditions = dict.fromkeys(query.condition for query in before.queries)
    scopes: Sequence[str] = [ALL, *conditions] if len(conditions) > 1 else [ALL]
    families = [metrics for metrics in _metrics(before, after) if metrics]
    if not families:
        raise InputError(
            f"{name}: the reference poses are too inexact to judge any metric: state their error "
            "in reference_error.json, or leave these results out"
        )
    for scope in scopes:
        queries = [q for q in before.queries if scope in (ALL, q.condition)]
        counterparts = [by_name.get(query.name) for query in queries]
        for metrics in families:
            level = _ALPHA / (len(scopes) * len(metrics))
            for name, is_good in metrics.items():
                good_before = [is_good(query) for query in queries]
                change = compare(good_before, [q is not None and is_good(q) for q in counterparts])
                yield Comparison(
                    method=before.method.name,
                    track=before.dataset.track,
                    dataset=before.dataset.name,
                    condition=scope,
                    threshold=name,
                    change=change,
                    vanished=counterparts.count(None),
                    dropped=change.p_drop < level or None in counterparts,
                    can_drop=compare(good_before, [False] * len(queries)).p_drop < level,
                )


def _metrics(before: Results, after: Results) -> tuple[Mapping[str, _IsGood], ...]:
    """Return functions that test whether a query is good, by metric: recall, then integrity.

    A metric is left out if the reference poses are too inexact for it, or if it compares with the
    priors and the baseline records none.
    """
    unjudged = {*before.dataset.unjudged, *after.dataset.unjudged}
    recall = {t.key: partial(is_correct, threshold=t) for t in THRESHOLDS if str(t) not in unjudged}
    integrity: dict[str, _IsGood] = {}
    if str(FALSE_FIX) not in unjudged:
        integrity["not_false_fix"] = lambda query: not is_false_fix(query)
    if WRONG_TEXT not in unjudged:
        integrity["not_wrong_1m"] = lambda query: not is_wrong(query)
        if any(query.prior_t_m is not None for query in before.queries):
            integrity["not_worse_than_prior"] = lambda query: not is_worse_than_prior(query)
    return recall, integrity
