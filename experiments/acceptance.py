"""Fit and check the model that accepts or rejects poses from alignment.

    python -m experiments.acceptance record RECORDS DATASET [DATASET ...] [--map DATASET]
        [--method objconnect] [--start none] [--every N] [--set key=value] [--cache CACHE]
    python -m experiments.acceptance fit RECORDS [RECORDS ...] [--out FILE]
    python -m experiments.acceptance check RECORDS [RECORDS ...] [--model FILE] [--risk 0.05]
        [--picture FILE]

``record`` localizes queries, accepts no pose, and writes the evidence of every alignment and of the
matches with the errors of their poses. With ``--map`` the queries are localized in the map of
another site, where all poses are wrong. ``fit`` prints the model, with a ridge chosen by
leave-one-file-out cross-validation. ``check`` prints figures of a model on each file, and draws its
reliability. Give scenes of seeds 100 to 999 to ``fit``, and others, or other cameras and seasons,
to ``check``.
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
from benchmark.scoring.intervals import wilson
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

# A risk at which no pose is accepted, so that a search tries all candidates.
_NEVER: Final = 1e-30
# Ridges from which cross-validation chooses: weights of the squared coefficients, in hundredths.
_RIDGES: Final = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
# Ridge of the model of matches. Hardly any pose from matches is wrong, so cross-validation cannot
# choose it.
_MATCHED_RIDGE: Final = 0.01
# Bounds of the bins of probability.
_BINS: Final = (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)
# In the fit, a pose is right within these errors. ``check`` counts refused poses whose error is
# below ``_EXACT_M``.
_NEAR_M, _NEAR_DEG = 1.0, 5.0
_EXACT_M: Final = 0.5


class AlignedPose(NamedTuple):
    """A pose from an alignment, with its evidence and its error.

    Attributes:
        evidence: evidence of whether it is right.
        pose: ``cam_from_world`` as qw qx qy qz tx ty tz.
        metres: position error; infinite in the map of another site.
        degrees: rotation error.
        sigma_m: predicted standard deviation of its position, metres.
    """

    evidence: Evidence
    pose: tuple[float, ...]
    metres: float
    degrees: float
    sigma_m: float

    @property
    def is_near(self) -> bool:
        """Whether the pose is right, and too exact to be right by chance."""
        return self.metres < _NEAR_M and self.degrees < _NEAR_DEG

    @property
    def is_false_fix(self) -> bool:
        """Whether the pose is a false fix."""
        return self.metres > RIGHT_M or self.degrees > RIGHT_DEG

    @property
    def cam_from_world(self) -> Pose:
        """The pose."""
        return Pose.from_quaternion(self.pose[:4], self.pose[4:])


class Record(NamedTuple):
    """The poses of one query.

    Attributes:
        query: its name.
        aligned: poses from alignment in the order of their attempts.
        inliers: number of inliers of the pose from matches; 0 without one.
        matched_right: whether the pose from matches is right.
    """

    query: str
    aligned: list[AlignedPose]
    inliers: int
    matched_right: bool


def record(args: argparse.Namespace) -> None:
    """Localize queries, and write their poses with evidence and errors."""
    settings = {"search": {"risk": _NEVER}, "tracking": None} | parse_settings(args.set)
    cache = args.cache or Path(tempfile.mkdtemp())
    args.records.parent.mkdir(parents=True, exist_ok=True)
    with args.records.open("w") as file:
        for path in args.datasets:
            for dataset in open_datasets(path)[:1]:
                other = open_datasets(args.map)[0] if args.map else None
                for each in _localize_queries(dataset, other, args, settings, cache):
                    file.write(json.dumps(_plain(each)) + "\n")
                    file.flush()


def _localize_queries(
    dataset: Dataset,
    other: Dataset | None,
    args: argparse.Namespace,
    settings: dict[str, Any],
    cache: Path,
) -> Iterator[Record]:
    """Yield the records of the queries of a data set, in its map or in that of ``other``."""
    localizer = create(args.method, settings)
    assert isinstance(localizer, FeaturemetricLocalizer)
    map_dataset = other or dataset
    localizer.prepare(map_dataset.load_map(), map_dataset.images, cache)
    start: Start = args.start
    load = start.loader(dataset, dataset.load_map(), cache)
    tried: list[Attempt] = []
    matched: list[Estimate] = []

    def evaluate_and_keep(*arguments: Any) -> Attempt:
        tried.append(evaluate(*arguments))
        return tried[-1]

    def is_sure_match(estimate: Estimate, _: object) -> bool:
        matched.append(estimate)
        return False

    evaluate = attempts.evaluate_alignment
    queries = dataset.queries[:: args.every]
    with (
        patch.object(refiners, "evaluate_alignment", evaluate_and_keep),
        patch.object(localizers, "is_sure_match", is_sure_match),
        progress_bar(f"{dataset.name} in {map_dataset.name}", len(queries)) as advance,
    ):
        for done, query in enumerate(queries, 1):
            tried.clear()
            matched.clear()
            localizer.localize(load(query))
            sigmas = [sigma_m(attempt, localizer.config.search) for attempt in tried]
            yield _record(query, tried, sigmas, matched, other is None)
            advance(done)


def _record(
    query: BenchmarkQuery,
    tried: Sequence[Attempt],
    sigmas: Sequence[float],
    matched: Sequence[Estimate],
    in_own_map: bool,
) -> Record:
    aligned = []
    for attempt, sigma in zip(tried, sigmas, strict=True):
        if attempt.evidence is None:
            continue
        metres, degrees = (float(part) for part in attempt.pose.error_to(query.reference))
        numbers = (*attempt.pose.quaternion().tolist(), *attempt.pose.translation.tolist())
        error = metres if in_own_map else math.inf
        aligned.append(AlignedPose(attempt.evidence, numbers, error, degrees, sigma))
    best = matched[0] if matched and matched[0].probability is not None else None
    if best is None or best.cam_from_world is None:
        return Record(query.name, aligned, 0, False)
    metres, degrees = (float(part) for part in best.cam_from_world.error_to(query.reference))
    right = in_own_map and metres < RIGHT_M and degrees < RIGHT_DEG
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
            AlignedPose(Evidence(**each.pop("evidence")), tuple(each.pop("pose")), **each)
            for each in values.pop("aligned")
        ]
        records.append(Record(aligned=aligned, **values))
    return records


def _cases(records: Sequence[Record]) -> tuple[Array, Array, Array]:
    """Return terms (N, 3), labels (N,) and weights (N,) of poses; the weights of a query sum to 1.

    Poses with an error of 1 to 5 m are left out: they are inexact, or near by chance because
    the prior was near.
    """
    clear = [
        (pose, 1 / len(record.aligned))
        for record in records
        for pose in record.aligned
        if pose.is_near or pose.is_false_fix
    ]
    terms = np.array([pose.evidence.terms() for pose, _ in clear]).reshape(-1, 3)
    labels = np.array([pose.is_near for pose, _ in clear], float)
    return terms, labels, np.array([weight for _, weight in clear])


def _matches(records: Sequence[Record]) -> tuple[Array, Array, Array]:
    """Return terms (N, 1), labels (N,) and weights (N,) of poses from matches."""
    matched = [record for record in records if record.inliers]
    terms = np.log([float(record.inliers) for record in matched]).reshape(-1, 1)
    labels = np.array([record.matched_right for record in matched], float)
    return terms, labels, np.ones(len(matched))


Cases = tuple[Array, Array, Array]


def _loss(coefficients: Array, cases: Cases) -> float:
    terms, labels, weights = cases
    odds = coefficients[0] + terms @ coefficients[1:]
    each = np.logaddexp(0, odds) - labels * odds
    return float((weights * each).sum() / max(weights.sum(), 1e-9))


def _regression(cases: Cases, ridge: float) -> Array:
    """Return the bias and the coefficients (1 + C,) of a logistic regression."""
    terms, _, _ = cases
    spread = terms.std(0).clip(1e-6)

    def penalize(coefficients: Array) -> float:
        return (
            _loss(coefficients, cases)
            + ridge * float(((coefficients[1:] * spread) ** 2).sum()) / 100
        )

    return np.asarray(minimize(penalize, np.zeros(1 + terms.shape[1]), method="BFGS").x)


def _concatenate(parts: Sequence[Cases]) -> Cases:
    terms, labels, weights = zip(*parts, strict=True)
    return np.concatenate(terms), np.concatenate(labels), np.concatenate(weights)


def _fit_regression(parts: Sequence[Cases]) -> Array:
    """Return the regression with the ridge that cross-validation over the parts chooses."""

    def validate(ridge: float) -> float:
        losses = []
        for k, part in enumerate(parts):
            others = _concatenate([each for j, each in enumerate(parts) if j != k])
            losses.append(_loss(_regression(others, ridge), part))
        return float(np.mean(losses))

    if len(parts) == 1:
        return _regression(parts[0], _RIDGES[len(_RIDGES) // 2])
    ridge = min(_RIDGES, key=validate)
    print(f"ridge {ridge:g}, log loss of files that were left out {validate(ridge):.4f}")
    return _regression(_concatenate(parts), ridge)


def fit(args: argparse.Namespace) -> None:
    """Fit the model to records, print it and write it."""
    files = [read(path) for path in args.records]
    aligned = _fit_regression([_cases(records) for records in files if records])
    model = AcceptanceModel(
        aligned=AlignedModel(**dict(zip(AlignedModel.model_fields, aligned.round(3), strict=True))),
        matched=_fit_matches(_concatenate(list(map(_matches, files)))),
    )
    print(model)
    if args.out:
        model.write(args.out, "python -m experiments.acceptance")


def _fit_matches(cases: Cases) -> MatchedModel:
    """Return the model of poses from matches; the shipped one if the records have no such pose."""
    if not len(cases[0]):
        return AcceptanceModel.load_beside(None).matched
    coefficients = _regression(cases, _MATCHED_RIDGE).round(3)
    return MatchedModel(**dict(zip(MatchedModel.model_fields, coefficients, strict=True)))


class Answer(NamedTuple):
    """The pose that a model chooses for one query.

    Attributes:
        probability: probability that it is right.
        pose: the pose.
        tried: number of alignments until it was accepted.
    """

    probability: float
    pose: AlignedPose
    tried: int

    def is_accepted(self, risk: float, most_sigma_m: float) -> bool:
        """Return whether the pose is accepted."""
        return self.probability >= 1 - risk and self.pose.sigma_m <= most_sigma_m


def choose_answer(record: Record, model: AcceptanceModel, risk: float) -> Answer | None:
    """Return the first accepted pose, or else the most probable one; None without a pose."""
    poses = [
        (pose.cam_from_world, model.alignment_log_odds(pose.evidence)) for pose in record.aligned
    ]
    for tried in range(1, len(poses) + 1):
        best, probability = best_probability(poses[:tried])
        if probability >= 1 - risk or tried == len(poses):
            return Answer(probability, record.aligned[best], tried)
    return None


def check(args: argparse.Namespace) -> None:
    """Print figures of a model on each file of records, and draw its reliability."""
    model = load_config(AcceptanceModel, args.model or AcceptanceModel.shipped_path(), {})
    print(
        "| records | queries | answered | wrong by > 1 m, 5° | wrong by > 5 m, 10° | right within "
        "0.5 m | of these refused | calibration error |\n|---|--:|--:|--:|--:|--:|--:|--:|"
    )
    answers_by_file = {}
    for records in args.records:
        chosen = [choose_answer(each, model, args.risk) for each in read(records)]
        answers = [each for each in chosen if each is not None]
        answers_by_file[records.stem] = answers
        _row(records.stem, answers, args)
    _row("all", [each for answers in answers_by_file.values() for each in answers], args)
    if args.picture:
        _draw(answers_by_file, args.picture)


def _row(name: str, answers: Sequence[Answer], args: argparse.Namespace) -> None:
    accepted = [a.pose for a in answers if a.is_accepted(args.risk, args.most_sigma)]
    wrong = sum(pose.metres > _NEAR_M or pose.degrees > _NEAR_DEG for pose in accepted)
    false = sum(pose.is_false_fix for pose in accepted)
    exact = [a for a in answers if a.pose.metres < _EXACT_M and a.pose.is_near]
    refused = sum(not a.is_accepted(args.risk, args.most_sigma) for a in exact)
    high = 100 * wilson(false, max(len(accepted), 1))[1]
    print(
        f"| {name} | {len(answers)} | {len(accepted)} | {wrong} | {false} [≤ {high:.1f} %] | "
        f"{len(exact)} | {refused} | {calibration_error(answers):.3f} |"
    )


def calibration_error(answers: Sequence[Answer]) -> float:
    """Return the expected calibration error (Naeini et al., AAAI 2015) of probabilities.

    Poses that are neither near nor false fixes are left out, as in ``fit``.
    """
    bins = list(_bin(answers))
    total = sum(count * abs(share - expected) for _, expected, share, count in bins)
    return total / max(sum(count for *_, count in bins), 1)


def _bin(answers: Sequence[Answer]) -> Iterator[tuple[float, float, float, int]]:
    """Yield lower bound, mean probability, share of right poses, and number, of each bin."""
    clear = [each for each in answers if each.pose.is_near or each.pose.is_false_fix]
    probability = np.array([each.probability for each in clear])
    right = np.array([each.pose.is_near for each in clear])
    for low, high in pairwise(_BINS):
        in_bin = (probability >= low) & ((probability < high) | (high == 1.0))
        if in_bin.any():
            yield (
                low,
                float(probability[in_bin].mean()),
                float(right[in_bin].mean()),
                int(in_bin.sum()),
            )


def _draw(drawn: dict[str, list[Answer]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    # The site shows pictures at most about 900 pixels wide: 9 points are then 12 pixels.
    columns, inches, points = 3, 3.0, 9
    rows = math.ceil(len(drawn) / columns)
    size = (inches * columns, inches * rows)
    figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False)
    for axis, (name, answers) in zip(axes.flat, drawn.items(), strict=False):
        axis.plot([0, 1], [0, 1], color="0.7", linewidth=1)
        for _, expected, share, count in _bin(answers):
            low, high = wilson(round(share * count), count)
            axis.plot([expected, expected], [low, high], color="C0", linewidth=1)
            axis.plot([expected], [share], "o", color="C0", markersize=3 + math.log2(1 + count))
        axis.tick_params(labelsize=points)
        axis.set_title(f"{name} ({len(answers)})", fontsize=points)
        axis.set_xlabel("probability", fontsize=points)
        axis.set_ylabel("share that is right", fontsize=points)
    for axis in list(axes.flat)[len(drawn) :]:
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Run one of the three commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True)
    record_parser = commands.add_parser("record")
    record_parser.add_argument("records", type=Path)
    record_parser.add_argument("datasets", type=Path, nargs="+", metavar="DATASET")
    record_parser.add_argument("--map", type=Path)
    record_parser.add_argument("--method", default="objconnect")
    record_parser.add_argument("--start", default="none", type=parse_start)
    record_parser.add_argument("--every", type=int, default=1)
    record_parser.add_argument("--set", action="append", default=[])
    record_parser.add_argument("--cache", type=Path)
    record_parser.set_defaults(run=record)
    fit_parser = commands.add_parser("fit")
    fit_parser.add_argument("records", type=Path, nargs="+")
    fit_parser.add_argument("--out", type=Path)
    fit_parser.set_defaults(run=fit)
    check_parser = commands.add_parser("check")
    check_parser.add_argument("records", type=Path, nargs="+")
    check_parser.add_argument("--model", type=Path)
    check_parser.add_argument("--risk", type=float, default=SearchOptions().risk)
    check_parser.add_argument("--most-sigma", type=float, default=SearchOptions().most_sigma_m)
    check_parser.add_argument("--picture", type=Path)
    check_parser.set_defaults(run=check)
    args = parser.parse_args()
    torch.set_num_threads(1)
    args.run(args)


if __name__ == "__main__":
    main()
