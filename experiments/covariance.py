"""Fit and check the eight constants of the covariance of poses from alignment.

    python -m experiments.covariance SCENE [SCENE ...] [--method objconnect] [--weights WEIGHTS]
        [--start error=3m,5deg] [--cache CACHE] [--out own.covariance.yaml]

Give scenes of seeds 100 to 999, which are not used for reported results, with maps and queries of
many conditions. The constants (``CovarianceModel``) maximize the likelihood of the errors under a
Student distribution of eight degrees of freedom and, with four times the weight, fit for each
condition the mean of the normalised squared errors (NEES) and the share inside the 95 % ellipsoid.
``--out`` writes them: for your own weights as ``own.covariance.yaml`` beside ``own.safetensors``.
Prints the constants and for each condition the NEES with them, with those of the method, and with
the uncalibrated covariance; for several scenes also the NEES of each with the constants fitted to
the others.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

import objconnect.localization.featuremetric.attempt as attempts
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import Start, parse_start
from benchmark.scoring.uncertainty import _CHI2_95
from objconnect.localization.align.covariance import PoseUncertainty
from objconnect.localization.featuremetric.attempt import Attempt
from objconnect.localization.featuremetric.calibration import (
    CovarianceModel,
    calibrate_covariance,
    compute_scales,
)
from objconnect.localization.featuremetric.options import SearchOptions
from objconnect.methods import create
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, Status
from objconnect.scene.runtime.progress import progress_bar

# Degrees of freedom of the Student distribution of the errors, which has heavier tails than normal.
_STUDENT_DOF: Final = 8.0
# Mean and variance of the NEES of such errors.
_NEES_MEAN: Final = 6.0
_NEES_VARIANCE: Final = 2 * _NEES_MEAN * (_STUDENT_DOF + 4) / (_STUDENT_DOF - 4)
# A larger NEES counts as this value in the mean of its condition, because the covariances of right
# poses cannot make up for a false one with a small covariance.
_MAX_NEES: Final = 100.0
# Share of poses that a 95 % ellipsoid should hold.
_INSIDE_SHARE: Final = 0.95
# Width of the logistic function of log NEES by which a pose counts as inside, because a hard count
# has no gradient.
_LOGISTIC_WIDTH: Final = 0.05
# Weight of the means and shares of the conditions relative to the likelihood. The likelihood alone
# makes the covariances too large under conditions with fewer large errors than Student's.
_CONDITION_WEIGHT: Final = 4.0
# Runs of the simplex from each initial value, and their options.
_RESTARTS: Final = 2
_SIMPLEX: Final = {"maxfev": 4000, "adaptive": True}

# Initial values of the search; there are several, because there are several minima.
_INITIAL_VALUES: Final = (
    (1.3, 0.1, 5e-4, 3, 5e-5, 0.6, 0.5, 0.1),
    (2.0, 0.3, 5e-4, 3, 5e-5, 0.6, 0.5, 0.1),
)


@dataclass(frozen=True)
class Answers:
    """Accepted poses, N in all.

    Attributes:
        scenes: (N,) names of the scenes of their queries.
        conditions: (N,) conditions of their queries.
        errors: (N, 6) left tangent from the pose to the true one, rotation (rad), translation (m).
        uncertainty: covariances (N, 6, 6) of the alignments, and the figures that calibrate them.
        fit: (N,) cost of the alignment as a share of the cost by chance.
        false: (N,) whether they are wrong by more than 5 m or 10 degrees.
    """

    scenes: NDArray[np.str_]
    conditions: NDArray[np.str_]
    errors: NDArray[np.float64]
    uncertainty: PoseUncertainty
    fit: NDArray[np.float64]
    false: NDArray[np.bool_]

    def __getitem__(self, mask: NDArray[np.bool_]) -> Answers:
        """Return the poses of a mask (N,)."""
        rows = torch.from_numpy(mask)
        uncertainty = PoseUncertainty(
            *(getattr(self.uncertainty, each.name)[rows] for each in fields(PoseUncertainty))
        )
        columns = (self.scenes, self.conditions, self.errors, self.fit, self.false)
        scenes, conditions, errors, fit, false = (column[mask] for column in columns)
        return Answers(scenes, conditions, errors, uncertainty, fit, false)

    def covariances(self, constants: CovarianceModel) -> NDArray[np.float64]:
        """Return the covariances (N, 6, 6) that the method would answer with these constants."""
        return calibrate_covariance(self.uncertainty, self.fit, constants)

    def nees(self, constants: CovarianceModel) -> NDArray[np.float64]:
        """Return the normalised squared errors (N,) with these constants."""
        return _nees(self.errors, self.covariances(constants))


def _nees(errors: NDArray[np.float64], covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normalised squares (N,) of errors (N, 6)."""
    whitened = np.linalg.solve(covariances, errors[..., None])
    return np.asarray((errors * whitened[..., 0]).sum(-1))


def calibrate(answers: Answers) -> CovarianceModel:
    """Return the constants that fit the errors best."""
    measured, squares = _along_axes(answers)
    groups = [answers.conditions == condition for condition in np.unique(answers.conditions)]

    def unlikeliness(logarithms: NDArray[np.float64]) -> float:
        constants = CovarianceModel.from_values(np.exp(logarithms).tolist())
        factor, added = compute_scales(answers.uncertainty, answers.fit, constants)
        variances = factor[:, None] * measured + added[:, :1]
        volume = np.log(variances).sum() / 2
        nees = (squares / variances).sum(1)
        tail = np.log1p(nees / (_STUDENT_DOF - 2)).sum() * (_STUDENT_DOF + 6) / 2
        bounded, inside = (
            np.minimum(nees, _MAX_NEES),
            expit(np.log(_CHI2_95 / nees) / _LOGISTIC_WIDTH),
        )
        penalty = 0.0
        for group in groups:
            penalty += (
                group.sum() * (bounded[group].mean() - _NEES_MEAN) ** 2 / (2 * _NEES_VARIANCE)
            )
            penalty += (
                group.sum()
                * (inside[group].mean() - _INSIDE_SHARE) ** 2
                / (2 * _INSIDE_SHARE * (1 - _INSIDE_SHARE))
            )
        return float(volume + tail + _CONDITION_WEIGHT * penalty)

    tried = []
    for begin in _INITIAL_VALUES:
        logarithms = np.log(begin)
        for _ in range(_RESTARTS):  # the simplex may shrink before it reaches the minimum
            found = minimize(unlikeliness, logarithms, method="Nelder-Mead", options=_SIMPLEX)
            logarithms = found.x
        tried.append(found)
    best = np.exp(min(tried, key=lambda found: float(found.fun)).x)
    return CovarianceModel.from_values([float(f"{number:.3g}") for number in best])


def _along_axes(answers: Answers) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return measured variances (N, 6) and squared errors (N, 6) along axes that calibration keeps.

    In units of radians, and of metres per metre of depth, a calibrated covariance is a multiple of
    the measured one and a multiple of the identity, so that both have the same axes.
    """
    depth = answers.uncertainty.depth.double().numpy()
    units = np.stack([np.ones_like(depth), depth], 1).repeat(3, axis=1)
    measured, axes = np.linalg.eigh(
        answers.uncertainty.covariance.numpy() / (units[:, :, None] * units[:, None])
    )
    components = ((answers.errors / units)[:, None] @ axes)[:, 0]
    return measured, components**2


def unseen_nees(answers: Answers) -> NDArray[np.float64]:
    """Return the NEES (N,) of each scene with the constants fitted to the other scenes."""
    nees = np.empty(len(answers.scenes))
    for scene in np.unique(answers.scenes):
        unseen = answers.scenes == scene
        nees[unseen] = answers[unseen].nees(calibrate(answers[~unseen]))
    return nees


def main() -> None:
    """Localize the queries of all scenes, and print the constants."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    parser.add_argument("--method", default="objconnect")
    parser.add_argument("--start", default="error=3m,5deg", type=parse_start)
    parser.add_argument("--weights", type=Path, help="your own weights")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--out", type=Path, help="file in which the constants are written")
    args = parser.parse_args()
    settings = {} if args.weights is None else {"weights": args.weights}
    cache = args.cache or Path(tempfile.mkdtemp())
    answers = _stack(
        answer
        for scene in args.scenes
        for dataset in open_datasets(scene)
        for answer in _answers(dataset, create(args.method, settings), args.start, cache)
    )
    found, present = calibrate(answers), CovarianceModel.load_beside(args.weights)
    print(found)
    if args.out:
        found.write(args.out, "python -m experiments.covariance")
    _table("found", answers, answers.nees(found))
    _table("of the method", answers, answers.nees(present))
    _table("measured", answers, _nees(answers.errors, answers.uncertainty.covariance.numpy()))
    if len(np.unique(answers.scenes)) > 1:
        _table("found on the other scenes", answers, unseen_nees(answers))


_Answer = tuple[str, str, Estimate, Attempt, Pose]
"""Scene, condition, estimate, the attempt that it comes from, and the true pose."""


def _answers(
    dataset: Dataset, localizer: Localizer, start: Start, cache: Path
) -> Iterator[_Answer]:
    """Yield the accepted poses of a data set's queries that come from an alignment."""
    localizer.prepare(dataset.load_map(), dataset.images, cache)
    load = start.loader(dataset, dataset.load_map(), cache)
    last: list[Attempt] = []

    def measure(attempt: Attempt, _: SearchOptions) -> NDArray[np.float64] | None:
        last[:] = [attempt]
        covariance = (
            None if attempt.uncertainty is None else attempt.uncertainty.covariance[0].numpy()
        )
        if covariance is None or not np.isfinite(covariance).all():
            return None
        return attempt.view.photograph_covariance(covariance)

    with (
        patch.object(attempts, "pose_covariance", measure),
        progress_bar(f"{dataset.name} {localizer.name}", len(dataset.queries)) as advance,
    ):
        for done, query in enumerate(dataset.queries, 1):
            last.clear()
            answer = localizer.localize(load(query))
            if answer.status is Status.OK and answer.covariance is not None and last:
                yield dataset.name, query.condition, answer, last[0], query.reference
            advance(done)


def _stack(answers: Iterable[_Answer]) -> Answers:
    scenes, conditions, errors, uncertainty, fit, false = [], [], [], [], [], []
    for scene, condition, estimate, attempt, truth in answers:
        assert estimate.cam_from_world is not None and attempt.uncertainty is not None
        assert estimate.covariance is not None
        scenes.append(scene)
        conditions.append(condition)
        errors.append((truth @ estimate.cam_from_world.inverse()).log().numpy())
        covariance = torch.from_numpy(estimate.covariance)[None]
        uncertainty.append(replace(attempt.uncertainty, covariance=covariance))
        fit.append(attempt.fit)
        metres, degrees = (float(each) for each in estimate.cam_from_world.error_to(truth))
        false.append(metres > 5 or degrees > 10)
    parts = [
        torch.cat([getattr(each, field.name) for each in uncertainty])
        for field in fields(PoseUncertainty)
    ]
    columns = (np.array(scenes), np.array(conditions), np.array(errors))
    return Answers(*columns, PoseUncertainty(*parts), np.array(fit), np.array(false))


def _table(title: str, answers: Answers, nees: NDArray[np.float64]) -> None:
    """Print the NEES of each condition and of all queries, as Markdown."""
    print(f"\n| {title} | poses | mean NEES | % in the 95 % ellipsoid | false fixes |")
    print("|---|--:|--:|--:|--:|")
    for condition in ["all", *np.unique(answers.conditions)]:
        chosen = (answers.conditions == condition) | (condition == "all")
        values, false = nees[chosen], answers.false[chosen]
        print(
            f"| {condition} | {len(values)} | {values.mean():.1f} | "
            f"{100 * (values <= _CHI2_95).mean():.1f} | {false.sum()} |"
        )


if __name__ == "__main__":
    main()
