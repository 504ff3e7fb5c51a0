"""Spellings of places and times in subtitles, and what is said of values that are none."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest

from objconnect.ingestion.telemetry import Telemetry, read_telemetry
from objconnect.scene.errors import InputError

pytest.importorskip("srt")
HERE = "[latitude: 47.1000] [longitude: 8.5000] [rel_alt: 60.0]"


def read(tmp_path: Path, text: str) -> Telemetry:
    path = tmp_path / "F.SRT"
    path.write_text(f"1\n00:00:00,000 --> 00:00:01,000\n{text}\n\n", encoding="utf-8")
    return read_telemetry(path)[0]


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [
        ("47.1000 s", "8.5000 w"),
        ("47.1000 South", "8.5000 West"),
        ("47°06'00.0\" S", "8°30'00.0\" W"),
        ("47 06 00.0 S", "8 30 00.0 W"),
    ],
)
def test_directions_in_words_and_minutes(tmp_path: Path, latitude: str, longitude: str) -> None:
    said = read(tmp_path, f"[latitude: {latitude}] [longitude: {longitude}]")
    assert said.place == pytest.approx((-47.1, -8.5))


@pytest.mark.parametrize(
    ("clock", "expected"),
    [
        ("2026-06-01 12:00:00.250", datetime(2026, 6, 1, 12, 0, 0, 250_000)),
        ("2026-06-01 12:00:00,250,123", datetime(2026, 6, 1, 12, 0, 0, 250_000)),
        ("2026-06-01T12:00:00Z", datetime(2026, 6, 1, 12)),
        ("2026-06-01 12:00:00+02:00", datetime(2026, 6, 1, 10)),
        ("2026-06-01T12:00:00.5-0530", datetime(2026, 6, 1, 17, 30, 0, 500_000)),
        ("2026-06-01 01:02:03 PM", datetime(2026, 6, 1, 13, 2, 3)),
        ("2026-06-01 12:02:03 am", datetime(2026, 6, 1, 0, 2, 3)),
        ("2026-06-01 13:02:03 PM", None),
    ],
)
def test_clocks(tmp_path: Path, clock: str, expected: datetime | None) -> None:
    assert read(tmp_path, f"{clock}\n{HERE}").time == expected


@pytest.mark.parametrize(
    ("text", "doubt"),
    [
        (
            "[latitude: 95.1] [longitude: 8.5] [rel_alt: 60.0]",
            "95.1, longitude 8.5 is not on earth",
        ),
        ("[latitude: 471000000] [longitude: 85000000] [rel_alt: 60.0]", "is not on earth"),
        (f"{HERE} [gb_yaw: 100 gb_pitch: -900 gb_roll: 0]", "pitch -900, roll 0 are out of range"),
        (f"{HERE} [gb_yaw: 100 gb_pitch: -300 gb_roll: 0]", "pitch -300, roll 0 are out of range"),
        ("GPS: 47.1000, 8.5000, H: 60m", "GPS 47.1000"),
        ("[latitude: 47.1] [longitude: 8.5] [rel_alt: 60.0 fathoms]", "rel_alt 60.0 fathoms"),
    ],
)
def test_what_is_not_believed_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, text: str, doubt: str
) -> None:
    said = read(tmp_path, text)
    assert any(doubt in each for each in said.place_doubts)
    assert doubt in caplog.text
    assert said.gimbal is None and (said.place is None or said.place == (47.1, 8.5))


def test_a_letter_of_the_other_axis_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"latitude 8\.5 E is not understood"):
        read(tmp_path, "[latitude: 8.5 E] [longitude: 47.1 N]")
