"""The results file of one method on one data set, from which every figure can be recomputed.

The module is over 400 lines because the models of the file stand beside the summaries that
recompute their figures, and reading compares the two.
"""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from benchmark.score import THRESHOLDS, false_fixes, median_errors, recall
from benchmark.uncertainty import consistency
from scene.bundle.manifest import Condition, read_json
from scene.errors import InputError
from scene.geometry.geodesy import FARTHEST_M
from scene.localizer import Status
from scene.storage.atomic import write_text
from scene.storage.files import parse_json
from scene.storage.listing import list_files
from scene.storage.outputs import check_outputs, foreign_file_error
from scene.storage.packed import MAGIC, SUFFIX, unpack

# Larger numbers in a file are damage; sums of them could overflow.
_MOST: Final = 10**12
LARGEST_NEES: Final = 1e100
# 180 degrees, with room for the rounding errors of a quaternion.
_MOST_DEG: Final = 180.001
_Number = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
_Length = Annotated[float, Field(ge=-10 * FARTHEST_M, le=10 * FARTHEST_M)]
_Count = Annotated[int, Field(ge=0, le=_MOST)]
_Time = Annotated[float, Field(ge=0, le=_MOST)]
PoseNumbers = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number]

# The stage with the whole time of a query, measured outside the method.
TOTAL = "total"

# Ending of basin files, which lie beside results but are not results; see ``benchmark.basin``.
BASIN: Final = ".basin.json"

# Ending of compact results files; see ``benchmark.tracks.compact``.
PACKED: Final = f".json{SUFFIX}"

# The first bytes of every results file and basin file, and of what a compact one holds.
_HEADS: Final = (b'{\n "schema": 1,\n "method": {', b'{"schema":1,"method":{')

# Stored and recomputed figures that differ relatively by more show that the file was changed.
_TOLERANCE = 1e-9
# Figures that files of earlier versions lack; they are computed when the file is read.
_ADDED: Final = {"false_fixes"}
# Width of an altitude band, metres.
_BAND_M = 30
# The only key in the configuration of an external method.
_POSES = "poses"


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Named(_File):
    """An entry of a journal, which is identified by the name of its photograph."""

    name: str


class Method(_File):
    """The method that was run. ``config`` holds everything that changes its result."""

    name: str
    config: dict[str, Any]
    weights_sha256: str | None

    @staticmethod
    def external(name: str, poses_sha256: str) -> Method:
        """Return the method of another program, of which only the poses are known."""
        return Method(name=name, config={_POSES: poses_sha256}, weights_sha256=None)

    @property
    def is_external(self) -> bool:
        """Return whether the poses came from another program."""
        return set(self.config) == {_POSES}


class DatasetId(_File):
    """The data set of the results. ``map_conditions`` are those of the map's photographs."""

    name: str
    track: str
    sha256: str
    map_conditions: tuple[str, ...]


class Environment(_File):
    """Versions of the packages that compute the poses."""

    objconnect: str
    python: str
    numpy: str
    torch: str
    pycolmap: str

    @staticmethod
    def current() -> Environment:
        """Return the versions in this process; "unknown" for a package that is not installed."""

        def version_of(package: str) -> str:
            try:
                return version(package)
            except PackageNotFoundError:
                return "unknown"

        names = ("objconnect", "numpy", "torch", "pycolmap")
        return Environment(
            python=platform.python_version(), **{name: version_of(name) for name in names}
        )


class Recall(_File):
    """A percentage of queries with the ends of its Wilson 95 % interval in percent."""

    value: float
    low: float
    high: float


class Seconds(_File):
    """Wall-clock seconds of a method.

    Attributes:
        prepare: seconds of the preparation, once per run.
        per_query: mean over all queries by stage. A stage that a query did not reach counts as
            zero, and "total" is the whole call.
    """

    prepare: float
    per_query: dict[str, float]


class Uncertainty(_File):
    """Figures that compare errors with predicted covariances.

    See ``benchmark.uncertainty.Consistency``.
    """

    queries: int
    nees_mean: float
    nees_median: float
    within_95: Recall


class Summary(_File):
    """Figures of a set of queries.

    Attributes:
        queries: number of queries; all of them are in every denominator.
        recall: recall by the key of a threshold, such as "0.25m_2deg".
        false_fixes: share of the queries of status ``ok`` whose pose is wrong by more than
            5 m or 10 degrees; None only in a file of an earlier version, as it lies on disk.
        median_t_m: median position error of the queries with a pose, metres; None without any.
        median_r_deg: median rotation error of the queries with a pose, degrees; None without any.
        failed: number of queries without a pose.
        uncertainty: figures of the localized queries with a covariance; None without any.
        fallback: number of queries whose pose is only the prior's or that of a map photograph; they
            count as wrong.
        seconds: times; ``prepare`` belongs to the whole run, also where the queries are a part of
            it.
        peak_memory_mb: peak memory of the process during the whole run (1e6 bytes); None where the
            system does not measure it.
    """

    queries: int
    recall: dict[str, Recall]
    false_fixes: Recall | None = None
    median_t_m: float | None
    median_r_deg: float | None
    failed: int
    fallback: int
    uncertainty: Uncertainty | None
    seconds: Seconds
    peak_memory_mb: float | None


class QueryResult(Named):
    """The result of one query.

    Attributes:
        name: name of the photograph.
        condition: condition that it was taken under.
        group: flight or drive that it belongs to.
        altitude_m: height of the reference position above the map's points, metres.
        status: status of the estimate.
        reason: why the status is not ``ok``.
        t_err_m: distance between the camera centres, metres; None without a pose.
        r_err_deg: angle between the rotations, degrees; None without a pose.
        cam_from_world: estimated pose as qw qx qy qz tx ty tz; None without a pose.
        sigma_t_m: predicted standard deviation of the camera centre, metres; None if unknown.
        nees: normalised estimation error squared, 6 degrees of freedom; None without covariance.
        iterations: number of iterations that the method reports.
        inliers: number of inliers that the method reports.
        seconds: wall-clock seconds by stage.
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
    """The results of one method on one data set.

    Attributes:
        schema_version: version of the file format.
        method: method that was run.
        dataset: data set that it was run on.
        start: name of the starting information, see ``benchmark.starts``; "prior" if at least one
            query has a prior.
        environment: versions of the packages.
        summary: figures of all queries.
        by_condition: figures of the queries of each condition.
        by_group: figures of the queries of each flight or drive.
        by_altitude: figures of the queries of each band of height above the map's points.
        queries: result of each query.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    method: Method
    dataset: DatasetId
    start: str = Field(pattern=r"^(prior|none|(retrieval|pairs|error|gravity|gps)=[\w.,]+)$")
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
        """Return results whose figures are computed from the list of queries.

        Args:
            method: method that was run.
            dataset: data set that it was run on.
            start: name of the starting information.
            queries: result of each query; at least one.
            prepare: seconds of the preparation.
            peak_memory_mb: peak memory (1e6 bytes); None if unknown.
        """
        run = prepare, peak_memory_mb
        return Results(
            method=method,
            dataset=dataset,
            start=start,
            environment=Environment.current(),
            summary=summarize(queries, *run),
            **{f"by_{part}": figures for part, figures in summarize_parts(queries, *run).items()},
            queries=tuple(queries),
        )

    def write(self, path: Path) -> None:
        """Write the file atomically.

        Raises:
            InputError: the folder cannot be written.
        """
        write_text(path, self.model_dump_json(indent=1, by_alias=True) + "\n")


def method_in(path: Path) -> Method | None:
    """Return the method of the results file or basin file at a path.

    The answer is None where there is no file, or a damaged one that this program wrote.

    Raises:
        WriteError: the file is neither of these.
    """
    if not path.is_file():
        return None
    content = path.read_bytes()
    if content.startswith(MAGIC):
        try:
            content = unpack(content)
        except ValueError:
            return None
    try:
        return Method.model_validate(parse_json(content.decode())["method"])
    except (ValueError, KeyError, TypeError):
        if content and not content.startswith(_HEADS):
            raise foreign_file_error(path) from None
    return None


def claim_results(path: Path, method: Method, out: Path) -> None:
    """Refuse, before any work, to replace a file that is not an older version of these results.

    Results of ``evaluate`` are replaced only by ``evaluate``, and those of ``score`` by ``score``.

    Args:
        path: path of the results that will be written.
        method: their method.
        out: folder of all results.

    Raises:
        InputError: another command wrote the file there, or ``check_outputs`` refuses
            the path.
    """
    check_outputs([path], within=out)
    before = method_in(path)
    if before is None:
        return
    if before.is_external != method.is_external:
        writer = "score" if before.is_external else "evaluate"
        remedy = "remove it" if before.is_external else "choose another --method"
        raise InputError(
            f"{path} holds results that {writer} wrote: {remedy}, or choose another --out"
        )


def summarize(
    queries: Sequence[QueryResult], prepare: float, peak_memory_mb: float | None
) -> Summary:
    """Return the figures of queries.

    Args:
        queries: queries of a run; at least one.
        prepare: seconds that the run took before its first query.
        peak_memory_mb: peak memory of the run (1e6 bytes); None if unknown.
    """
    median_t, median_r = median_errors(queries)
    stages = dict.fromkeys(stage for query in queries for stage in query.seconds)
    return Summary(
        queries=len(queries),
        recall={
            threshold.key: Recall(**recall(queries, threshold)._asdict())
            for threshold in THRESHOLDS
        },
        false_fixes=Recall(**false_fixes(queries)._asdict()),
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
    """Return the figures of the queries by condition, group and altitude.

    Returns:
        For each of "condition", "group" and "altitude" the summaries by name.
    """
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
    """Return the altitude band of a query, such as "60-90 m"."""
    low = _BAND_M * math.floor(query.altitude_m / _BAND_M)
    return f"{low}-{low + _BAND_M} m"


def _natural(name: str) -> tuple[int, str]:
    """Return a key that sorts altitude bands by height and other names alphabetically."""
    match = re.match(r"(-?[0-9]+)-", name) if name.endswith(" m") else None
    return int(match.group(1)) if match else 0, name


_PARTS: Final[dict[str, Callable[[QueryResult], str]]] = {
    "condition": lambda query: query.condition,
    "group": lambda query: query.group,
    "altitude": _band,
}


def _uncertainty(queries: Sequence[QueryResult]) -> Uncertainty | None:
    figures = consistency(queries)
    if figures is None:
        return None
    return Uncertainty(
        queries=figures.queries,
        nees_mean=figures.mean,
        nees_median=figures.median,
        within_95=Recall(**figures.within_95._asdict()),
    )


def rescore(results: Results) -> Results:
    """Return the results with every figure recomputed from the list of queries."""
    run = results.summary.seconds.prepare, results.summary.peak_memory_mb
    return results.model_copy(
        update={
            "summary": summarize(results.queries, *run),
            **{f"by_{part}": by for part, by in summarize_parts(results.queries, *run).items()},
        }
    )


def results_files(path: Path) -> list[Path]:
    """Return the results files in a folder ``RESULTS`` or ``RESULTS/<dataset>``, or the one file.

    Raises:
        InputError: there is no results file.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"results {path} do not exist")
    files = [
        file
        for file in list_files(path, (".json", SUFFIX), depth=2)
        if file.name.lower().endswith((".json", PACKED)) and not file.name.endswith(BASIN)
    ]
    if not files:
        raise InputError(f"{path} holds no results file (<dataset>/<method>.json)")
    return files


def load(path: Path) -> Results:
    """Read a results file and recompute its figures.

    Raises:
        InputError: the file cannot be read or is not a results file, a query contradicts itself, or
            the figures do not follow from the queries.
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
    parts = {"summary", *(f"by_{part}" for part in _PARTS)}
    stored, computed = (of.model_dump(include=parts) for of in (results, recomputed))
    for part in stored:
        if (where := _difference(stored[part], computed[part], part)) is not None:
            raise InputError(
                f"results file {path}: {where} does not follow from its queries; "
                "the file was changed after it was written"
            )
    return recomputed


def _difference(stored: object, computed: object, where: str) -> str | None:
    """Return the dotted name of the first figure that differs, or None."""
    if isinstance(stored, dict) and isinstance(computed, dict):
        for key in sorted(stored.keys() | computed.keys()):
            if key in _ADDED and stored.get(key) is None:
                continue
            if key not in stored or key not in computed:
                return f"{where}.{key}"
            difference = _difference(stored[key], computed[key], f"{where}.{key}")
            if difference is not None:
                return difference
        return None
    if isinstance(stored, float) and isinstance(computed, float):
        return None if math.isclose(stored, computed, rel_tol=_TOLERANCE) else where
    return None if stored == computed else where
