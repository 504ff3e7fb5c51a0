"""The poses that a method finds, in the files of a submission.

Reference poses are not needed, so that a method can be run on the public half of sealed scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.dataset import Task
from benchmark.datasets.identity import require_unchanged
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import available_start
from benchmark.evaluation.starts import Start
from benchmark.publishing.reader import is_sealed, open_sealed
from benchmark.submissions.submission import poses_path
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.localizer import Localizer, Status
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.answers import NamedRecord
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.outputs import OutputFile, check_output_folder, check_outputs
from objconnect.scene.storage.scratch import cache_or_scratch

# Decimals of the quaternion and of the translation (metres).
_DECIMALS: Final = 9
# First bytes of a file of poses that this command wrote.
_HEADER: Final = "# written by objconnect submit: "


class _Answer(NamedRecord):
    """The line of a query in the file of poses; None if the method found no pose."""

    line: str | None


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
    """Open the data sets of a path, and those whose query poses are sealed.

    Raises:
        InputError: for the reasons of ``open_datasets`` and ``open_sealed``.
    """
    return open_sealed(path) if is_sealed(path) else list(open_datasets(path))


def write_answers(
    path: Path, localizer: Localizer, out: Path, start: Start, cache: Path | None = None
) -> AnswersReport:
    """Localize every query of data sets and write ``OUT/poses/<dataset>.txt``.

    Only poses of status ok are written, because others count as wrong. An interrupted run goes on
    where it stopped.

    Args:
        path: data set, or published folder, also one whose query poses are sealed.
        localizer: method to run.
        out: folder of the submission.
        start: what the method is told about each query besides its image.
        cache: folder for what the method keeps per map; None for a scratch folder in ``out``.

    Raises:
        InputError: a file of the data set is missing, damaged or changed during the run, the start
            needs poses that are sealed, or ``out`` cannot be written.
    """
    tasks = open_tasks(path)
    files = {task.name: poses_path(out, task.name) for task in tasks}
    check_output_folder(out, [path])
    check_outputs((OutputFile(file, _HEADER.encode()) for file in files.values()), within=out)
    for task in tasks:
        start.require_references(task)
    found = {task.name: _write(task, localizer, files[task.name], start, cache) for task in tasks}
    return AnswersReport(
        method=localizer.name,
        start=start.name,
        files=files,
        digests={task.name: task.sha256 for task in tasks},
        found=found,
        queries={task.name: len(task.queries) for task in tasks},
    )


def _write(task: Task, localizer: Localizer, path: Path, start: Start, cache: Path | None) -> int:
    """Write the poses of a data set; return their number."""
    method, environment = Method.of(localizer), Environment.current()
    start = available_start(start, task)
    sparse_map = task.load_map()
    key = digest_of(
        method.model_dump_json(), task.sha256, start.name, environment.model_dump_json()
    )
    with Journal(journal_path(path), key, _Answer) as journal:
        with (
            cache_or_scratch(cache, path.parent) as folder,
            progress_bar(f"{task.name} {localizer.name}", len(task.queries)) as advance,
        ):
            localizer.prepare(sparse_map, task.images, folder)
            load = start.loader(task, sparse_map, folder)
            for query in task.queries:
                if query.name not in journal.done:
                    estimate = localize_safely(localizer, load(query))
                    pose = estimate.cam_from_world if estimate.status is Status.OK else None
                    line = None if pose is None else pose_line(query.name, pose, _DECIMALS)
                    journal.add(_Answer(name=query.name, line=line))
                advance(len(journal.done))
        require_unchanged(task, sparse_map.names)
        lines = [line for query in task.queries if (line := journal.done[query.name].line)]
        header = f"{_HEADER}{method.name}, start {start.name}, data set {task.sha256}"
        write_text(path, "".join(f"{line}\n" for line in [header, *lines]))
    return len(lines)
