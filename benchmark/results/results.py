"""The results of one method on one data set, from which every figure can be recomputed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from benchmark.datasets.dataset import Dataset
from benchmark.results.priors import add_prior_errors
from benchmark.results.query_result import QueryResult
from benchmark.scoring.summary import Summary, summarize, summarize_parts
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.records import Record


class DatasetId(Record):
    """The data set of the results.

    Attributes:
        name: name of the data set.
        track: see ``benchmark.datasets.dataset.Dataset``.
        sha256: digest of all its parts.
        map_conditions: conditions of the map's photographs.
        unjudged: thresholds for which its reference poses are too inexact, see ``Dataset``.
    """

    name: str
    track: str
    sha256: str
    map_conditions: tuple[str, ...]
    unjudged: tuple[str, ...] = ()

    @staticmethod
    def of(dataset: Dataset) -> DatasetId:
        """Return the identity of a data set, as results record it."""
        return DatasetId(
            name=dataset.name,
            track=dataset.track,
            sha256=dataset.sha256,
            map_conditions=dataset.map_conditions,
            unjudged=dataset.unjudged,
        )


class Results(Record):
    """The results of one method on one data set.

    Attributes:
        schema_version: version of the file format.
        method: method that was run.
        dataset: data set that it was run on.
        start: name of the starting information, see ``evaluation.starts``; a run from "prior" is
            recorded as "none" if no query has a prior.
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
        queries = add_prior_errors(queries, start)
        run = prepare, peak_memory_mb, dataset.unjudged
        return Results(
            method=method,
            dataset=dataset,
            start=start,
            environment=Environment.current(),
            summary=summarize(queries, *run),
            **{f"by_{part}": figures for part, figures in summarize_parts(queries, *run).items()},
            queries=queries,
        )

    def write(self, path: Path) -> None:
        """Write the file atomically.

        Raises:
            InputError: the folder cannot be written.
        """
        write_text(path, self.model_dump_json(indent=1, by_alias=True) + "\n")


def rescore(results: Results) -> Results:
    """Return the results with every figure recomputed from the list of queries.

    If the name of the start states the error of the priors, queries without this error get it.
    """
    queries = add_prior_errors(results.queries, results.start)
    summary = results.summary
    run = summary.seconds.prepare, summary.peak_memory_mb, results.dataset.unjudged
    return results.model_copy(
        update={
            "queries": queries,
            "summary": summarize(queries, *run),
            **{f"by_{part}": by for part, by in summarize_parts(queries, *run).items()},
        }
    )
