"""Readings, numbers and lengths as files state them."""

from __future__ import annotations

import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.quantities.lengths import metres_per
from objconnect.scene.quantities.numbers import parse_number
from objconnect.scene.quantities.reading import Reading, known, unknown


def test_a_reading_without_a_value_names_its_field_in_the_error() -> None:
    height: Reading[float] = unknown("GPSAltitude", "GPSAltitudeRef is 7")
    with pytest.raises(InputError, match=r"a.jpg: GPSAltitude is unknown \(GPSAltitudeRef is 7\)"):
        height.require("a.jpg", "give --undulation")


def test_a_changed_reading_keeps_source_and_doubts() -> None:
    feet = known(100.0, "height", "unit is a guess")
    assert feet.map(lambda value: value * 0.3048).value == pytest.approx(30.48)
    assert feet.map(str).doubts == ("unit is a guess",)
    assert unknown("height").map(abs).value is None


@pytest.mark.parametrize("text", ["1.234,5", "1,234,567", "", "12 m", "nan", "inf", "1e999", "--1"])
def test_a_text_with_two_marks_or_other_characters_is_no_number(text: str) -> None:
    assert parse_number(text) is None


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("m", 1), ("meters", 1), ("US survey foot", 1200 / 3937), ("us-ft", 1200 / 3937),
     ("feet", 0.3048), ("Foot (US)", 1200 / 3937), ("kilometre", 1000)],
)  # fmt: skip
def test_units_of_length_are_known_by_their_spellings(unit: str, metres: float) -> None:
    assert metres_per(unit) == metres


@pytest.mark.parametrize("unit", ["", "fathom", "degree", "s", "unknown"])
def test_other_units_are_unknown(unit: str) -> None:
    assert metres_per(unit) is None
