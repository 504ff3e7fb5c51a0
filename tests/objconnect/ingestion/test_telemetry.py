"""Telemetry in subtitles: a written sample of every dialect, and files that are broken."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest

from objconnect.ingestion.telemetry import Telemetry, find_telemetry, read_telemetry
from objconnect.scene.errors import InputError

BRACKETS = """1
00:00:00,000 --> 00:00:00,033
<font size="28">FrameCnt: 1, DiffTime: 33ms
2024-03-08 10:12:34.123
[iso: 100] [shutter: 1/640.0] [fnum: 2.8] [ev: 0] [ct: 5300] [color_md: default] [focal_len: \
24.00] [latitude: 47.377000] [longitude: 8.541000] [rel_alt: 60.100 abs_alt: 512.300] [gb_yaw: \
-67.6 gb_pitch: -89.9 gb_roll: 0.1] </font>

2
00:00:00,033 --> 00:00:00,066
<font size="28">FrameCnt: 2, DiffTime: 33ms
2024-03-08 10:12:34.156
[iso: 100] [shutter: 1/640.0] [fnum: 2.8] [ev: 0] [ct: 5300] [color_md: default] [focal_len: \
24.00] [latitude: 47.377010] [longitude: 8.541020] [rel_alt: 60.200 abs_alt: 512.400] [gb_yaw: \
-67.5 gb_pitch: -89.8 gb_roll: 0.0] </font>
"""
MAVIC_2 = """1
00:00:00,000 --> 00:00:00,041
<font size="36">FrameCnt : 1, DiffTime : 41ms
2023-07-15 11:55:16,320,933
[iso : 100] [shutter : 1/400.0] [fnum : 280] [ev : 0] [ct : 5818] [color_md : default] [focal_len \
: 240] [latitude : 47.377000] [longtitude : 8.541000] [altitude: 26.600000] </font>
"""
MINI_2 = """1
00:00:00,000 --> 00:00:01,000
F/2.8, SS 206.14, ISO 150, EV 0, DZOOM 1.000, GPS (8.5410, 47.3770, 16), D 2.80m, H 60.10m, H.S \
1.20m/s, V.S 0.00m/s
"""
PHANTOM_4_RTK = """36
00:00:35,000 --> 00:00:36,000
F/6.3, SS 60, ISO 100, EV 0, RTK (8.541000, 47.377000, 28), HOME (8.541100, 47.377100, 103.55m), \
D 75.36m, H 76.19m, H.S 0.30m/s, V.S 0.00m/s, F.PRY (-5.3°, 2.1°, 28.3°), \
G.PRY (-40.0°, 0.5°, 28.2°)
"""
PHANTOM_4 = """1
00:00:01,000 --> 00:00:02,000
HOME(8.5410,47.3770) 2017.8.5 14:11:51
GPS(8.5411,47.3771,16) BAROMETER:60.1
ISO:100 Shutter:60 EV: 0 Fnum:2.2
"""
MATRICE_300 = """1
00:00:00,000 --> 00:00:01,000
2022.06.21 16:06:17
GPS(47.3770,8.5410,0.0M) BAROMETER:60.3M
"""
AUTEL = """1
00:00:00,000 --> 00:00:01,000
HOME(W: 97.616776, S: 30.219286) 2020-11-01 15:29:24
GPS(W: 97.621475, S: 30.214199, 174.21m)
ISO:105 SHUTTER:500 EV:0.0 F-NUM:2.8
"""
HERE = (47.4, 8.5)
TEXAS = (-30.214199, -97.621475)


def write(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "FLIGHT.SRT"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            BRACKETS,
            Telemetry(
                0.0,
                0.033,
                (47.377, 8.541),
                60.1,
                512.3,
                (-67.6, -89.9, 0.1),
                24.0,
                datetime(2024, 3, 8, 10, 12, 34, 123000),
                frame=1,
            ),
        ),
        # Where an altitude does not say of what, it is left out.
        (
            MAVIC_2,
            Telemetry(
                0.0,
                0.041,
                (47.377, 8.541),
                focal_mm=24.0,
                time=datetime(2023, 7, 15, 11, 55, 16, 320000),
                frame=1,
            ),
        ),
        # The third number counts satellites: it is not an altitude.
        (MINI_2, Telemetry(0.0, 1.0, (47.377, 8.541), rel_alt=60.1)),
        # The gimbal, not the aircraft; pitch comes first.
        (
            PHANTOM_4_RTK,
            Telemetry(35.0, 36.0, (47.377, 8.541), rel_alt=76.19, gimbal=(28.2, -40.0, 0.5)),
        ),
        (
            PHANTOM_4,
            Telemetry(
                1.0, 2.0, (47.3771, 8.5411), rel_alt=60.1, time=datetime(2017, 8, 5, 14, 11, 51)
            ),
        ),
        (
            MATRICE_300,
            Telemetry(
                0.0, 1.0, (47.377, 8.541), rel_alt=60.3, time=datetime(2022, 6, 21, 16, 6, 17)
            ),
        ),
        (
            AUTEL,
            Telemetry(
                0.0,
                1.0,
                TEXAS,
                abs_alt=174.21,
                time=datetime(2020, 11, 1, 15, 29, 24),
            ),
        ),
    ],
    ids=["brackets", "mavic-2", "mini-2", "phantom-4-rtk", "phantom-4", "matrice-300", "autel"],
)
def test_every_dialect_is_read(tmp_path: Path, text: str, expected: Telemetry) -> None:
    said = read_telemetry(write(tmp_path, text), near=HERE if expected.place != TEXAS else TEXAS)
    assert said[0] == expected


@pytest.mark.parametrize(
    ("pair", "place"),
    [
        ("GPS (120.1, 30.2, 16)", (30.2, 120.1)),
        # Some firmware has the latitude first: a number beyond 90 tells.
        ("GPS (30.2, 120.1, 16)", (30.2, 120.1)),
        ("GPS (-30.2, -120.1, 16)", (-30.2, -120.1)),
        # Nothing tells.
        ("GPS (8.5, 47.3, 16)", None),
        ("GPS(47.3,8.5,0.0M)", None),
        ("GPS(E: 8.5, N: 47.3, 161)", (47.3, 8.5)),
        ("GPS(N: 47.3, E: 8.5, 161)", (47.3, 8.5)),
    ],
)
def test_latitude_and_longitude_are_told_apart(
    tmp_path: Path, pair: str, place: tuple[float, float] | None
) -> None:
    text = f"1\n00:00:00,000 --> 00:00:01,000\n{pair}, H 5.00m\n"
    assert read_telemetry(write(tmp_path, text))[0].place == place


def test_one_longitude_tells_the_order_of_all(tmp_path: Path) -> None:
    """A flight over the meridian of 90 degrees has both kinds of pairs."""
    text = (
        "1\n00:00:00,000 --> 00:00:01,000\nGPS (30.2, 89.9999, 9), H 5.00m\n\n"
        "2\n00:00:01,000 --> 00:00:02,000\nGPS (30.2, 90.0001, 9), H 5.00m\n"
    )
    flight = read_telemetry(write(tmp_path, text))
    assert [item.place for item in flight] == [(30.2, 89.9999), (30.2, 90.0001)]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_other_encodings_are_read(tmp_path: Path, encoding: str) -> None:
    flight = read_telemetry(write(tmp_path, PHANTOM_4_RTK, encoding))
    assert flight[0].gimbal == (28.2, -40.0, 0.5)


def test_windows_line_ends_are_read(tmp_path: Path) -> None:
    flight = read_telemetry(write(tmp_path, BRACKETS.replace("\n", "\r\n")))
    assert [item.rel_alt for item in flight] == [60.1, 60.2]


def test_no_fix_is_no_place(tmp_path: Path) -> None:
    for number in ("0.000000", "nan", "1e999", "91.0", "999999999999999999999"):
        text = BRACKETS.replace("47.377000", number).replace("8.541000", number)
        first, second = read_telemetry(write(tmp_path, text))
        assert first.place is None, number
        assert second.place == (47.37701, 8.54102)
        assert first.gimbal == (-67.6, -89.9, 0.1)


def test_impossible_numbers_are_left_out(tmp_path: Path) -> None:
    text = BRACKETS.replace("gb_yaw: -67.6", "gb_yaw: 9999").replace("512.300", "1" * 400)
    text = text.replace("10:12:34.123", "25:61:61.123").replace("24.00", "0")
    first = read_telemetry(write(tmp_path, text))[0]
    assert (first.gimbal, first.abs_alt, first.time, first.focal_mm) == (None, None, None, None)
    assert first.place == (47.377, 8.541)


def test_truncated_file_is_read_to_its_end(tmp_path: Path) -> None:
    path = write(tmp_path, BRACKETS[: BRACKETS.index("[gb_yaw: -67.5")])
    flight = read_telemetry(path)
    assert [item.gimbal for item in flight] == [(-67.6, -89.9, 0.1), None]


@pytest.mark.parametrize(
    "content",
    [b"", b"\x00" * 99, b"hello", b"1\n00:00:00,000 --> 00:00:01,000\nSubtitles by nobody\n"],
    ids=["empty", "zeros", "words", "film"],
)
def test_other_files_are_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "FLIGHT.SRT"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"FLIGHT\.SRT") as refused:
        read_telemetry(path)
    assert "\n" not in str(refused.value)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read subtitles"):
        read_telemetry(tmp_path / "none.srt")


def test_telemetry_of_a_time() -> None:
    flight = [Telemetry(0.0, 0.5, rel_alt=1.0), Telemetry(0.5, 1.0, rel_alt=2.0)]
    found = [find_telemetry(flight, seconds) for seconds in (-0.1, 0.0, 0.49, 0.5, 1.9, 2.1)]
    assert [item and item.rel_alt for item in found] == [None, 1.0, 1.0, 2.0, 2.0, None]
