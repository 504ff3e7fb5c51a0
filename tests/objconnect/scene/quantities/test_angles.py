"""Latitudes and longitudes in every spelling that photographs have."""

from __future__ import annotations

import math

import pytest

from objconnect.scene.quantities.angles import (
    LATITUDE,
    LONGITUDE,
    parse_coordinate,
    read_coordinate,
    read_hemisphere,
)

NAN = math.nan


@pytest.mark.parametrize(
    "said",
    ["w", "W", "West", "west", "WEST", "W ", " w", "W\0", "W\0\0", b"W\0", b"west", "western"],
)
def test_the_west_in_all_spellings(said: object) -> None:
    assert read_hemisphere(said, LONGITUDE).value == -1


@pytest.mark.parametrize("said", ["N", "n", "O", "Ouest", "", "\0", "WE", "-", 87, b"\x01"])
def test_what_is_no_hemisphere_of_a_longitude(said: object) -> None:
    read = read_hemisphere(said, LONGITUDE)
    assert not read.is_known
    assert "GPSLongitudeRef" in read.why


@pytest.mark.parametrize(
    "value",
    [
        (46, 50, 33.36),
        (46, 50.556, 0),
        (46, 50.556, NAN),
        (46, 50.556),
        (46.8426, 0, 0),
        (46.8426, NAN, NAN),
        (46.8426,),
        46.8426,
        "46.8426",
        "46,50,33.36",
        "46 50 33.36",
        "46/1,50/1,3336/100",
        "46° 50' 33.36\"",
        b"46.8426\0",
    ],
)
def test_degrees_in_all_forms(value: object) -> None:
    assert read_coordinate(value, "S", LATITUDE).value == pytest.approx(-46.8426, abs=1e-9)


@pytest.mark.parametrize("value", [(46, 59, 60), (46, 60, 0), (47, 0, 0)])
def test_sixty_of_a_part_is_one_of_the_part_before(value: object) -> None:
    """Programs that round 59.99999 write it."""
    assert read_coordinate(value, "N", LATITUDE).value == pytest.approx(47, abs=1e-12)


@pytest.mark.parametrize(
    "value",
    [
        (46, 61, 0),
        (46, 50, 60.01),
        (46, -50, 0),
        (-46, 50, 33.36),
        (46, 50, NAN),
        (46, 50),
        (46,),
        (46, NAN, 33.0),
        (46.8, 50.0, 0.0),
        (46, 50.5, 30),
        (NAN, NAN, NAN),
        (46, 50, 33, 1),
        (91, 0, 0),
        (math.inf, 0, 0),
        (),
        "north",
        b"\xff\xfe",
        {},
    ],
)
def test_what_may_be_several_angles_is_none(value: object) -> None:
    read = read_coordinate(value, "N", LATITUDE)
    assert not read.is_known
    assert "GPSLatitude" in read.why


def test_a_hemisphere_is_never_assumed() -> None:
    read = read_coordinate((91, 59, 39.84), None, LONGITUDE)
    assert not read.is_known
    assert read.why == "GPSLongitudeRef is missing"


@pytest.mark.parametrize(
    ("text", "signed", "value"),
    [
        ("46,50.556N", False, 46.8426),
        ("46,50,33.36S", False, -46.8426),
        ("46.8426 n", False, 46.8426),
        ("46°50'33.36\"N", False, 46.8426),
        ("+46.8426", False, 46.8426),
        ("-46.8426", True, -46.8426),
        ("46.8426", True, 46.8426),
        ("46,8426", True, 46.8426),
        ("46.8426", False, None),
        ("46,50", True, None),
        ("46,8426N", False, None),
        ("46,50.556E", False, None),
        ("-46.8426S", False, None),
        ("98.5", True, None),
        ("", True, None),
        ("N", False, None),
    ],
)
def test_texts_of_xmp(text: str, signed: bool, value: float | None) -> None:
    read = parse_coordinate(text, LATITUDE, "XMP's field", signed=signed)
    assert read.value == (None if value is None else pytest.approx(value, abs=1e-9))
    assert read.is_known or "XMP's field" in read.why
