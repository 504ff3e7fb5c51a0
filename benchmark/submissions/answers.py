"""Write the poses that a method finds into the files of a submission.

Reference poses are not needed, so that a method can be run on scenes that are published without
query poses (*sealed*).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.dataset import Task
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import available_start
from benchmark.evaluation.pose_files import MARK, PoseWriter
from benchmark.evaluation.starts import Start
from benchmark.publishing.reader import is_sealed, open_sealed
from benchmark.submissions.submission import poses_path
from objconnect.scene.localizer import Localizer
from objconnect.scene.storage.outputs import OutputFile, check_output_folder, check_outputs

# Decimals of the quaternion and of the translation (metres).
_DECIMALS: Final = 9


@dataclass(frozen=True)
class AnswersReport:
    """Files of poses for a submission.

    Attributes:
        method: name of the method that found them.
        start: name of the starting information.
        files: file of poses by data set.
        digests: digest of each data set, as the card of the submission lists it.
        found: number of poses by data set.
        queries: number of queries by data set.
    """

    method: str
    start: str
    files: dict[str, Path]
    digests: dict[str, str]
    found: dict[str, int]
    queries: dict[str, int]

    def text(self) -> str:
        """Return a line for each file, and the lines of the card that are known."""
        lines = [
            f"{file}: {self.found[name]} of {self.queries[name]} queries found"
            for name, file in self.files.items()
        ]
        lines += ["", "Lines for card.yaml:", f"start: {self.start}", "datasets:"]
        return "\n".join(
            [*lines, *(f"  {name}: {sha256}" for name, sha256 in self.digests.items())]
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the report for a program."""
        return {
            "method": self.method,
            "start": self.start,
            "datasets": {
                name: {
                    "poses": str(file),
                    "sha256": self.digests[name],
                    "found": self.found[name],
                    "queries": self.queries[name],
                }
                for name, file in self.files.items()
            },
        }


def open_tasks(path: Path) -> list[Task]:
    """Open the data sets of a path; the poses of their queries may be withheld.

    Raises:
        InputError: for the reasons of ``open_datasets`` and ``open_sealed``.
    """
    return open_sealed(path) if is_sealed(path) else list(open_datasets(path))


def write_answers(
    path: Path,
    localizer: Localizer,
    out: Path,
    start: Start,
    cache: Path | None = None,
    jobs: int = 1,
) -> AnswersReport:
    """Localize every query of data sets and write ``OUT/poses/<dataset>.txt``.

    Only poses of status ok are written, because others count as not found. An interrupted run goes
    on where it stopped.

    Args:
        path: data set, or published folder, whose query poses may be withheld.
        localizer: method to run.
        out: folder of the submission.
        start: information on each query that the method gets besides its image.
        cache: folder for data that the method keeps per map; None for a scratch folder in ``out``.
        jobs: number of queries at a time, in threads.

    Raises:
        InputError: a file of the data set is missing, damaged or changed during the run, the start
            needs poses that are withheld, or ``out`` cannot be written or holds poses of another
            method, start or option.
    """
    tasks = open_tasks(path)
    files = {task.name: poses_path(out, task.name) for task in tasks}
    check_output_folder(out, [path])
    check_outputs((OutputFile(file, MARK.encode()) for file in files.values()), within=out)
    for task in tasks:
        start.require_references(task)
    writer = PoseWriter(localizer, _DECIMALS, cache, jobs)
    starts = {task.name: available_start(start, task) for task in tasks}
    for name, file in files.items():
        writer.require_same_run(file, starts[name])
    lines = {task.name: writer.write(task, files[task.name], starts[task.name]) for task in tasks}
    return AnswersReport(
        method=localizer.name,
        start=start.name,
        files=files,
        digests={task.name: task.sha256 for task in tasks},
        found={name: len(task_lines) for name, task_lines in lines.items()},
        queries={task.name: len(task.queries) for task in tasks},
    )
