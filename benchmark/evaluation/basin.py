"""The command ``basin``, which measures the recall of a method against the error of the prior.

Every query is localized once for each size of error. Its prior is the reference pose, shifted by
exactly this many metres and rotated by exactly this many degrees. The directions are drawn from the
seed and the query's name, so that they are the same for every method and for every size. The prior
states the size of its error as its standard deviation.

Methods use the prior in different ways. A refiner starts its optimization there. ``sift`` matches
map photographs near it and, with ``use_gnss``, weighs its position in the refinement. It
needs no initial pose, so its recall falls only if the nearest photographs no longer show the ground
that the query shows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from benchmark.datasets.dataset import Dataset
from benchmark.evaluation.evaluate import require_folder
from benchmark.evaluation.scored_query import score_query
from benchmark.evaluation.starts import move_prior
from benchmark.results.query_result import MAX_STORED, QueryResult
from benchmark.results.results import DatasetId
from benchmark.results.results_files import BASIN, method_in
from benchmark.scoring.intervals import share_of_counts
from benchmark.scoring.score import THRESHOLDS, is_correct
from benchmark.scoring.summary import Percentage
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.localizer import Localizer, Status
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.outputs import check_outputs
from objconnect.scene.storage.records import Record
from objconnect.scene.storage.scratch import cache_or_scratch

_SIZE: Final = re.compile(r"([0-9]*\.?[0-9]+)m/([0-9]*\.?[0-9]+)deg")

Count = Annotated[int, Field(ge=0, le=MAX_STORED)]


class PriorError(NamedTuple):
    """The error of a prior: metres of its position, degrees of its attitude."""

    metres: float
    degrees: float

    def __str__(self) -> str:
        return f"{self.metres:g}m/{self.degrees:g}deg"


DEFAULT_ERRORS: Final = tuple(
    PriorError(*error) for error in ((0, 0), (1, 2), (3, 5), (8, 10), (15, 20), (30, 30))
)


class CourseCounts(Record):
    """The queries of one flight path (course), and how many are correct by threshold key."""

    queries: int = Field(ge=1, le=MAX_STORED)
    correct: dict[str, Count]


class Level(Record):
    """The counts of one size of error.

    Attributes:
        prior_t_m: distance of the prior's position from the camera centre, metres.
        prior_r_deg: angle between the attitudes of the prior and the camera, degrees.
        queries: number of all queries, the denominator of the recall.
        failed: number of queries without a pose.
        fallback: number of queries whose pose is only the prior's; they count as not found.
        correct: number of correct queries by the key of a threshold, such as "0.25m_2deg".
        by_course: number of queries and of correct ones in each course; None in files of earlier
            versions, whose recalls have no intervals.
    """

    prior_t_m: float = Field(ge=0)
    prior_r_deg: float = Field(ge=0)
    queries: int = Field(ge=1, le=MAX_STORED)
    failed: Count
    fallback: Count
    correct: dict[str, Count]
    by_course: dict[str, CourseCounts] | None = None

    @model_validator(mode="after")
    def _adds_up(self) -> Level:
        keys = {threshold.key for threshold in THRESHOLDS}
        if set(self.correct) != keys:
            raise ValueError(f"the thresholds are {sorted(self.correct)}, not {sorted(keys)}")
        if max(self.correct.values()) + self.failed + self.fallback > self.queries:
            raise ValueError("correct, failed and fallback queries are more than all queries")
        if self.by_course is not None:
            counts = self.by_course.values()
            summed = {key: sum(c.correct.get(key, 0) for c in counts) for key in self.correct}
            if summed != self.correct or sum(c.queries for c in counts) != self.queries:
                raise ValueError("the counts by course do not add up to those of all queries")
        return self

    def recall(self, threshold: str) -> Percentage:
        """Return the percentage of correct queries with its 95 % interval by course."""
        if self.by_course is None:
            return Percentage(
                value=100 * self.correct[threshold] / self.queries, low=None, high=None
            )
        counts = self.by_course.values()
        interval = share_of_counts(
            np.array([c.correct[threshold] for c in counts], np.float64),
            np.array([c.queries for c in counts], np.int64),
        )
        return Percentage(**interval._asdict())


class Basin(Record):
    """The file ``RESULTS/<dataset>/<method>.basin.json`` of one method on one data set."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    method: Method
    dataset: DatasetId
    seed: int
    environment: Environment
    levels: tuple[Level, ...] = Field(min_length=1)

    def text(self) -> str:
        """Return one line for each size of error."""
        lines = []
        for level in self.levels:
            recalls = [
                f"{recall.text()} % at {threshold}"
                for threshold in THRESHOLDS
                for recall in [level.recall(threshold.key)]
            ]
            error = f"{level.prior_t_m:g} m {level.prior_r_deg:g}°"
            lines.append(f"prior {error}: {', '.join(recalls)}, of {level.queries}")
        return "\n".join(lines)


def parse_errors(text: str) -> tuple[PriorError, ...]:
    """Read errors of priors, written like ``1m/2deg,3m/5deg``.

    Raises:
        InputError: the text has another form, or an error is listed twice or too large.
    """
    errors = []
    for word in text.split(","):
        match = _SIZE.fullmatch(word.strip())
        if match is None:
            raise InputError(f"write errors as 1m/2deg,3m/5deg; got {word.strip()!r}")
        error = PriorError(float(match.group(1)), float(match.group(2)))
        if error.metres > FARTHEST_M:
            raise InputError(
                f"a position error is at most {FARTHEST_M:g} metres; got {error.metres:g} metres"
            )
        if error.degrees > 180:
            raise InputError(
                f"an attitude error is at most 180 degrees; got {error.degrees:g} degrees"
            )
        if error in errors:
            raise InputError(f"the error {error} is listed twice: list it once")
        errors.append(error)
    return tuple(errors)


def basin_path(out: Path, dataset: Dataset, localizer: Localizer) -> Path:
    """Return the path of the file of a method's basin of convergence on a data set."""
    return out / dataset.name / f"{localizer.name}{BASIN}"


def basin(
    dataset: Dataset,
    localizer: Localizer,
    out: Path,
    errors: Sequence[PriorError] = DEFAULT_ERRORS,
    seed: int = 0,
    cache: Path | None = None,
) -> Basin:
    """Localize every query from priors with errors of each given size, and write the counts.

    Args:
        dataset: data set of the queries. Their own priors are not used.
        localizer: method to run.
        out: folder of the results.
        errors: errors of the priors.
        seed: random seed of the error directions.
        cache: folder for data that the method keeps per map; None for a scratch folder in ``out``.

    Returns:
        The measured recalls that were written.

    Raises:
        InputError: the map or a photograph is missing or damaged, or ``out`` cannot be written.
    """
    require_folder(out)
    target = basin_path(out, dataset, localizer)
    check_outputs([target], within=out)
    method_in(target)  # another program's file must not be replaced
    sparse_map = dataset.load_map()
    with cache_or_scratch(cache, out) as folder:
        localizer.prepare(sparse_map, dataset.images, folder)
    answers: list[list[QueryResult]] = [[] for _ in errors]
    steps = len(dataset.queries) * len(errors)
    with progress_bar(f"{dataset.name} {localizer.name}", steps) as advance:
        for number, query in enumerate(dataset.queries):
            loaded = query.load()
            # With seed 0 the priors are the same as those of `evaluate --start error=`.
            name = f"{seed} {query.name}" if seed else query.name
            for level, error in enumerate(errors):
                prior = move_prior(query.reference, name, *error)
                began = perf_counter()
                estimate = localize_safely(localizer, replace(loaded, prior=prior))
                seconds = perf_counter() - began
                course = dataset.courses[query.group]
                answer = score_query(query, course, estimate, sparse_map, seconds)
                answers[level].append(answer)
                advance(number * len(errors) + level + 1)
    result = Basin(
        method=Method.of(localizer),
        dataset=DatasetId.of(dataset),
        seed=seed,
        environment=Environment.current(),
        levels=tuple(_count_level(*pair) for pair in zip(errors, answers, strict=True)),
    )
    text = result.model_dump_json(indent=1, by_alias=True) + "\n"
    write_text(target, text)
    return result


def load_basin(path: Path) -> Basin:
    """Read a basin file.

    Raises:
        InputError: the file is missing, cannot be read, or has counts that contradict each other.
    """
    return read_json(path, Basin, "basin file")


def _count_level(error: PriorError, answers: Sequence[QueryResult]) -> Level:
    """Return the counts of the answers from priors with one error."""
    return Level(
        prior_t_m=error.metres,
        prior_r_deg=error.degrees,
        queries=len(answers),
        failed=sum(answer.status is Status.FAILED for answer in answers),
        fallback=sum(answer.status is Status.FALLBACK for answer in answers),
        correct=_count_correct(answers),
        by_course={
            course: CourseCounts(queries=len(group), correct=_count_correct(group))
            for course, group in _group_by_course(answers).items()
        },
    )


def _count_correct(answers: Sequence[QueryResult]) -> dict[str, int]:
    """Return the number of correct answers by the key of a threshold."""
    return {t.key: sum(is_correct(answer, t) for answer in answers) for t in THRESHOLDS}


def _group_by_course(answers: Sequence[QueryResult]) -> dict[str, list[QueryResult]]:
    courses: dict[str, list[QueryResult]] = {}
    for answer in answers:
        courses.setdefault(answer.course_name, []).append(answer)
    return courses
