"""When poses by alignment are believed: the numbers of the model, and what they are worth.

    python -m experiments.acceptance record RECORDS DATASET [DATASET ...] [--map DATASET]
        [--method objconnect] [--start none] [--every N] [--set key=value] [--cache CACHE]
    python -m experiments.acceptance fit RECORDS [RECORDS ...] [--out FILE]
    python -m experiments.acceptance check RECORDS [RECORDS ...] [--model FILE] [--risk 0.05]
        [--picture FILE]

``record`` localizes queries, believes nothing, and writes what each alignment and the matches told
beside how wrong they were. With ``--map`` the queries are looked for in the map of another place,
where all poses are wrong. ``fit`` prints the model, chosen without regard to one file of records at
a time. ``check`` prints what a model is worth on each file, and draws its reliability. Give scenes
of seeds 100 to 999 to ``fit``, and others, or other cameras and seasons, to ``check``.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize

import objconnect.localization.featuremetric.attempt as attempts
import objconnect.localization.featuremetric.localizer as localizers
import objconnect.localization.featuremetric.refiner as refiners
from benchmark.cli.arguments import parse_settings
from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import Start, parse_start
from benchmark.scoring.score import wilson
from objconnect.localization.featuremetric.acceptance import (
    RIGHT_DEG,
    RIGHT_M,
    AcceptanceModel,
    AlignedModel,
    MatchedModel,
    best_probability,
)
from objconnect.localization.featuremetric.attempt import Attempt, sigma_m
from objconnect.localization.featuremetric.evidence import Evidence
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.methods import create
from objconnect.scene.config import load_config
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate
from objconnect.scene.runtime.progress import progress_bar

Array = NDArray[np.float64]

# Believed by nobody, so that a search tries all that it has.
_NEVER: Final = 1e-30
# Weights of the squared coefficients among which leaving one file out chooses.
_RIDGES: Final = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
# Hardly any pose by matches is wrong, so that leaving files out does not tell the ridge of these.
_MATCHED_RIDGE: Final = 0.01
_BINS: Final = (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)
_NEAR_M, _NEAR_DEG = 1.0, 5.0
_EXACT_M: Final = 0.5


class Told(NamedTuple):
    """What an alignment told of one pose.

    Attributes:
        evidence: what tells whether it is right.
        pose: ``cam_from_world`` as qw qx qy qz tx ty tz.
        metres: how far it is off; infinite in the map of another place.
        degrees: by how much it is turned.
        sigma_m: predicted standard deviation of its position, metres.
    """

    evidence: Evidence
    pose: tuple[float, ...]
    metres: float
    degrees: float
    sigma_m: float

    @property
    def right(self) -> bool:
        """Whether the pose is right, and exact enough to be no chance."""
        return self.metres < _NEAR_M and self.degrees < _NEAR_DEG

    @property
    def false(self) -> bool:
        """Whether the pose is wrong by far."""
        return self.metres > RIGHT_M or self.degrees > RIGHT_DEG

    @property
    def pose_of(self) -> Pose:
        """Return the pose."""
        return Pose.from_quaternion(self.pose[:4], self.pose[4:])


class Record(NamedTuple):
    """What was told of one query.

    Attributes:
        query: its name.
        aligned: poses by alignment in the order in which they were tried.
        inliers: of the pose by matches; 0 without one.
        matched_right: whether the pose by matches is right.
    """

    query: str
    aligned: list[Told]
    inliers: int
    matched_right: bool


def record(given: argparse.Namespace) -> None:
    """Localize queries, and write what was told of their poses."""
    settings = {"search": {"risk": _NEVER}, "tracking": None} | parse_settings(given.set)
    cache = given.cache or Path(tempfile.mkdtemp())
    given.records.parent.mkdir(parents=True, exist_ok=True)
    with given.records.open("w") as file:
        for path in given.datasets:
            for dataset in open_datasets(path)[:1]:
                other = open_datasets(given.map)[0] if given.map else None
                for each in _localize_queries(dataset, other, given, settings, cache):
                    file.write(json.dumps(_plain(each)) + "\n")
                    file.flush()


def _localize_queries(
    dataset: Dataset,
    other: Dataset | None,
    given: argparse.Namespace,
    settings: dict[str, Any],
    cache: Path,
) -> Iterator[Record]:
    """Yield what is told of the queries of a data set, in its map or in another's."""
    localizer = create(given.method, settings)
    assert isinstance(localizer, FeaturemetricLocalizer)
    there = other or dataset
    localizer.prepare(there.load_map(), there.images, cache)
    start: Start = given.start
    load = start.loader(dataset, dataset.load_map(), cache)
    told: list[Attempt] = []
    matched: list[Estimate] = []

    def evaluate_and_keep(*arguments: Any) -> Attempt:
        told.append(judge(*arguments))
        return told[-1]

    def is_answer(estimate: Estimate, _: object) -> bool:
        matched.append(estimate)
        return False

    judge = attempts.evaluate_alignment
    queries = dataset.queries[:: given.every]
    with (
        patch.object(refiners, "evaluate_alignment", evaluate_and_keep),
        patch.object(localizers, "is_answer", is_answer),
        progress_bar(f"{dataset.name} in {there.name}", len(queries)) as advance,
    ):
        for done, query in enumerate(queries, 1):
            told.clear()
            matched.clear()
            localizer.localize(load(query))
            sigmas = [sigma_m(each, localizer.config.search) for each in told]
            yield _record(query, told, sigmas, matched, other is None)
            advance(done)


def _record(
    query: BenchmarkQuery,
    told: Sequence[Attempt],
    sigmas: Sequence[float],
    matched: Sequence[Estimate],
    here: bool,
) -> Record:
    aligned = []
    for each, sigma in zip(told, sigmas, strict=True):
        if each.evidence is None:
            continue
        metres, degrees = (float(part) for part in each.pose.error_to(query.reference))
        numbers = (*each.pose.quaternion().tolist(), *each.pose.translation.tolist())
        off = metres if here else math.inf
        aligned.append(Told(each.evidence, numbers, off, degrees, sigma))
    best = matched[0] if matched and matched[0].probability is not None else None
    if best is None or best.cam_from_world is None:
        return Record(query.name, aligned, 0, False)
    metres, degrees = (float(part) for part in best.cam_from_world.error_to(query.reference))
    right = here and metres < RIGHT_M and degrees < RIGHT_DEG
    return Record(query.name, aligned, best.inliers, right)


def _plain(record: Record) -> dict[str, Any]:
    aligned = [each._asdict() | {"evidence": asdict(each.evidence)} for each in record.aligned]
    return record._asdict() | {"aligned": aligned}


def read(path: Path) -> list[Record]:
    """Return the records of a file."""
    records = []
    for line in path.read_text().splitlines():
        values = json.loads(line)
        aligned = [
            Told(Evidence(**each.pop("evidence")), tuple(each.pop("pose")), **each)
            for each in values.pop("aligned")
        ]
        records.append(Record(aligned=aligned, **values))
    return records


def _cases(records: Sequence[Record]) -> tuple[Array, Array, Array]:
    """Return terms (N, 3), labels (N,) and weights (N,) of poses; a query weighs one in all.

    Poses that are off by 1 to 5 m are left out: they are at the right place inexactly, or by the
    chance of a near prior.
    """
    told = [
        (each, 1 / len(record.aligned))
        for record in records
        for each in record.aligned
        if each.right or each.false
    ]
    terms = np.array([each.evidence.terms() for each, _ in told]).reshape(-1, 3)
    labels = np.array([each.right for each, _ in told], float)
    return terms, labels, np.array([weight for _, weight in told])


def _matches(records: Sequence[Record]) -> tuple[Array, Array, Array]:
    """Return terms (N, 1), labels (N,) and weights (N,) of poses by matches."""
    told = [record for record in records if record.inliers]
    terms = np.log([float(record.inliers) for record in told]).reshape(-1, 1)
    labels = np.array([record.matched_right for record in told], float)
    return terms, labels, np.ones(len(told))


Cases = tuple[Array, Array, Array]


def _loss(numbers: Array, cases: Cases) -> float:
    terms, labels, weights = cases
    odds = numbers[0] + terms @ numbers[1:]
    each = np.logaddexp(0, odds) - labels * odds
    return float((weights * each).sum() / max(weights.sum(), 1e-9))


def _regression(cases: Cases, ridge: float) -> Array:
    """Return the bias and the coefficients (1 + C,) of a logistic regression."""
    terms, _, _ = cases
    spread = terms.std(0).clip(1e-6)

    def penalize(numbers: Array) -> float:
        return _loss(numbers, cases) + ridge * float(((numbers[1:] * spread) ** 2).sum()) / 100

    return np.asarray(minimize(penalize, np.zeros(1 + terms.shape[1]), method="BFGS").x)


def _together(parts: Sequence[Cases]) -> Cases:
    terms, labels, weights = zip(*parts, strict=True)
    return np.concatenate(terms), np.concatenate(labels), np.concatenate(weights)


def _chosen(parts: Sequence[Cases]) -> Array:
    """Return the regression whose ridge does best on each part when fitted to the others."""

    def unseen(ridge: float) -> float:
        losses = []
        for k, part in enumerate(parts):
            others = _together([each for j, each in enumerate(parts) if j != k])
            losses.append(_loss(_regression(others, ridge), part))
        return float(np.mean(losses))

    if len(parts) == 1:
        return _regression(parts[0], _RIDGES[len(_RIDGES) // 2])
    ridge = min(_RIDGES, key=unseen)
    print(f"ridge {ridge:g}, log loss of files that were left out {unseen(ridge):.4f}")
    return _regression(_together(parts), ridge)


def fit(given: argparse.Namespace) -> None:
    """Print the model that records give, and write it."""
    files = [read(path) for path in given.records]
    aligned = _chosen([_cases(records) for records in files if records])
    model = AcceptanceModel(
        aligned=AlignedModel(**dict(zip(AlignedModel.model_fields, aligned.round(3), strict=True))),
        matched=_fit_matches(_together(list(map(_matches, files)))),
    )
    print(model)
    if given.out:
        model.write(given.out, "python -m experiments.acceptance")


def _fit_matches(cases: Cases) -> MatchedModel:
    """Return the model of poses by matches; the shipped one where records have no such pose."""
    if not len(cases[0]):
        return AcceptanceModel.beside(None).matched
    numbers = _regression(cases, _MATCHED_RIDGE).round(3)
    return MatchedModel(**dict(zip(MatchedModel.model_fields, numbers, strict=True)))


class Answer(NamedTuple):
    """What a model makes of one query.

    Attributes:
        probability: of the likeliest pose.
        told: what was told of that.
        tried: number of alignments until it was believed.
    """

    probability: float
    told: Told
    tried: int

    def taken(self, risk: float, most_sigma_m: float) -> bool:
        """Return whether the pose is answered."""
        return self.probability >= 1 - risk and self.told.sigma_m <= most_sigma_m


def choose_answer(record: Record, model: AcceptanceModel, risk: float) -> Answer | None:
    """Return the pose that is believed first, or the likeliest one of all; None without a pose."""
    poses = [(each.pose_of, model.of_alignment(each.evidence)) for each in record.aligned]
    for tried in range(1, len(poses) + 1):
        best, probability = best_probability(poses[:tried])
        if probability >= 1 - risk or tried == len(poses):
            return Answer(probability, record.aligned[best], tried)
    return None


def check(given: argparse.Namespace) -> None:
    """Print what a model is worth on each file of records, and draw its reliability."""
    model = load_config(AcceptanceModel, given.model or AcceptanceModel.shipped_path(), {})
    print(
        "| records | queries | answered | wrong by > 1 m, 5° | wrong by > 5 m, 10° | right within "
        "0.5 m | of these refused | calibration error |\n|---|--:|--:|--:|--:|--:|--:|--:|"
    )
    drawn = {}
    for records in given.records:
        some = [choose_answer(each, model, given.risk) for each in read(records)]
        answers = [each for each in some if each is not None]
        drawn[records.stem] = answers
        _row(records.stem, answers, given)
    _row("all", [each for answers in drawn.values() for each in answers], given)
    if given.picture:
        _draw(drawn, given.picture)


def _row(name: str, answers: Sequence[Answer], given: argparse.Namespace) -> None:
    taken = [each.told for each in answers if each.taken(given.risk, given.most_sigma)]
    wrong = sum(each.metres > _NEAR_M or each.degrees > _NEAR_DEG for each in taken)
    false = sum(each.false for each in taken)
    exact = [each for each in answers if each.told.metres < _EXACT_M and each.told.right]
    refused = sum(not each.taken(given.risk, given.most_sigma) for each in exact)
    high = 100 * wilson(false, max(len(taken), 1))[1]
    print(
        f"| {name} | {len(answers)} | {len(taken)} | {wrong} | {false} [≤ {high:.1f} %] | "
        f"{len(exact)} | {refused} | {calibration_error(answers):.3f} |"
    )


def calibration_error(answers: Sequence[Answer]) -> float:
    """Return the expected calibration error (Naeini et al., AAAI 2015) of probabilities.

    Poses that are neither right nor false, which ``fit`` leaves out, do not count.
    """
    binned = list(_bin(answers))
    total = sum(count * abs(share - expected) for _, expected, share, count in binned)
    return total / max(sum(count for *_, count in binned), 1)


def _bin(answers: Sequence[Answer]) -> Iterator[tuple[float, float, float, int]]:
    """Yield lower bound, mean probability, share that is right, and number, of each bin."""
    clear = [each for each in answers if each.told.right or each.told.false]
    probability = np.array([each.probability for each in clear])
    right = np.array([each.told.right for each in clear])
    for low, high in pairwise(_BINS):
        own = (probability >= low) & ((probability < high) | (high == 1.0))
        if own.any():
            yield low, float(probability[own].mean()), float(right[own].mean()), int(own.sum())


def _draw(drawn: dict[str, list[Answer]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    columns = 4
    rows = math.ceil(len(drawn) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3 * columns, 3 * rows), squeeze=False)
    for axis, (name, answers) in zip(axes.flat, drawn.items(), strict=False):
        axis.plot([0, 1], [0, 1], color="0.7", linewidth=1)
        for _, expected, share, count in _bin(answers):
            low, high = wilson(round(share * count), count)
            axis.plot([expected, expected], [low, high], color="C0", linewidth=1)
            axis.plot([expected], [share], "o", color="C0", markersize=3 + math.log2(1 + count))
        axis.set_title(f"{name} ({len(answers)})", fontsize=9)
        axis.set_xlabel("probability", fontsize=8)
        axis.set_ylabel("share that is right", fontsize=8)
    for axis in list(axes.flat)[len(drawn) :]:
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("record")
    one.add_argument("records", type=Path)
    one.add_argument("datasets", type=Path, nargs="+", metavar="DATASET")
    one.add_argument("--map", type=Path)
    one.add_argument("--method", default="objconnect")
    one.add_argument("--start", default="none", type=parse_start)
    one.add_argument("--every", type=int, default=1)
    one.add_argument("--set", action="append", default=[])
    one.add_argument("--cache", type=Path)
    one.set_defaults(run=record)
    two = commands.add_parser("fit")
    two.add_argument("records", type=Path, nargs="+")
    two.add_argument("--out", type=Path)
    two.set_defaults(run=fit)
    three = commands.add_parser("check")
    three.add_argument("records", type=Path, nargs="+")
    three.add_argument("--model", type=Path)
    three.add_argument("--risk", type=float, default=SearchOptions().risk)
    three.add_argument("--most-sigma", type=float, default=SearchOptions().most_sigma_m)
    three.add_argument("--picture", type=Path)
    three.set_defaults(run=check)
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.run(given)


if __name__ == "__main__":
    main()
