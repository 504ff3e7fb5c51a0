"""Write the poses that a method finds, one file for each data set, and resume interrupted runs.

Their lines are hloc's, ``name qw qx qy qz tx ty tz`` (world to camera, metres). The first line is a
comment that states the run. Reference poses are not needed.
"""

from __future__ import annotations

import logging
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from benchmark.datasets.dataset import Task, TaskQuery
from benchmark.datasets.identity import require_unchanged
from benchmark.evaluation.starts import Start
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.localization.pipeline.journal import Journal, journal_path, read_parts
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.localizer import Localizer, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.runtime.threads import map_unordered
from objconnect.scene.storage.answers import NamedRecord
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.scratch import cache_or_scratch

log = logging.getLogger(__name__)

MARK: Final = "# written by objconnect submit: "
"""First characters of a file of poses that this module wrote."""

_DATA_SET: Final = ", data set "
# The part of a journal that holds the description of its run.
_RUN: Final = "run"
# Number of digits of a digest in the first line.
_DIGEST_DIGITS: Final = 12


class _Answer(NamedRecord):
    """The line of a query in the file of poses; None without a pose of status ok."""

    line: str | None


@dataclass(frozen=True)
class PoseWriter:
    """Writes the poses with status ok that a method finds; other answers get no line.

    Attributes:
        localizer: method to run.
        decimals: number of decimals of quaternions and translations (metres).
        cache: folder for data that the method keeps per map; None for a scratch folder beside the
            file.
        jobs: number of queries at a time, in threads.
    """

    localizer: Localizer
    decimals: int
    cache: Path | None = None
    jobs: int = 1

    def require_same_run(self, path: Path, start: Start) -> None:
        """Refuse to replace poses of another method, starting information or option.

        This holds for finished and for unfinished files.

        Raises:
            InputError: the file or its journal holds such poses.
        """
        run = self._describe(start)
        unfinished = journal_path(path)
        for file, before in ((path, _read_run(path)), (unfinished, _read_journal(unfinished))):
            if before is not None and before != run:
                raise InputError(
                    f"{file} holds poses of {before}, and this run is of {run}: choose another "
                    "--out, or remove the file"
                )

    def write(self, task: Task, path: Path, start: Start) -> list[str]:
        """Localize every query of a data set, write the file, and return its lines of poses.

        A finished file of the same run is kept. A journal keeps the finished queries of an
        unfinished run, so that an interrupted run goes on where it stopped. If the data set has
        changed since, the run starts again.

        Args:
            task: data set.
            path: file of poses.
            start: information on each query that the method gets besides its image.

        Raises:
            InputError: a file of the data set is missing, damaged or changed during the run, the
                start does not fit it, or the file cannot be written.
        """
        run = self._describe(start)
        header = f"{MARK}{run}{_DATA_SET}{task.sha256}"
        if path.is_file():
            first, *lines = read_text(path, "file of poses").rstrip("\n").split("\n")
            if first == header:
                return lines
            log.warning("the data set %s changed since %s was written", task.name, path)
        sparse_map = task.load_map()
        with Journal(journal_path(path), digest_of(header), _Answer, {_RUN: run}) as journal:
            self._localize(task, start, sparse_map, journal)
            try:
                require_unchanged(task, sparse_map.names)
            except InputError:
                journal.done.clear()  # the queries may have been read before or after the change
                raise
            lines = [line for query in task.queries if (line := journal.done[query.name].line)]
            write_text(path, "".join(f"{line}\n" for line in [header, *lines]))
        return lines

    def _describe(self, start: Start) -> str:
        """Return what determines the poses besides the data set, in words."""
        return f"{self.localizer.name}, start {start.name}, {self._options}"

    @cached_property
    def _options(self) -> str:
        """The digest of options, weights and versions, in words."""
        method, environment = Method.of(self.localizer), Environment.current()
        digest = digest_of(method.model_dump_json(), environment.model_dump_json())
        return f"options and versions {digest[:_DIGEST_DIGITS]}"

    def _localize(
        self, task: Task, start: Start, sparse_map: SparseMap, journal: Journal[_Answer]
    ) -> None:
        """Localize the queries that are not in the journal, and add them to it."""
        waiting = [query for query in task.queries if query.name not in journal.done]
        if not waiting:
            return
        localizer = self.localizer
        with cache_or_scratch(self.cache, journal.path.parent) as folder:
            localizer.prepare(sparse_map, task.images, folder)
            load = start.loader(task, sparse_map, folder)

            def localize(query: TaskQuery) -> None:
                estimate = localize_safely(localizer, load(query))
                pose = estimate.cam_from_world if estimate.status is Status.OK else None
                line = None if pose is None else pose_line(query.name, pose, self.decimals)
                journal.add(_Answer(name=query.name, line=line))

            with (
                progress_bar(f"{task.name} {localizer.name}", len(task.queries)) as advance,
                closing(map_unordered(localize, waiting, self.jobs)) as localized,
            ):
                advance(len(journal.done))
                for _ in localized:
                    advance(len(journal.done))


def _read_run(path: Path) -> str | None:
    """Return the description of the run that wrote a file of poses; None if there is none."""
    if not path.is_file():
        return None
    first = read_text(path, "file of poses").partition("\n")[0]
    return first.removeprefix(MARK).rpartition(_DATA_SET)[0] or None


def _read_journal(path: Path) -> str | None:
    """Return the description of the run of a journal; None if there is none."""
    return (read_parts(path) or {}).get(_RUN)
