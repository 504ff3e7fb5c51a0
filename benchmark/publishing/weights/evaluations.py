"""The stored results that were made with given weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.report.markdown import BY_COURSE, escape, line
from benchmark.results.results import Results
from benchmark.results.results_files import load, results_files
from benchmark.scoring.score import THRESHOLDS
from objconnect.scene.errors import InputError
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import is_safe_path


@dataclass(frozen=True)
class Evaluation:
    """A results file of the weights.

    Attributes:
        file: the file.
        results: its contents.
    """

    file: Path
    results: Results

    @property
    def name(self) -> str:
        """Path of the file in the published folder."""
        run = self.results
        return f"results/{run.start}/{run.dataset.name}/{self.file.name}"


def read_evaluations(paths: Sequence[Path], sha256: str) -> tuple[list[Evaluation], int]:
    """Read the results that were made with weights.

    Args:
        paths: results files, or folders of them.
        sha256: digest of the weights.

    Returns:
        The results in the order of their starting information, data set and method, and the number
        of results of other weights, which are left out.

    Raises:
        InputError: there are no results of these weights, a file is damaged, or two files are of
            one run.
    """
    files = [file for path in paths for file in results_files(path)]
    read = [Evaluation(file, load(file)) for file in files]
    by_name: dict[str, Evaluation] = {}
    for each in read:
        if each.results.method.weights_sha256 != sha256:
            continue
        if not is_safe_path(each.name):
            raise InputError(
                f"results file {each.file}: the name of its data set leads out of the folder"
            )
        if each.name in by_name and sha256_of(each.file) != sha256_of(by_name[each.name].file):
            raise InputError(
                f"{each.file} and {by_name[each.name].file} would both be {each.name}: leave out "
                "one"
            )
        by_name[each.name] = each
    if paths and not by_name:
        raise InputError(
            f"none of the {len(read)} results files is of these weights (sha256 {sha256[:12]}): "
            "evaluate with them"
        )
    return [by_name[name] for name in sorted(by_name)], len(read) - len(by_name)


def results_table(evaluations: Sequence[Evaluation]) -> str:
    """Return a table of all results in Markdown."""
    if not evaluations:
        return "No results were published with these weights."
    return "\n".join(
        [
            "Recall is the percentage of all queries whose pose is closer than both thresholds, "
            f"with its 95 % interval; {BY_COURSE} False fixes are poses of status ok that are "
            "wrong by more than 5 m or 10°. Each row is computed from its file in `results/`, "
            "which holds the options of the method, the digest of the data set and the pose of "
            "each query.",
            "",
            *_table(evaluations),
            "",
            "To repeat a row, run this command with the options of its file, given by `--set`:",
            "",
            "```sh",
            "objconnect evaluate DATASET --method METHOD --set weights=FOLDER --start START "
            "--out RESULTS",
            "```",
        ]
    )


def _table(evaluations: Sequence[Evaluation]) -> Iterator[str]:
    recalls = [f"{threshold} (%)" for threshold in THRESHOLDS]
    header = ["data set", "kind", "START", "METHOD", "version", "queries"]
    header += [*recalls, "false fixes (%)"]
    yield line(header)
    yield line(["---"] * 5 + ["--:"] * (len(header) - 5))
    for each in evaluations:
        run, summary = each.results, each.results.summary
        yield line(
            [
                escape(run.dataset.name),
                escape(run.dataset.track),
                f"`{run.start}`",
                escape(run.method.name),
                escape(run.environment.objconnect),
                str(summary.queries),
                *(
                    "–" if recall is None else recall.text()
                    for recall in (summary.recall[threshold.key] for threshold in THRESHOLDS)
                ),
                "–" if summary.false_fixes is None else summary.false_fixes.text(),
            ]
        )
