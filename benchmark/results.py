"""The results file: one method on one data set, complete enough to be scored again."""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from benchmark.score import THRESHOLDS, median_errors, recall
from benchmark.uncertainty import consistency
from scene.bundle.manifest import Condition, read_json
from scene.errors import InputError
from scene.geometry.pose import FARTHEST_M
from scene.localizer import Status
from scene.storage.files import parse_json, write_text
from scene.storage.listing import files_in
from scene.storage.outputs import another_file, claim

# Beyond these a file's numbers are damage, and sums of them soon no numbers at all.
_MOST: Final = 10**12
LARGEST_NEES: Final = 1e100
# Half a turn, and the last bits of a quaternion.
_MOST_DEG: Final = 180.001
_Number = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
_Length = Annotated[float, Field(ge=-10 * FARTHEST_M, le=10 * FARTHEST_M)]
_Count = Annotated[int, Field(ge=0, le=_MOST)]
_Time = Annotated[float, Field(ge=0, le=_MOST)]
PoseNumbers = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number]

# The stage that holds the whole time of a query, measured from outside the method.
TOTAL = "total"

# How files beside ``<method>.json`` end that are no results; see ``benchmark.basin``.
BASIN: Final = ".basin.json"

# First bytes of results and of basins as they are written here.
_HEAD: Final = b'{\n "schema": 1,\n "method": {'

# Stored and recomputed figures agree to this relative difference, or the file was changed.
_TOLERANCE = 1e-9
# Width of a band of altitude.
_BAND_M = 30
# What a method of another program is configured by.
_POSES = "poses"


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Named(_File):
    """What a journal keeps: an answer, by the name of its photograph."""

    name: str


class Method(_File):
    """What was run. ``config`` is everything that changes its result."""

    name: str
    config: dict[str, Any]
    weights_sha256: str | None

    @staticmethod
    def external(name: str, poses_sha256: str) -> Method:
        """Another program, of which the poses are all that is known."""
        return Method(name=name, config={_POSES: poses_sha256}, weights_sha256=None)

    @property
    def is_elsewhere(self) -> bool:
        """Whether another program was run."""
        return set(self.config) == {_POSES}


class DatasetId(_File):
    """What it was run on. ``map_conditions`` are those of the map's photographs."""

    name: str
    track: str
    sha256: str
    map_conditions: tuple[str, ...]


class Environment(_File):
    """Versions of what computes the numbers."""

    objconnect: str
    python: str
    numpy: str
    torch: str
    pycolmap: str

    @staticmethod
    def current() -> Environment:
        """Of this process; "unknown" for a package that is not installed as one."""

        def of(package: str) -> str:
            try:
                return version(package)
            except PackageNotFoundError:
                return "unknown"

        names = ("objconnect", "numpy", "torch", "pycolmap")
        return Environment(python=platform.python_version(), **{name: of(name) for name in names})


class Recall(_File):
    """Percent of queries, with the ends of its Wilson 95 % interval in percent."""

    value: float
    low: float
    high: float


class Seconds(_File):
    """Wall-clock time.

    Attributes:
        prepare: once per run.
        per_query: mean over all queries by stage; a stage that a query did not reach counts as
            zero, and "total" is the whole call.
    """

    prepare: float
    per_query: dict[str, float]


class Uncertainty(_File):
    """How errors compare with predicted covariances: ``benchmark.uncertainty.Consistency``."""

    queries: int
    nees_mean: float
    nees_median: float
    within_95: Recall


class Summary(_File):
    """Figures of a set of queries.

    Attributes:
        queries: how many are listed; all of them are in every denominator.
        recall: by threshold, as "0.25m_2deg".
        median_t_m: over queries with a pose, metres; None when there is none.
        median_r_deg: likewise, degrees.
        failed: without a pose.
        uncertainty: of the localized queries with a covariance; None when there is none.
        fallback: with a pose that is only the prior's or a reference's; counted as wrong.
        seconds: ``prepare`` is of the whole run, also when the queries are only a part of it.
        peak_memory_mb: of the process during the whole run (1e6 bytes); None where the system does
            not tell.
    """

    queries: int
    recall: dict[str, Recall]
    median_t_m: float | None
    median_r_deg: float | None
    failed: int
    fallback: int
    uncertainty: Uncertainty | None
    seconds: Seconds
    peak_memory_mb: float | None


class QueryResult(Named):
    """One query.

    Attributes:
        name: of the photograph.
        condition: it was taken under.
        group: flight or drive it belongs to.
        altitude_m: height of the reference position above the map's points.
        status: how it ended.
        reason: in words, when not ``ok``.
        t_err_m: distance of the camera centres, metres; None without a pose.
        r_err_deg: angle between the rotations, degrees; None without a pose.
        cam_from_world: qw qx qy qz tx ty tz, the estimate; None without a pose.
        sigma_t_m: predicted standard deviation of the camera centre, metres; None when unknown.
        nees: normalised estimation error squared, 6 degrees of freedom; None without covariance.
        iterations: of the method.
        inliers: of the method.
        seconds: by stage.
    """

    condition: Condition
    group: str
    altitude_m: _Length
    status: Status
    reason: str
    t_err_m: _Length | None = Field(ge=0)
    r_err_deg: float | None = Field(ge=0, le=_MOST_DEG)
    cam_from_world: PoseNumbers | None
    sigma_t_m: _Length | None
    nees: float | None = Field(ge=0, le=LARGEST_NEES)
    iterations: _Count
    inliers: _Count
    seconds: dict[str, _Time]


class Results(_File):
    """One method on one data set.

    Attributes:
        start: name of the starting information, see ``benchmark.starts``; "prior" when at least
            one query came with one.
        by_condition: the same figures for the queries of each condition.
        by_group: of each flight or drive.
        by_altitude: of each band of height above the map's points.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    method: Method
    dataset: DatasetId
    start: str = Field(pattern=r"^(prior|none|(retrieval|pairs|error)=[\w.,]+)$")
    environment: Environment
    summary: Summary
    by_condition: dict[str, Summary]
    by_group: dict[str, Summary]
    by_altitude: dict[str, Summary]
    queries: tuple[QueryResult, ...] = Field(min_length=1)

    @staticmethod
    def of(
        method: Method,
        dataset: DatasetId,
        start: str,
        queries: Sequence[QueryResult],
        prepare: float = 0.0,
        peak_memory_mb: float | None = None,
    ) -> Results:
        """Results with every figure computed from the list of queries."""
        run = prepare, peak_memory_mb
        return Results(
            method=method,
            dataset=dataset,
            start=start,
            environment=Environment.current(),
            summary=summarize(queries, *run),
            **{f"by_{part}": found for part, found in summarize_parts(queries, *run).items()},
            queries=tuple(queries),
        )

    def write(self, path: Path) -> None:
        """Write atomically.

        Raises:
            InputError: the folder cannot be written.
        """
        write_text(path, self.model_dump_json(indent=1, by_alias=True) + "\n")


def method_in(path: Path) -> Method | None:
    """The method of the results or the basin that stands somewhere; None where there is nothing, or
    what is left of a file of ours.

    Raises:
        WriteError: somebody else's file stands there.
    """
    if not path.is_file():
        return None
    content = path.read_bytes()
    try:
        return Method.model_validate(parse_json(content.decode())["method"])
    except (ValueError, KeyError, TypeError):
        if content and not content.startswith(_HEAD):
            raise another_file(path) from None
    return None


def claim_results(path: Path, method: Method, out: Path) -> None:
    """Refuse, before any work, results that would replace what they must not.

    Results of the same name are replaced only by those of the same command: what was measured here
    never by poses from elsewhere, nor these by it.

    Args:
        path: of the results to be.
        method: they are of.
        out: folder of all results.

    Raises:
        InputError: another command wrote the results there, or as ``scene.storage.outputs.claim``.
    """
    claim([path], within=out)
    before = method_in(path)
    if before is None:
        return
    if before.is_elsewhere != method.is_elsewhere:
        writer = "score" if before.is_elsewhere else "evaluate"
        mend = "remove it" if before.is_elsewhere else "choose another --method"
        raise InputError(
            f"{path} holds results that {writer} wrote: {mend}, or choose another --out"
        )


def summarize(
    queries: Sequence[QueryResult], prepare: float, peak_memory_mb: float | None
) -> Summary:
    """The figures of some queries of a run that took ``prepare`` seconds before the first."""
    median_t, median_r = median_errors(queries)
    stages = dict.fromkeys(stage for query in queries for stage in query.seconds)
    return Summary(
        queries=len(queries),
        recall={
            threshold.key: Recall(**recall(queries, threshold)._asdict())
            for threshold in THRESHOLDS
        },
        median_t_m=median_t,
        median_r_deg=median_r,
        failed=sum(query.status is Status.FAILED for query in queries),
        fallback=sum(query.status is Status.FALLBACK for query in queries),
        uncertainty=_uncertainty(queries),
        seconds=Seconds(
            prepare=prepare,
            per_query={
                stage: math.fsum(query.seconds.get(stage, 0.0) for query in queries) / len(queries)
                for stage in stages
            },
        ),
        peak_memory_mb=peak_memory_mb,
    )


def summarize_parts(
    queries: Sequence[QueryResult], prepare: float, peak_memory_mb: float | None
) -> dict[str, dict[str, Summary]]:
    """The same by condition, group and altitude: each a summary by name."""
    parts: dict[str, dict[str, Summary]] = {}
    for part, name_of in _PARTS.items():
        names = sorted({name_of(query) for query in queries}, key=_natural)
        parts[part] = {
            name: summarize(
                [query for query in queries if name_of(query) == name], prepare, peak_memory_mb
            )
            for name in names
        }
    return parts


def _band(query: QueryResult) -> str:
    """The query's band of altitude, as "60-90 m"."""
    low = _BAND_M * math.floor(query.altitude_m / _BAND_M)
    return f"{low}-{low + _BAND_M} m"


def _natural(name: str) -> tuple[int, str]:
    """Bands of altitude by height, other names by themselves."""
    found = re.match(r"(-?[0-9]+)-", name) if name.endswith(" m") else None
    return int(found.group(1)) if found else 0, name


_PARTS: Final[dict[str, Callable[[QueryResult], str]]] = {
    "condition": lambda query: query.condition,
    "group": lambda query: query.group,
    "altitude": _band,
}


def _uncertainty(queries: Sequence[QueryResult]) -> Uncertainty | None:
    found = consistency(queries)
    if found is None:
        return None
    inside = Recall(**found.within_95._asdict())
    return Uncertainty(
        queries=found.queries, nees_mean=found.mean, nees_median=found.median, within_95=inside
    )


def rescore(results: Results) -> Results:
    """The same results with every figure recomputed from the list of queries."""
    run = results.summary.seconds.prepare, results.summary.peak_memory_mb
    return results.model_copy(
        update={
            "summary": summarize(results.queries, *run),
        }
        | {f"by_{part}": found for part, found in summarize_parts(results.queries, *run).items()}
    )


def results_files(path: Path) -> list[Path]:
    """The results files of ``RESULTS`` or ``RESULTS/<dataset>``, or the one file.

    Raises:
        InputError: there is none.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"results {path} do not exist")
    found = [file for file in files_in(path, (".json",), depth=2) if not file.name.endswith(BASIN)]
    if not found:
        raise InputError(f"{path} holds no results file (<dataset>/<method>.json)")
    return found


def load(path: Path) -> Results:
    """Read a results file; its figures are the recomputed ones.

    Raises:
        InputError: unreadable, not a results file, queries that contradict themselves, or figures
            that do not follow from the queries.
    """
    results = read_json(path, Results, "results file")
    seen: set[str] = set()
    for query in results.queries:
        if query.name in seen:
            raise InputError(f"results file {path}: query {query.name} is listed twice")
        seen.add(query.name)
        given = {query.cam_from_world is None, query.t_err_m is None, query.r_err_deg is None}
        if given != {query.status is Status.FAILED}:
            raise InputError(
                f"results file {path}: query {query.name} is '{query.status}' but its pose and "
                "errors say otherwise"
            )
    recomputed = rescore(results)
    for part in ("summary", *(f"by_{part}" for part in _PARTS)):
        stored, computed = results.model_dump()[part], recomputed.model_dump()[part]
        if (where := _difference(stored, computed, part)) is not None:
            raise InputError(
                f"results file {path}: {where} does not follow from its queries; "
                "the file was changed after it was written"
            )
    return recomputed


def _difference(stored: object, computed: object, where: str) -> str | None:
    """Where two trees of figures differ, or None."""
    if isinstance(stored, dict) and isinstance(computed, dict):
        for key in sorted(stored.keys() | computed.keys()):
            if key not in stored or key not in computed:
                return f"{where}.{key}"
            if (found := _difference(stored[key], computed[key], f"{where}.{key}")) is not None:
                return found
        return None
    if isinstance(stored, float) and isinstance(computed, float):
        return None if math.isclose(stored, computed, rel_tol=_TOLERANCE) else where
    return None if stored == computed else where
