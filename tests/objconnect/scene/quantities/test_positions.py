"""Position and altitude of photographs from EXIF and XMP, which may contradict each other."""

from __future__ import annotations

import math
from typing import Any

import pytest

from objconnect.scene.quantities.altitudes import read_altitude
from objconnect.scene.quantities.positions import read_position

GPS = {
    "GPSLatitude": (46, 50, 33.36),
    "GPSLatitudeRef": "N",
    "GPSLongitude": (91, 59, 39.84),
    "GPSLongitudeRef": "W",
}
DJI = {"GpsLatitude": "46.8426", "GpsLongitude": "-91.9944"}
ADOBE = {"GPSLatitude": "46,50.556N", "GPSLongitude": "91,59.664W"}
TRUE = pytest.approx((46.8426, -91.9944), abs=1e-6)


def without(*names: str, **others: object) -> dict[str, Any]:
    return {name: value for name, value in GPS.items() if name not in names} | others


@pytest.mark.parametrize(
    "xmp",
    [
        DJI,
        ADOBE,
        {"GpsLatitude": "+46.8426", "GpsLongtitude": "-91.9944"},
        {"Latitude": "46.8426", "Longitude": "-91.9944"},
        DJI | ADOBE,
    ],
)
@pytest.mark.parametrize(
    "gps",
    [
        {},
        without("GPSLongitudeRef"),
        without("GPSLatitudeRef", "GPSLongitudeRef"),
        without(GPSLongitudeRef="N"),
        without(GPSLongitude=(-91, 59, 39.84)),
        without(GPSLatitude=(math.nan,) * 3, GPSLongitude=(math.nan,) * 3),
        without(GPSLatitude=(0, 0, 0), GPSLongitude=(0, 0, 0)),
        without("GPSLatitude"),
        GPS,
    ],
)
def test_xmp_tells_what_exif_does_not(gps: dict[str, object], xmp: dict[str, str]) -> None:
    assert read_position(gps, xmp).value == TRUE


@pytest.mark.parametrize(
    ("gps", "xmp", "field"),
    [
        (without("GPSLongitudeRef"), {}, "GPSLongitudeRef"),
        (without("GPSLatitudeRef"), {}, "GPSLatitudeRef"),
        (GPS, DJI | {"GpsLongitude": "91.9944"}, "contradict"),
        (GPS, DJI | {"GpsLatitude": "46.8526"}, "contradict"),
        (without("GPSLongitudeRef"), DJI | {"GpsLatitude": "12.0"}, "GPSLongitudeRef"),
        ({}, DJI | {"GPSLatitude": "46,50.556S", "GPSLongitude": "91,59.664W"}, "contradict"),
        ({}, {"GPSLatitude": "46.8426", "GPSLongitude": "91.9944"}, "hemisphere"),
        ({}, {"GpsLatitude": "46.8426"}, "GpsLongitude is missing"),
        (without(GPSMapDatum="TOKYO"), {}, "GPSMapDatum"),
        ({}, {"GpsLatitude": "0.0", "GpsLongitude": "0.0"}, "without a fix"),
    ],
)
def test_what_is_no_position_says_why(
    gps: dict[str, object], xmp: dict[str, str], field: str
) -> None:
    read = read_position(gps, xmp)
    assert not read.is_known
    assert field in read.why


def test_no_gps_is_no_doubt() -> None:
    read = read_position({}, {})
    assert (read.value, read.doubts) == (None, ())


@pytest.mark.parametrize(
    ("reference", "metres"),
    [
        *((b"\0", 198.6), (b"\1", -198.6), (b"\2", 198.6), (b"\3", -198.6)),
        *((0, 198.6), (1, -198.6), ("0", 198.6), (b"1", -198.6), ("3\0", -198.6)),
        (None, 198.6),
    ],
)
def test_every_reference_of_an_altitude(reference: object, metres: float) -> None:
    gps = {"GPSAltitude": 198.6} | ({} if reference is None else {"GPSAltitudeRef": reference})
    read = read_altitude(gps, {})
    assert read.value == metres
    # What a default or the sea decides is said.
    plain = reference in (0, 1, b"\0", b"\1", "0", b"1")
    assert plain == (not read.doubts)
    assert plain or "GPSAltitudeRef" in read.why


@pytest.mark.parametrize(
    ("gps", "xmp", "field"),
    [
        ({}, {}, "GPSAltitude is missing"),
        ({}, {"RelativeAltitude": "+40.1"}, "RelativeAltitude is above the take-off"),
        ({"GPSAltitude": math.nan, "GPSAltitudeRef": b"\0"}, {}, "GPSAltitude"),
        ({"GPSAltitude": 20.0, "GPSAltitudeRef": b"\7"}, {}, "GPSAltitudeRef"),
        ({"GPSAltitude": 20.0, "GPSAltitudeRef": "sea"}, {}, "GPSAltitudeRef"),
        ({"GPSAltitude": -20.0, "GPSAltitudeRef": b"\1"}, {}, "GPSAltitudeRef"),
        ({"GPSAltitude": 2e6, "GPSAltitudeRef": b"\0"}, {}, "GPSAltitude"),
        (
            {"GPSAltitude": 20.0, "GPSAltitudeRef": b"\0"},
            {"AbsoluteAltitude": "+900"},
            "contradicts",
        ),
        ({}, {"AbsoluteAltitude": "high"}, "AbsoluteAltitude"),
        ({}, {"GPSAltitude": "20/0"}, "GPSAltitude"),
    ],
)
def test_what_is_no_altitude_says_why(
    gps: dict[str, object], xmp: dict[str, str], field: str
) -> None:
    read = read_altitude(gps, xmp)
    assert not read.is_known
    assert field in read.why


@pytest.mark.parametrize(
    ("gps", "xmp", "metres"),
    [
        ({}, {"AbsoluteAltitude": "+198.6"}, 198.6),
        ({}, {"AbsoluteAltitude": "198,6"}, 198.6),
        ({}, {"GPSAltitude": "1986/10", "GPSAltitudeRef": "0"}, 198.6),
        ({"GPSAltitude": math.nan}, {"AbsoluteAltitude": "-3.5"}, -3.5),
        ({"GPSAltitude": 3.5}, {"AbsoluteAltitude": "-3.5"}, -3.5),
        ({"GPSAltitude": -3.5, "GPSAltitudeRef": b"\0"}, {}, -3.5),
        ({"GPSAltitude": 198.6, "GPSAltitudeRef": b"\0"}, {"AbsoluteAltitude": "+200.1"}, 198.6),
    ],
)
def test_altitudes(gps: dict[str, object], xmp: dict[str, str], metres: float) -> None:
    assert read_altitude(gps, xmp).value == metres
