"""When photographs were taken, and clocks that contradict each other."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from objconnect.scene.quantities.times import read_time

NOON = {"DateTimeOriginal": "2026:06:01 12:00:00"}
TEN = datetime(2026, 6, 1, 10, tzinfo=UTC)


@pytest.mark.parametrize(
    ("detail", "gps", "hour", "doubt"),
    [
        ({}, {}, 12, ""),
        ({"OffsetTimeOriginal": "+02:00"}, {}, 10, ""),
        ({"OffsetTimeOriginal": "+02:00"}, {"GPSTimeStamp": (10.0, 0.0, 30.0)}, 10, ""),
        (
            {"OffsetTimeOriginal": "+02:00"},
            {"GPSTimeStamp": (12.0, 0.0, 0.0), "GPSDateStamp": "2026:06:01"},
            10,
            "OffsetTimeOriginal contradicts GPSTimeStamp by 2.0 h",
        ),
        ({}, {"GPSTimeStamp": (10.0, 0.0, 0.0)}, 12, "OffsetTimeOriginal is missing"),
        ({}, {"GPSTimeStamp": (12.0, 0.0, 0.0), "GPSDateStamp": "2026:06:02"}, 12, "by 24.0 h"),
        ({}, {"GPSTimeStamp": (25.0, 0.0, 0.0)}, 12, ""),
        ({}, {"GPSTimeStamp": "10:00"}, 12, ""),
    ],
)
def test_the_receiver_s_clock_checks_the_camera_s(
    detail: dict[str, object], gps: dict[str, object], hour: int, doubt: str
) -> None:
    read = read_time(NOON | detail, gps)
    assert read.value == TEN.replace(hour=hour)
    assert doubt in read.why and bool(read.doubts) == bool(doubt)


def test_around_midnight_a_stamp_without_a_date_is_near() -> None:
    late = {"DateTimeOriginal": "2026:06:01 23:59:50"}
    assert not read_time(late, {"GPSTimeStamp": (0.0, 0.0, 5.0)}).doubts
