"""``ablate``: what each part of object-connect is worth.

Variants of the network learn from the same pairs, as many steps from the same weights, and answer
the same queries; the first of them is what the others are held against.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from pydantic import Field, model_validator

from baselines.checkpoint import shipped
from baselines.pixloc.localizer import SHIPPED
from baselines.training.command import train
from baselines.training.config import TrainConfig
from benchmark.datasets.dataset import Dataset
from benchmark.evaluate import evaluate, method_of, results_path
from benchmark.paired import compare, mcnemar
from benchmark.registry import create, trainable
from benchmark.report.markdown import escaped
from benchmark.results import TOTAL, QueryResult, Results, load
from benchmark.score import THRESHOLDS, is_correct, recall
from benchmark.starts import Start
from objconnect.config import ObjConnectNetConfig
from objconnect.localizer import ObjConnectConfig
from scene.config import Config
from scene.storage.files import write_text
from scene.storage.outputs import Output, claim, claim_folder

METHOD: Final = "objconnect"
TABLE: Final = "ablation.md"
# Stands near the beginning of every table.
_MARK: Final = b"| variant |"
# That of the paper's table.
_THRESHOLD: Final = THRESHOLDS[1]


class Variant(Config):
    """One row of the table.

    Attributes:
        name: of the row, and of its folder.
        network: switches; what is not given is as the weights have it.
        method: options of the localizer; variants that differ in these alone share their training.
    """

    name: str = Field(pattern=r"^\w[\w ,+-]*$")
    network: ObjConnectNetConfig = ObjConnectNetConfig()
    method: ObjConnectConfig = ObjConnectConfig()


class Plan(Config):
    """An ablation.

    Attributes:
        training: of every variant; ``network`` is the variant's, and without ``weights`` it begins
            with those of pixloc that come with the project.
        variants: the first is what others are held against.
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
    name: str
    runs: list[Results]

    def queries(self, condition: str | None = None) -> list[QueryResult]:
        """Of all data sets, in their order."""
        every = [query for run in self.runs for query in run.queries]
        return [query for query in every if condition in (None, query.condition)]


def ablate(
    plan: Plan,
    data: Sequence[Path],
    validation: Sequence[Path],
    datasets: Sequence[Dataset],
    out: Path,
    start: Start,
) -> str:
    """Train and ask every variant; what an interrupted call had finished is not done again.

    Args:
        plan: what to compare.
        data: scenes to learn from.
        validation: scenes to look at while training.
        datasets: to answer queries of; none of ``data``.
        out: folder of the training runs, the results and the table ``ablation.md``.
        start: what variants are told about each query.

    Returns:
        The table as Markdown.

    Raises:
        InputError: as ``train`` and ``evaluate``.
    """
    claim_folder(out, [*data, *validation])
    claim([Output(out / TABLE, _MARK)], within=out)
    rows: list[_Row] = []
    trained: list[tuple[ObjConnectNetConfig, Path]] = []
    for variant in plan.variants:
        folder = out / _folder(variant.name)
        weights = next((path for switches, path in trained if switches == variant.network), None)
        if weights is None:
            weights = _train(plan.training, variant, data, validation, folder)
            trained.append((variant.network, weights))
        localizer = create(METHOD, {**_given(variant.method), "weights": weights})
        runs = []
        for dataset in datasets:
            path = results_path(folder, dataset, localizer)
            done = load(path) if path.is_file() else None
            asked = (method_of(localizer), dataset.sha256, start.name)
            if done is None or (done.method, done.dataset.sha256, done.start) != asked:
                done = evaluate(dataset, localizer, folder, start, cache=out / "cache")
            runs.append(done)
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
    weights = training.weights or shipped(SHIPPED)
    config = training.model_copy(update={"network": _given(variant.network), "weights": weights})
    return train(METHOD, trainable(METHOD), data, folder / "training", config, validation)


def _given(config: Config) -> dict[str, Any]:
    return config.model_dump(exclude_unset=True)


def _table(rows: Sequence[_Row]) -> Iterator[str]:
    conditions = list(dict.fromkeys(query.condition for query in rows[0].queries()))
    counts = [
        f"{escaped(condition)} ({len(rows[0].queries(condition))})" for condition in conditions
    ]
    header = ["variant", *counts, f"against {rows[0].name}", "s/query"]
    yield "| " + " | ".join(header) + " |"
    yield "| --- |" + " --: |" * (len(header) - 1)
    first = [is_correct(query, _THRESHOLD) for query in rows[0].queries()]
    for row in rows:
        found = (recall(row.queries(condition), _THRESHOLD) for condition in conditions)
        cells = [f"{each.value:.1f} [{each.low:.1f}, {each.high:.1f}]" for each in found]
        change = compare(first, [is_correct(query, _THRESHOLD) for query in row.queries()])
        p = mcnemar(change.lost, change.won)
        beside = "" if row is rows[0] else f"{change.won} won, {change.lost} lost, p = {p:.2g}"
        seconds = [query.seconds[TOTAL] for query in row.queries()]
        cells += [beside, f"{sum(seconds) / len(seconds):.2f}"]
        yield "| " + " | ".join([row.name, *cells]) + " |"


def _folder(name: str) -> str:
    return re.sub(r"\W+", "-", name).strip("-")
