"""How far off a start may be: recall against the error of the prior.

Every query is localized once for each size of error. Its prior is the reference pose, moved by
exactly so many metres and turned by exactly so many degrees, in directions drawn from the seed and
the query's name: the same for every method, and along one line from the smallest error to the
largest. The prior states its own size as its sigma, as an honest receiver would.

What a method makes of it is its own affair. A refiner starts there. ``sift`` looks at the map
photographs nearest to it and, with ``use_gnss``, weighs its position in the refinement; it needs no
start, so its curve falls only where the nearest photographs no longer show the query's ground.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, Final, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

from benchmark.datasets.dataset import Dataset
from benchmark.evaluate import identity, localize_safely, method_of, require_folder, score_query
from benchmark.results import (
    BASIN,
    DatasetId,
    Environment,
    Method,
    QueryResult,
    Recall,
    method_in,
)
from benchmark.score import THRESHOLDS, is_correct, wilson
from benchmark.starts import moved_prior
from scene.bundle.manifest import read_json
from scene.errors import InputError
from scene.geometry.pose import FARTHEST_M
from scene.localizer import Localizer, Status
from scene.runtime.progress import progress_bar
from scene.storage.files import write_text
from scene.storage.outputs import claim
from scene.storage.scratch import kept_or_scratch

_SIZE: Final = re.compile(r"([0-9]*\.?[0-9]+)m/([0-9]*\.?[0-9]+)deg")

# Beyond it a file's numbers are no counts, and some that JSON can say no floats either.
_MOST = 10**12
Count = Annotated[int, Field(ge=0, le=_MOST)]


class Size(NamedTuple):
    """How wrong a prior is."""

    metres: float
    degrees: float

    def __str__(self) -> str:
        return f"{self.metres:g}m/{self.degrees:g}deg"


DEFAULT_SIZES: Final = tuple(
    Size(*size) for size in ((0, 0), (1, 2), (3, 5), (8, 10), (15, 20), (30, 30))
)


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Level(_File):
    """What came of the queries whose priors were wrong by one size.

    Attributes:
        prior_t_m: distance of the prior from the camera centre, metres.
        prior_r_deg: angle of the prior's attitude to the camera's, degrees.
        queries: how many are listed; all of them count.
        failed: without a pose.
        fallback: with a pose that is only the prior's; counted as wrong.
        correct: right queries by threshold, as "0.25m_2deg".
    """

    prior_t_m: float = Field(ge=0)
    prior_r_deg: float = Field(ge=0)
    queries: int = Field(ge=1, le=_MOST)
    failed: Count
    fallback: Count
    correct: dict[str, Count]

    @model_validator(mode="after")
    def _adds_up(self) -> Level:
        if set(self.correct) != {threshold.key for threshold in THRESHOLDS}:
            raise ValueError(f"thresholds are {sorted(self.correct)}")
        if max(self.correct.values()) + self.failed + self.fallback > self.queries:
            raise ValueError("more answers than queries")
        return self

    def recall(self, threshold: str) -> Recall:
        """Percent of the queries, with the Wilson 95 % interval."""
        correct = self.correct[threshold]
        low, high = wilson(correct, self.queries)
        return Recall(value=100 * correct / self.queries, low=100 * low, high=100 * high)


class Basin(_File):
    """``RESULTS/<dataset>/<method>.basin.json``: one method on one data set."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    method: Method
    dataset: DatasetId
    seed: int
    environment: Environment
    levels: tuple[Level, ...] = Field(min_length=1)

    def text(self) -> str:
        """A line for each size of error."""
        lines = []
        for level in self.levels:
            recalls = [
                f"{found.value:.1f} [{found.low:.1f}, {found.high:.1f}] % at {threshold}"
                for threshold in THRESHOLDS
                for found in [level.recall(threshold.key)]
            ]
            size = f"{level.prior_t_m:g} m {level.prior_r_deg:g}°"
            lines.append(f"prior {size}: {', '.join(recalls)}, of {level.queries}")
        return "\n".join(lines)


def parse_sizes(text: str) -> tuple[Size, ...]:
    """Sizes of error from words like ``1m/2deg,3m/5deg``.

    Raises:
        InputError: anything else, or a size listed twice.
    """
    sizes = []
    for word in text.split(","):
        found = _SIZE.fullmatch(word.strip())
        if found is None:
            raise InputError(f"errors are listed as 1m/2deg,3m/5deg; got {word.strip()!r}")
        size = Size(float(found.group(1)), float(found.group(2)))
        if size.metres > FARTHEST_M:
            raise InputError(f"a position cannot be wrong by {size.metres:g} metres")
        if size.degrees > 180:
            raise InputError(f"an attitude cannot be wrong by {size.degrees:g} degrees")
        if size in sizes:
            raise InputError(f"the error {size} is listed twice")
        sizes.append(size)
    return tuple(sizes)


def basin_path(out: Path, dataset: Dataset, localizer: Localizer) -> Path:
    """Where the basin of a method on a data set lies."""
    return out / dataset.name / f"{localizer.name}{BASIN}"


def basin(
    dataset: Dataset,
    localizer: Localizer,
    out: Path,
    sizes: Sequence[Size] = DEFAULT_SIZES,
    seed: int = 0,
    cache: Path | None = None,
) -> Basin:
    """Localize every query from priors of every size of error; write the counts at the end.

    Args:
        dataset: whose queries. Their own priors are not used.
        localizer: what to run.
        out: folder of the results.
        sizes: of the errors, see the module.
        seed: of their directions.
        cache: folder for the method's per-map state; None for a scratch folder in ``out``.

    Raises:
        InputError: the map or a photograph is missing or broken, or ``out`` cannot be written.
    """
    require_folder(out)
    target = basin_path(out, dataset, localizer)
    claim([target], within=out)
    method_in(target)
    sparse_map = dataset.load_map()
    with kept_or_scratch(cache, out) as folder:
        localizer.prepare(sparse_map, dataset.images, folder)
    answers: list[list[QueryResult]] = [[] for _ in sizes]
    steps = len(dataset.queries) * len(sizes)
    with progress_bar(f"{dataset.name} {localizer.name}", steps) as advance:
        for number, query in enumerate(dataset.queries):
            loaded = query.load()
            # With seed 0 the priors are those of `evaluate --start error=`.
            name = f"{seed} {query.name}" if seed else query.name
            for level, size in enumerate(sizes):
                prior = moved_prior(query.reference, name, *size)
                began = perf_counter()
                estimate = localize_safely(localizer, replace(loaded, prior=prior))
                seconds = perf_counter() - began
                answers[level].append(score_query(query, estimate, sparse_map, seconds))
                advance(number * len(sizes) + level + 1)
    result = Basin(
        method=method_of(localizer),
        dataset=identity(dataset),
        seed=seed,
        environment=Environment.current(),
        levels=tuple(_level(size, found) for size, found in zip(sizes, answers, strict=True)),
    )
    text = result.model_dump_json(indent=1, by_alias=True) + "\n"
    write_text(target, text)
    return result


def load_basin(path: Path) -> Basin:
    """Read what ``basin`` wrote.

    Raises:
        InputError: unreadable, no such file, or counts that contradict themselves.
    """
    return read_json(path, Basin, "basin file")


def _level(size: Size, answers: Sequence[QueryResult]) -> Level:
    return Level(
        prior_t_m=size.metres,
        prior_r_deg=size.degrees,
        queries=len(answers),
        failed=sum(answer.status is Status.FAILED for answer in answers),
        fallback=sum(answer.status is Status.FALLBACK for answer in answers),
        correct={
            threshold.key: sum(is_correct(answer, threshold) for answer in answers)
            for threshold in THRESHOLDS
        },
    )
