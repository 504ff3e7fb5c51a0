"""From observations to verdicts, weak stretches and requests for photographs."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmark.forecasting.config import ForecastConfig
from benchmark.forecasting.observe import _count_visible
from benchmark.forecasting.outlook import geojson
from benchmark.forecasting.report import Forecast, find_runs, verdict_of
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic
from objconnect.scene.localizer import Status
from tests.benchmark.forecasting.made_forecast import CENTRES, ORIGIN, observation, report


def test_runs_are_the_spans_of_true_values() -> None:
    assert find_runs([True, True, False, True, False, False]) == [(0, 1), (3, 3)]
    assert find_runs([False]) == []
    assert find_runs([True]) == [(0, 0)]


def test_the_verdict_depends_on_share_and_gap() -> None:
    config = ForecastConfig(weak=0.5, gap_m=100)
    assert verdict_of(0.4, 0.0, config) == "fails"
    assert verdict_of(0.9, 100.0, config) == "holds"
    assert verdict_of(0.9, 101.0, config) == "gaps"


@pytest.mark.parametrize(
    ("more", "fix", "false"),
    [
        ({}, True, False),
        ({"t_err_m": 0.5}, False, False),
        ({"r_err_deg": 5.0}, False, False),
        ({"status": Status.FALLBACK}, False, False),
        ({"t_err_m": 5.1}, False, True),
        ({"t_err_m": 5.1, "status": Status.FALLBACK}, False, False),
        ({"t_err_m": None, "r_err_deg": None, "status": Status.FAILED}, False, False),
    ],
)
def test_fixes_and_false_fixes(more: dict[str, object], fix: bool, false: bool) -> None:
    seen = observation("summer-noon", 0, **more)
    assert (seen.is_fix(0.5, 5.0), seen.is_false) == (fix, false)


def test_the_made_flight_holds_in_summer_and_fails_in_snow() -> None:
    made = report()
    summer, snow = made.seasons
    assert (summer.verdict, snow.verdict) == ("holds", "fails")
    assert summer.stretches == () and summer.longest_gap_m == 30.0
    (weak,) = snow.stretches
    assert (weak.first, weak.last) == (3, 5)
    assert weak.gap_m == 90.0, "from waypoint 2 to the end"
    causes = [w.seasons["snow-dusk"].cause for w in made.waypoints]
    assert causes == [None, None, "few points", "few points", "appearance"]
    assert weak.cause == "few points"
    assert snow.sigma_across_m == pytest.approx(0.2)
    assert summer.false_risk < snow.false_risk


def test_photographs_are_wanted_where_points_are_few_and_nowhere_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (request,) = report().photographs
    assert (request.first, request.last) == (3, 4)
    assert request.points == pytest.approx(2.5, abs=0.1)
    monkeypatch.setattr("benchmark.forecasting.report.FEW_POINTS", 2)
    assert report().photographs == ()


def test_views_and_fixes_are_counted() -> None:
    outlook = report().waypoints[2].seasons
    assert (outlook["summer-noon"].found, outlook["summer-noon"].views) == (2, 2)
    assert (outlook["snow-dusk"].found, outlook["snow-dusk"].views) == (0, 2)


def test_geojson_has_longitude_first_and_says_why() -> None:
    made = report()
    features = geojson(made.waypoints, made.seasons)["features"]
    assert isinstance(features, list)
    points = [f for f in features if f["geometry"]["type"] == "Point"]
    lines = [f for f in features if f["geometry"]["type"] == "LineString"]
    assert (len(points), len(lines)) == (5, 1)
    for point, centre in zip(points, CENTRES, strict=True):
        longitude, latitude, altitude = point["geometry"]["coordinates"]
        assert 7.9 < longitude < 8.1
        back = enu_from_geodetic(Geodetic(latitude, longitude, altitude), ORIGIN)
        np.testing.assert_allclose(back, centre, atol=0.01)
    assert points[4]["properties"]["snow-dusk cause"] == "appearance"
    assert 0 < points[0]["properties"]["summer-noon probability"] < 1
    assert lines[0]["properties"]["season"] == "snow-dusk"
    assert len(lines[0]["geometry"]["coordinates"]) == 4, "with the last likely fix before it"


def test_the_report_reads_itself() -> None:
    made = report()
    assert Forecast.model_validate_json(made.model_dump_json()) == made
    text = made.text()
    assert "snow-dusk: too few fixes to navigate by" in text
    assert "photograph waypoints 3 to 4" in text


def test_sigmas_are_named_as_those_within_the_map() -> None:
    """``eph_m`` and ``epv_m`` are names of accuracies on earth, which a forecast does not know."""
    made = report()
    assert "horizontal sigma 0.20 m within the map" in made.text()
    words = made.model_dump_json() + json.dumps(geojson(made.waypoints, made.seasons))
    assert "eph" not in words
    assert "epv" not in words


def test_points_behind_the_surface_are_not_in_view() -> None:
    depth = np.full((10, 20), 50.0, np.float32)
    depth[:, 10:] = 0.0  # the sky hides nothing
    xy = np.array([[5.5, 5.5], [5.5, 5.5], [15.0, 5.0], [25.0, 5.0], [5.0, -1.0], [5.0, 5.0]])
    point_depth = np.array([50.0, 60.0, 60.0, 50.0, 50.0, 50.0])
    valid = np.array([True, True, True, True, True, False])
    assert _count_visible(xy, valid, point_depth, depth) == 2
