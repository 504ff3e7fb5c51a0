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


@pytest.mark.parametrize(
    ("stamp", "offset", "time"),
    [
        ("2026-06-01T10:00:00Z", "", TEN),
        ("2026-06-01T10:00:00Z", "+02:00", TEN),
        ("2026-06-01T12:00:00", "+02:00", TEN),
        ("2026-06-01 12:00:00+0200", "", TEN),
        ("2026-06-01T10:00:00.25", "", TEN.replace(microsecond=250_000)),
        ("2026:06:01 10:00:00\0", "", TEN),
    ],
)
def test_times_of_programs(stamp: str, offset: str, time: datetime) -> None:
    read = read_time({"DateTimeOriginal": stamp, "OffsetTimeOriginal": offset}, {})
    assert (read.value, read.doubts) == (time, ())


@pytest.mark.parametrize(
    "stamp", ["0000:00:00 00:00:00", "2026-06-01", "2026-13-01T10:00:00Z", "noon", "9" * 1000]
)
def test_what_is_not_a_time_is_named(stamp: str) -> None:
    read = read_time({"DateTimeOriginal": stamp}, {})
    assert read.value is None and len(read.why) < 80
    assert read.why == f"DateTimeOriginal {stamp[:40]!r} is not a time"


def test_an_offset_that_cannot_be_read_is_named() -> None:
    read = read_time(NOON | {"OffsetTimeOriginal": "junk"}, {})
    assert read.value == TEN.replace(hour=12)
    assert read.why == "OffsetTimeOriginal 'junk' is not an offset from UTC"


def test_without_a_time_there_is_nothing_to_doubt() -> None:
    assert (read_time({}, {}).value, read_time({}, {}).doubts) == (None, ())
