"""Ablation of object-connect: what each part of the network contributes.

``python -m experiments.ablation experiments/ablation.yaml DATASET... --data SCENE --out OUT``

All variants of the network are trained on the same pairs, for the same number of steps and from the
same weights, and localize the same queries. The first variant is the reference that the others are
compared with.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from pydantic import Field, model_validator

from baselines.pixloc.localizer import SHIPPED
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate, results_path
from benchmark.evaluation.starts import Start, parse_start
from benchmark.report.markdown import escape
from benchmark.results.query_result import TOTAL, QueryResult
from benchmark.results.results import Results
from benchmark.results.results_files import load
from benchmark.scoring.clustered import permutation_p
from benchmark.scoring.paired import compare
from benchmark.scoring.score import THRESHOLDS, is_correct, recall
from benchmark.tracks.description import read_held_out
from objconnect.learning.checkpoint import shipped_path
from objconnect.learning.training.command import train
from objconnect.learning.training.config import TrainConfig
from objconnect.localization.provenance import Method
from objconnect.methods import create, trainable
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.localizer import ObjConnectConfig
from objconnect.scene.config import Config, load_config
from objconnect.scene.runtime.script import run_script
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.outputs import OutputFile, check_output_folder, check_outputs

METHOD: Final = "objconnect"
TABLE: Final = "ablation.md"
# These bytes stand near the beginning of every table that this command wrote.
_MARK: Final = b"| variant |"
# The threshold of the table in the object-connect paper.
_THRESHOLD: Final = THRESHOLDS[1]


class Variant(Config):
    """One row of the table.

    Attributes:
        name: name of the row and of its folder.
        network: switches of the network; those that are not given stay as in the initial weights.
        method: options of the localizer; variants that differ in these alone share one training.
    """

    name: str = Field(pattern=r"^\w[\w ,+-]*$")
    network: ObjConnectNetConfig = ObjConnectNetConfig()
    method: ObjConnectConfig = ObjConnectConfig()


class Plan(Config):
    """The plan of an ablation.

    Attributes:
        training: configuration of every training. Its ``network`` is replaced by the variant's;
            without ``weights``, training begins with the pixloc weights of the project.
        variants: rows of the table; the first is the reference for the others.
    """

    training: TrainConfig
    variants: tuple[Variant, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        folders = [_folder(variant.name) for variant in self.variants]
        if len(set(folders)) < len(folders):
            raise ValueError("two variants have one name")
        return self


class _Row(NamedTuple):
    """The results of one variant on all data sets."""

    name: str
    runs: list[Results]

    def queries(self, condition: str | None = None) -> list[QueryResult]:
        """Return the queries of all data sets, or those taken under one condition."""
        queries = [query for run in self.runs for query in run.queries]
        return [query for query in queries if condition in (None, query.condition)]


def ablate(
    plan: Plan,
    data: Sequence[Path],
    validation: Sequence[Path],
    datasets: Sequence[Dataset],
    out: Path,
    start: Start,
) -> str:
    """Train and evaluate every variant of a plan.

    A second call continues an interrupted one.

    Args:
        plan: variants to compare.
        data: scenes to learn from.
        validation: scenes on which the loss is measured during training.
        datasets: data sets to evaluate on; none of them should be among ``data``.
        out: folder of the training runs, the results and the table ``ablation.md``.
        start: information on each query that the variants get.

    Returns:
        The table as Markdown.

    Raises:
        InputError: for the reasons of ``train`` and ``evaluate``.
    """
    check_output_folder(out, [*data, *validation])
    check_outputs([OutputFile(out / TABLE, _MARK)], within=out)
    rows: list[_Row] = []
    trained: list[tuple[ObjConnectNetConfig, Path]] = []
    for variant in plan.variants:
        folder = out / _folder(variant.name)
        weights = next((path for switches, path in trained if switches == variant.network), None)
        if weights is None:
            weights = _train(plan.training, variant, data, validation, folder)
            trained.append((variant.network, weights))
        localizer = create(METHOD, {**_collect_explicit(variant.method), "weights": weights})
        runs = []
        for dataset in datasets:
            path = results_path(folder, dataset, localizer)
            run = load(path) if path.is_file() else None
            expected = (Method.of(localizer), dataset.sha256, start.name)
            if run is None or (run.method, run.dataset.sha256, run.start) != expected:
                run = evaluate(dataset, localizer, folder, start, cache=out / "cache")
            runs.append(run)
        rows.append(_Row(variant.name, runs))
    text = "\n".join(_table(rows)) + "\n"
    write_text(out / TABLE, text)
    return text


def _train(
    training: TrainConfig,
    variant: Variant,
    data: Sequence[Path],
    validation: Sequence[Path],
    folder: Path,
) -> Path:
    weights = training.weights or shipped_path(SHIPPED)
    config = training.model_copy(
        update={"network": _collect_explicit(variant.network), "weights": weights}
    )
    return train(
        METHOD, trainable(METHOD), data, folder / "training", config, validation, read_held_out()
    )


def _collect_explicit(config: Config) -> dict[str, Any]:
    """Return the values of a configuration that were given, without its defaults."""
    return config.model_dump(exclude_unset=True)


def _table(rows: Sequence[_Row]) -> Iterator[str]:
    """Yield the lines of the table as Markdown."""
    conditions = list(dict.fromkeys(query.condition for query in rows[0].queries()))
    counts = [
        f"{escape(condition)} ({len(rows[0].queries(condition))})" for condition in conditions
    ]
    header = ["variant", *counts, f"against {rows[0].name}", "s/query"]
    yield "| " + " | ".join(header) + " |"
    yield "| --- |" + " --: |" * (len(header) - 1)
    first = [is_correct(query, _THRESHOLD) for query in rows[0].queries()]
    for row in rows:
        recalls = (recall(row.queries(condition), _THRESHOLD) for condition in conditions)
        cells = [each.text() for each in recalls]
        found = [is_correct(query, _THRESHOLD) for query in row.queries()]
        change = compare(first, found)
        p = permutation_p(first, found, [query.course_name for query in row.queries()])
        chance = "p unknown" if p is None else f"p = {p:.2g}"
        verdict = "" if row is rows[0] else f"{change.won} won, {change.lost} lost, {chance}"
        seconds = [query.seconds[TOTAL] for query in row.queries()]
        cells += [verdict, f"{sum(seconds) / len(seconds):.2f}"]
        yield "| " + " | ".join([row.name, *cells]) + " |"


def _folder(name: str) -> str:
    """Return the folder name of a variant."""
    return re.sub(r"\W+", "-", name).strip("-")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", type=Path, help="variants, a YAML file")
    parser.add_argument("datasets", type=Path, nargs="+", help="data sets to evaluate on")
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="scenes to learn from")
    parser.add_argument("--validation", type=Path, nargs="*", default=[])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--start", default="error=3m,5deg")
    args = parser.parse_args()
    datasets = [each for path in args.datasets for each in open_datasets(path)]
    plan = load_config(Plan, args.plan, {})
    start = parse_start(args.start)
    print(ablate(plan, args.data, args.validation, datasets, args.out, start))


if __name__ == "__main__":
    run_script(main)
