"""How exact answers are on earth, and what is said where they contradict the photographs' GPS."""

from __future__ import annotations

import csv
import json
import logging
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objconnect.localization.pipeline.accuracy import combine_accuracies
from objconnect.localization.pipeline.answers import (
    Geography,
    ImageEstimate,
    encode_files,
    output_files,
)
from objconnect.localization.pipeline.disagreement import measure_disagreement, warn_of_disagreement
from objconnect.scene.bundle.georeference import EXACT_GEOREFERENCE as EXACT
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.localizer import Estimate, Prior, Status
from tests.objconnect.localization.pipeline.test_answers import looking

PLACE = Geodetic(47.1, 8.2, 500.0)
GPS = Georeference(horizontal_m=12.0, vertical_m=31.0, source="gps")
LEVEL = Georeference(horizontal_m=12.0, source="stated")
CENTRE = np.array([10.0, 20.0, 30.0])


def row(tmp_path: Path, georeference: Georeference | None) -> dict[str, str]:
    """The row of the table of an answer."""
    files = output_files(tmp_path / "poses.txt", [tmp_path / "poses.geojson"])
    located = [ImageEstimate("a.jpg", looking(30, -60, 4), PLACE)]
    for path, content in encode_files(located, files, Geography(georeference=georeference)):
        path.write_bytes(content)
    (only,) = csv.DictReader((tmp_path / "poses.csv").open(newline=""))
    (feature,) = json.loads((tmp_path / "poses.geojson").read_text())["features"]
    for name in ("eph_m", "epv_m"):
        assert str(feature["properties"].get(name, "")) == only[name]
    assert feature["properties"]["sigma_m"] == pytest.approx(float(only["sigma_m"]))
    return only


def test_both_accuracies_are_written(tmp_path: Path) -> None:
    """Within the map 2 cm, on earth 12 m and 31 m."""
    exact, placed = row(tmp_path, EXACT), row(tmp_path, GPS)
    assert exact["sigma_m"] == placed["sigma_m"], "that within the map"
    assert exact["covariance"] == placed["covariance"], "that within the map"
    within = np.array(placed["covariance"].split(), float).reshape(6, 6)
    eph, epv = math.sqrt(within[0, 0] + within[1, 1]), math.sqrt(within[2, 2])
    assert float(exact["eph_m"]) == pytest.approx(eph, rel=1e-2)
    assert float(exact["epv_m"]) == pytest.approx(epv, rel=1e-2)
    assert float(exact["sigma_m"]) == pytest.approx(math.hypot(eph, epv), rel=1e-2)
    assert float(placed["eph_m"]) == pytest.approx(math.hypot(12, eph), abs=1e-4)
    assert float(placed["epv_m"]) == pytest.approx(math.hypot(31, epv), abs=1e-4)


def test_where_the_place_on_earth_is_unknown_so_is_the_accuracy(tmp_path: Path) -> None:
    unknown, level = row(tmp_path, None), row(tmp_path, LEVEL)
    assert unknown["sigma_m"] and unknown["covariance"]
    assert unknown["eph_m"] == unknown["epv_m"] == ""
    assert float(level["eph_m"]) == pytest.approx(12, abs=1e-2)
    assert level["epv_m"] == ""
    found = ImageEstimate("a.jpg", looking(30, -60, 4), PLACE)
    assert found.accuracy(Geography(georeference=LEVEL)).covariance is None
    assert combine_accuracies(None, GPS).eph_m is None, "an answer without covariance"


@given(
    st.lists(st.floats(-10, 10), min_size=36, max_size=36),
    st.floats(0, 100),
    st.none() | st.floats(0, 100),
)
def test_variances_add_up(numbers: list[float], across: float, up: float | None) -> None:
    """Drawn as sums of independent errors, whose variances are those of a textbook."""
    root = np.array(numbers).reshape(6, 6)
    within = root @ root.T
    placed = Georeference(horizontal_m=across, vertical_m=up, source="stated")
    accuracy = combine_accuracies(within, placed)
    assert accuracy.eph_m is not None
    assert accuracy.eph_m**2 == pytest.approx(within[0, 0] + within[1, 1] + across**2)
    assert (accuracy.epv_m is None) == (accuracy.covariance is None) == (up is None)
    if accuracy.covariance is not None and up is not None:
        assert accuracy.covariance[2, 2] == pytest.approx(within[2, 2] + up**2)
        assert np.trace(accuracy.covariance[:2, :2]) == pytest.approx(accuracy.eph_m**2)
        assert np.linalg.eigvalsh(accuracy.covariance).min() >= -1e-6


def fly(
    offset: tuple[float, float, float], sigma: tuple[float, float, float], count: int = 7
) -> list[ImageEstimate]:
    """Answers, with positions that are wrong by an offset and by decimetres of their own."""
    rng = np.random.default_rng(3)
    return [
        ImageEstimate(
            f"{k}.jpg",
            looking(30, -60, 4),
            PLACE,
            gps=Prior(CENTRE - offset + rng.normal(0, 0.1, 3), np.array(sigma)),
        )
        for k in range(count)
    ]


def read_warning(
    caplog: pytest.LogCaptureFixture,
    located: list[ImageEstimate],
    georeference: Georeference | None,
) -> str:
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        warn_of_disagreement(located, Geography(georeference=georeference))
    return "\n".join(record.getMessage() for record in caplog.records)


def test_one_line_where_gps_and_answers_contradict(caplog: pytest.LogCaptureFixture) -> None:
    located = fly((90, -66, 1), (10, 10, 10))
    line = read_warning(caplog, located, None)
    assert "\n" not in line
    assert "111.6 m beside the GPS positions" in line and "median of 7" in line
    assert read_warning(caplog, located, EXACT) == line
    # A map that is known to 60 m on earth explains it.
    coarse = Georeference(horizontal_m=60.0, vertical_m=60.0, source="gps")
    assert read_warning(caplog, located, coarse) == ""


def test_heights_of_another_reference_are_told(caplog: pytest.LogCaptureFixture) -> None:
    line = read_warning(caplog, fly((1, 1, 47), (3, 3, 5)), EXACT)
    assert "47.0 m above the GPS positions" in line and "sea or ellipsoid" in line
    assert "beside" not in line
    assert "47.0 m below" in read_warning(caplog, fly((1, 1, -47), (3, 3, 5)), EXACT)
    assert read_warning(caplog, fly((1, 1, 47), (3, 3, np.inf)), EXACT) == "", (
        "no height was measured"
    )


def test_heights_that_scatter_are_not_said_to_agree(caplog: pytest.LogCaptureFixture) -> None:
    """Half of them are 40 m too high and half too low: the median is near 0."""
    located = [*fly((0, 0, 40), (3, 3, 5)), *fly((0, 0, -40), (3, 3, 5), 6)]
    found = measure_disagreement(located, Geography(georeference=EXACT))
    assert (
        found is not None
        and found.is_far_vertically
        and found.height_error_m == pytest.approx(40, abs=0.2)
    )
    mixed = [*located[:6], *located[7:], *fly((0, 0, 0.1), (3, 3, 5), 1)]
    assert "40.0 m above or below the GPS positions" in read_warning(caplog, mixed, EXACT)


def test_what_the_sigmas_explain_is_not_told(caplog: pytest.LogCaptureFixture) -> None:
    for offset, sigma, count in [
        ((12, 0, 0), (10, 10, 10), 7),
        ((90, -66, 1), (np.inf, np.inf, np.inf), 7),
        ((90, -66, 1), (10, 10, 10), 4),
    ]:
        assert read_warning(caplog, fly(offset, sigma, count), EXACT) == ""
    # Up to half of the fixes may be wrong.
    mostly = [*fly((1, 0, 0), (3, 3, 3), 7), *fly((900, 0, 0), (3, 3, 3), 6)]
    assert read_warning(caplog, mostly, EXACT) == ""
    assert "m beside" in read_warning(caplog, [*mostly, *fly((900, 0, 0), (3, 3, 3), 3)], EXACT)


def test_a_map_without_a_known_place_on_earth_says_how_far_gps_is(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Caliterra: 12 m from the GPS at sigmas of centimetres, which are those within the map."""
    line = read_warning(caplog, fly((12, 0, 0), (10, 10, 10)), None)
    assert "\n" not in line
    assert "12.0 m beside the GPS positions" in line and "sigma_m is relative to the map" in line
    assert read_warning(caplog, fly((0, 0, 0), (10, 10, 10)), None) == ""
    assert read_warning(caplog, fly((12, 0, 0), (np.inf, np.inf, np.inf)), None) == ""
    assert read_warning(caplog, fly((12, 0, 0), (10, 10, 10), 4), None) == ""


def test_photographs_without_answer_or_position_do_not_count() -> None:
    located = fly((90, -66, 1), (10, 10, 10))
    lost = ImageEstimate("l.jpg", Estimate(Status.FAILED), None, gps=located[0].gps)
    without = ImageEstimate("w.jpg", looking(30, -60, 4), PLACE)
    found = measure_disagreement([*located, lost, without], Geography())
    assert found is not None and found.photographs == 7
    assert measure_disagreement([lost, without], Geography()) is None
