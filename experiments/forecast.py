"""Accuracy of forecasts: probabilities from a town's summer twin against its true winter.

    python -m experiments.forecast plan PLAN              # the mission plan that is flown
    python -m experiments.forecast fit FOLDER...          # weights, from training towns
    python -m experiments.forecast measure FOLDER... --base RATE [--out JPG]

Each FOLDER holds ``forecast.json`` of a town, and ``truth.json``: results that ``evaluate`` wrote
of the same plan flown in the town's true seasons. ``docs/evidence/site.md`` has the commands.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmark.forecasting.calibration import (
    UNCALIBRATED,
    Calibration,
    calibration_of,
    features,
    fit,
    probability,
)
from benchmark.forecasting.observe import Observation
from benchmark.forecasting.outlook import evidence_by_season
from benchmark.forecasting.report import Forecast
from benchmark.results.query_result import QueryResult
from benchmark.results.results_files import load
from benchmark.scoring.intervals import wilson
from benchmark.scoring.score import Threshold, is_correct, is_false_fix
from objconnect.scene.bundle.manifest import read_json

Array = NDArray[np.float64]
_BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
# Number of resamples of an interval.
_RESAMPLES = 2000


def write_plan(path: Path, per_line: int) -> None:
    """Write a plan of four lines of ``per_line`` waypoints over 132 m around 47 N, 8 E.

    The lines lie 70, 45, 60 and 75 m above home; on the last two, the gimbal is at -65 degrees.
    """
    # MAVLink: command 1000 sets pitch and yaw of the gimbal (frame 2: mission), 16 is a waypoint
    # (frame 3: height above home).
    items: list[dict[str, object]] = []

    def add(command: int, params: list[float | None], frame: int) -> None:
        item = {"command": command, "doJumpId": len(items) + 1, "frame": frame, "params": params}
        items.append({"type": "SimpleItem", "autoContinue": True, **item})

    # Metres in a degree of longitude and of latitude at 47 degrees north.
    east, north = 111320 * np.cos(np.radians(47.0)) * 1.0027, 111180.0
    for line, (north_m, height_m) in enumerate(
        zip((-66, -22, 22, 66), (70, 45, 60, 75), strict=True)
    ):
        if line in (0, 2):
            add(1000, [-90 if line == 0 else -65, 0, 0, 0, 0, 0, 0], 2)
        for x in np.linspace(-66, 66, per_line) * (1 if line % 2 == 0 else -1):
            add(16, [0, 0, 0, None, 47.0 + north_m / north, 8.0 + x / east, height_m], 3)
    mission = {"hoverSpeed": 6, "items": items, "plannedHomePosition": [47.0, 8.0, 450.0]}
    plan = {"fileType": "Plan", "version": 1, "mission": mission}
    path.write_text(json.dumps(plan, indent=1))


class Town(NamedTuple):
    """The forecast of a town and the true outcome, one row for each true query.

    Attributes:
        name: name of the town's scene.
        method: name of the method.
        season: condition of each query.
        rows: features (M, 4) of the calibration.
        raw: whether the first view of the waypoint was found, (M,).
        chance: calibrated probability, (M,).
        plain: probability without a calibration, (M,).
        happened: whether the query was a fix, (M,).
        false: whether the query was a false fix, (M,).
        ratios: error of true fixes over their predicted standard deviation, (K,).
    """

    name: str
    method: str
    season: list[str]
    rows: Array
    raw: Array
    chance: Array
    plain: Array
    happened: NDArray[np.bool_]
    false: NDArray[np.bool_]
    ratios: Array


def read(folder: Path) -> Town:
    """Read the forecast and the truth of a town."""
    forecast = read_json(folder / "forecast.json", Forecast, "forecast")
    truth = load(folder / "truth.json")
    config, method = forecast.config, forecast.method.name
    assert truth.method.name == method
    observations = [Observation.model_validate(view) for view in forecast.views]
    centres = np.array([waypoint.enu_m for waypoint in forecast.waypoints])
    evidence = evidence_by_season(observations, centres, config)
    calibration = calibration_of(method)
    threshold = Threshold(config.fix_m, config.fix_deg)
    found = {(o.season, o.waypoint): o for o in reversed(observations)}
    queries = [query for query in truth.queries if query.condition in config.seasons]
    keys = [(query.condition, int(Path(query.name).stem)) for query in queries]

    def take_queries(values: dict[str, Array]) -> Array:
        return np.array([values[season][k] for season, k in keys])

    def chances(model: Calibration) -> Array:
        return take_queries(
            {name: probability(observed, model) for name, observed in evidence.items()}
        )

    return Town(
        name=forecast.scene,
        method=method,
        season=[season for season, _ in keys],
        rows=take_queries({name: features(observed) for name, observed in evidence.items()}),
        raw=np.array([found[key].is_fix(config.fix_m, config.fix_deg) for key in keys], float),
        chance=chances(calibration),
        plain=chances(UNCALIBRATED),
        happened=np.array([is_correct(query, threshold) for query in queries]),
        false=np.array([is_false_fix(query) for query in queries]),
        ratios=_ratios([query for query in queries if is_correct(query, threshold)]),
    )


def _ratios(queries: Sequence[QueryResult]) -> Array:
    """Return the error of true fixes over their predicted standard deviation, (K,)."""
    pairs = [q.t_err_m / q.sigma_t_m for q in queries if q.t_err_m is not None and q.sigma_t_m]
    return np.array(pairs)


def fit_all(towns: Sequence[Town]) -> Calibration:
    """Fit the calibration of a method to training towns."""
    happened = np.concatenate([town.happened for town in towns])
    ratios = np.concatenate([town.ratios for town in towns])
    # The median of the norm of three normal errors, over the root of the sum of their variances.
    scale = round(float(np.median(ratios) / 0.888), 3) if len(ratios) else 1.0
    false = np.concatenate([town.false for town in towns])
    return Calibration(
        weights=fit(np.concatenate([town.rows for town in towns]), happened),
        across_scale=scale,
        up_scale=scale,
        false_share=round((false.sum() + 0.5) / (len(false) + 1), 4),
        queries=len(happened),
        source=", ".join(town.name for town in towns),
    )


def brier(chance: Array, happened: NDArray[np.bool_]) -> float:
    """Return the Brier score: the mean squared error of a probability."""
    return float(np.square(chance - happened).mean())


def measure(towns: Sequence[Town], base: float, out: Path | None) -> None:
    """Print Brier scores and the reliability of the forecasts of towns."""
    happened = np.concatenate([town.happened for town in towns])
    columns = {
        "forecast": np.concatenate([town.chance for town in towns]),
        "smoothed share, not calibrated": np.concatenate([town.plain for town in towns]),
        "one rendered view, 0 or 1": np.concatenate([town.raw for town in towns]),
        "base rate of the training towns": np.full(len(happened), base),
        "base rate of these queries": np.full(len(happened), happened.mean()),
    }
    print(f"{len(happened)} queries, {happened.sum()} fixes")
    for name, chance in columns.items():
        low, high = _interval(chance, happened)
        print(f"{name}: Brier {brier(chance, happened):.3f} [{low:.3f}, {high:.3f}]")
    for town in towns:
        outcomes = town.happened
        base_rate = outcomes.mean() * (1 - outcomes.mean())
        print(f"{town.name}: Brier {brier(town.chance, outcomes):.3f}, base rate {base_rate:.3f}")
    season = np.concatenate([town.season for town in towns])
    for name in dict.fromkeys(season.tolist()):
        mask = season == name
        chance, outcomes = columns["forecast"][mask], happened[mask]
        print(
            f"{name}: {mask.sum()} queries, forecast {100 * chance.mean():.0f} %, happened "
            f"{100 * outcomes.mean():.0f} %, Brier {brier(chance, outcomes):.3f}, its own base "
            f"rate {outcomes.mean() * (1 - outcomes.mean()):.3f}"
        )
    _reliability(columns["forecast"], happened, out)


def _interval(chance: Array, happened: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the 95 % interval of a Brier score, by resampling queries."""
    rng = np.random.default_rng(0)
    square = np.square(chance - happened)
    means = [rng.choice(square, len(square)).mean() for _ in range(_RESAMPLES)]
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def _reliability(chance: Array, happened: NDArray[np.bool_], out: Path | None) -> None:
    points = []
    for low, high in pairwise(_BINS):
        mask = (chance >= low) & ((chance < high) | (high == 1.0))
        if mask.any():
            points.append((chance[mask].mean(), happened[mask].mean(), int(mask.sum())))
            print(
                f"forecast {low:.1f} to {high:.1f}: {mask.sum()} queries, mean forecast "
                f"{chance[mask].mean():.2f}, happened {happened[mask].mean():.2f}"
            )
    if out is None:
        return
    figure = Figure(figsize=(5, 5), layout="constrained")
    ax = figure.subplots()
    ax.plot([0, 1], [0, 1], color="0.6", linestyle="--", linewidth=1)
    x, y, _ = (np.array(column, float) for column in zip(*points, strict=True))
    ends = np.array([wilson(round(b * n), n) for _, b, n in points]).T
    spread = np.maximum(np.stack([y - ends[0], ends[1] - y]), 0)
    ax.errorbar(x, y, spread, fmt="o-", color="#1f6fb4", capsize=3)
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
    for a, b, n in points:
        # Above the points in the lower half, below the others: not over the axes.
        offset = (7, 6 if b < 0.5 else -12)
        ax.annotate(f"{n}", (a, b), offset, textcoords="offset points", fontsize=9, bbox=behind)
    ax.set(xlabel="forecast probability of a fix", ylabel="share of true fixes")
    ax.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
    figure.savefig(out, dpi=110)


def main() -> None:
    """Write the plan, fit, or measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("plan", "fit", "measure"))
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--each", type=int, default=5, help="waypoints in a line of the plan")
    parser.add_argument("--base", type=float, default=0.5)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.what == "plan":
        write_plan(args.folders[0], args.each)
        return
    towns = [read(folder) for folder in args.folders]
    if args.what == "fit":
        calibration = fit_all(towns)
        print(json.dumps({towns[0].method: calibration.model_dump(mode="json")}, indent=1))
        happened = np.concatenate([town.happened for town in towns])
        print(f"base rate {happened.mean():.4f}")
    else:
        measure(towns, args.base, args.out)


if __name__ == "__main__":
    main()
