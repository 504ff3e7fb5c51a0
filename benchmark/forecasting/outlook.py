"""Forecasts of waypoints and seasons, and GeoJSON, from the localization of rendered views."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray

from benchmark.forecasting.calibration import (
    Calibration,
    Evidence,
    ViewResult,
    false_risk,
    pool,
    probability,
)
from benchmark.forecasting.config import ForecastConfig
from benchmark.forecasting.observe import Observation
from benchmark.forecasting.report import (
    FEW_POINTS,
    Outlook,
    Season,
    Waypoint,
    verdict_of,
    weak_stretches,
)
from objconnect.scene.geometry.geodesy import Geodetic, geodetic_from_enu

Array = NDArray[np.float64]


def evidence_by_season(
    observations: Sequence[Observation], centres: Array, config: ForecastConfig
) -> dict[str, Evidence]:
    """Return the pooled evidence at all waypoints, by season."""
    return {
        season: pool([_summarize(o, config) for o in observations if o.season == season], centres)
        for season in config.seasons
    }


def waypoints_of(
    observations: Sequence[Observation],
    centres: Array,
    origin: Geodetic,
    config: ForecastConfig,
    calibration: Calibration,
) -> tuple[Waypoint, ...]:
    """Return every waypoint with its forecast (``Outlook``) in every season.

    Args:
        observations: answers to all views.
        centres: positions of the waypoints (N, 3), world metres.
        origin: geodetic coordinates of the world's origin.
        config: options of the forecast.
        calibration: calibration of the method.
    """
    evidence = evidence_by_season(observations, centres, config)
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(steps)])
    by_waypoint: dict[int, list[Observation]] = {k: [] for k in range(len(centres))}
    for observation in observations:
        by_waypoint[observation.waypoint].append(observation)
    points = [
        float(np.expm1(np.mean(np.log1p([o.points for o in by_waypoint[k]]))))
        for k in range(len(centres))
    ]
    outlooks = {
        season: _outlooks(evidence[season], calibration, points, config)
        for season in config.seasons
    }
    waypoints = []
    for k, centre in enumerate(centres):
        position = geodetic_from_enu(centre, origin)
        seasons = {}
        for season in config.seasons:
            views = [o for o in by_waypoint[k] if o.season == season]
            fixes = sum(o.is_fix(config.fix_m, config.fix_deg) for o in views)
            counts = {"found": fixes, "views": len(views)}
            seasons[season] = outlooks[season][k].model_copy(update=counts)
        east, north, up = (round(float(value), 3) for value in centre)
        waypoints.append(
            Waypoint(
                number=k + 1,
                enu_m=(east, north, up),
                longitude=round(position.longitude, 8),
                latitude=round(position.latitude, 8),
                altitude_m=round(position.altitude, 3),
                along_m=round(float(along_m[k]), 2),
                points=round(points[k], 1),
                seasons=seasons,
            )
        )
    return tuple(waypoints)


def seasons_of(waypoints: Sequence[Waypoint], config: ForecastConfig) -> tuple[Season, ...]:
    """Return the verdict of every season."""
    return tuple(_season(waypoints, name, config) for name in config.seasons)


def _season(waypoints: Sequence[Waypoint], name: str, config: ForecastConfig) -> Season:
    outlooks = [waypoint.seasons[name] for waypoint in waypoints]
    probabilities = [outlook.probability for outlook in outlooks]
    share = sum(probabilities) / len(probabilities)
    stretches = weak_stretches(waypoints, name, config)
    gap_m = max((stretch.gap_m for stretch in stretches), default=_longest_leg(waypoints))
    return Season(
        name=name,
        verdict=verdict_of(share, gap_m if stretches else 0.0, config),
        share=round(share, 4),
        lowest=min(probabilities),
        longest_gap_m=round(gap_m, 1),
        false_risk=round(sum(o.false_risk for o in outlooks) / len(outlooks), 4),
        sigma_across_m=_median(o.sigma_across_m for o in outlooks),
        sigma_up_m=_median(o.sigma_up_m for o in outlooks),
        stretches=stretches,
    )


def _longest_leg(waypoints: Sequence[Waypoint]) -> float:
    """Return the longest distance between successive waypoints, metres."""
    along_m = [waypoint.along_m for waypoint in waypoints]
    return max((b - a for a, b in pairwise(along_m)), default=0.0)


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(median(known), 4) if known else None


def _outlooks(
    evidence: Evidence, calibration: Calibration, points: Sequence[float], config: ForecastConfig
) -> list[Outlook]:
    """Return the outlooks of all waypoints in a season; the caller adds the counts of views."""
    probabilities = probability(evidence, calibration)
    risks = false_risk(evidence, calibration)
    outlooks = []
    for k, fix_probability in enumerate(probabilities.tolist()):
        cause = None
        if fix_probability < config.weak:
            cause = "few points" if points[k] < FEW_POINTS else "appearance"
        outlooks.append(
            Outlook.model_validate(
                {
                    "probability": round(fix_probability, 4),
                    "false_risk": round(float(risks[k]), 4),
                    "sigma_across_m": _scale(evidence.sigma_across_m[k], calibration.across_scale),
                    "sigma_up_m": _scale(evidence.sigma_up_m[k], calibration.up_scale),
                    "found": 0,
                    "views": 0,
                    "cause": cause,
                }
            )
        )
    return outlooks


def _scale(sigma: float, scale: float) -> float | None:
    return round(float(sigma) * scale, 4) if np.isfinite(sigma) else None


def _summarize(observation: Observation, config: ForecastConfig) -> ViewResult:
    nan = float("nan")
    return ViewResult(
        observation.waypoint,
        observation.is_fix(config.fix_m, config.fix_deg),
        observation.is_false,
        observation.inliers,
        observation.points,
        nan if observation.sigma_across_m is None else observation.sigma_across_m,
        nan if observation.sigma_up_m is None else observation.sigma_up_m,
    )


def geojson(waypoints: Sequence[Waypoint], seasons: Sequence[Season]) -> Mapping[str, object]:
    """Return waypoints as points and weak stretches as lines (RFC 7946: longitude, latitude)."""
    features: list[dict[str, object]] = []
    for waypoint in waypoints:
        properties: dict[str, object] = {
            "kind": "waypoint",
            "number": waypoint.number,
            "points": waypoint.points,
        }
        for name, outlook in waypoint.seasons.items():
            properties |= {f"{name} {key}": value for key, value in outlook.model_dump().items()}
        features.append(_feature("Point", _position(waypoint), properties))
    for season in seasons:
        for stretch in season.stretches:
            part = waypoints[max(stretch.first - 2, 0) : stretch.last + 1]
            line = [_position(waypoint) for waypoint in part]
            properties = {"kind": "weak stretch", "season": season.name, **stretch.model_dump()}
            if len(line) > 1:
                features.append(_feature("LineString", line, properties))
    return {"type": "FeatureCollection", "name": "objconnect forecast", "features": features}


def _position(waypoint: Waypoint) -> list[float]:
    return [waypoint.longitude, waypoint.latitude, waypoint.altitude_m]


def _feature(kind: str, coordinates: object, properties: Mapping[str, object]) -> dict[str, object]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": dict(properties)}
