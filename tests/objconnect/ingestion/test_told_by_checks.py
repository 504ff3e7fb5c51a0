"""What subtitles leave open: orders of pairs, decimal commas, units of focal lengths and heights.

Each value is told by a check of the file or of the map, or it is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from objconnect.ingestion.telemetry import Telemetry, read_telemetry
from objconnect.scene.errors import InputError

pytest.importorskip("srt")
ALPS = (47.0, 8.0)


def read_subtitles(folder: Path, *texts: str, **checks: object) -> list[Telemetry]:
    """Read subtitles of a second each."""
    path = folder / "FLIGHT.SRT"
    path.write_text(
        "\n".join(
            f"{k + 1}\n00:00:{k:02d},000 --> 00:00:{k + 1:02d},000\n{text}\n"
            for k, text in enumerate(texts)
        )
    )
    return read_telemetry(path, **checks)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "text",
    [
        "GPS(47.001000,8.002000,512.000) BAROMETER(60.0) HOME(47.000000,8.000000)",
        "GPS(8.002000,47.001000,17) BAROMETER:60.0",
        "GPS (47.001000, 8.002000, 512.3) BAROMETER(60.0M)",
        "GPS(8,002000; 47,001000; 17) BAROMETER:60,0",
        "GPS (8,002000, 47,001000, 17), H 60,0m",
        "GPS: (47.001000, 8.002000) BAROMETER:60.0 m",
        "RTK (8.002000, 47.001000, 28), H 60.0m, G.PRY (-90.0°, 0.0°, 0.0°)",
    ],
)
def test_the_map_tells_the_order(tmp_path: Path, text: str) -> None:
    (found,) = read_subtitles(tmp_path, text, near=ALPS)
    assert found.place == (47.001, 8.002) and found.rel_alt == 60.0
    (elsewhere,) = read_subtitles(tmp_path, text, near=(8.0, 47.0))
    assert elsewhere.place == (8.002, 47.001)
    (far,) = read_subtitles(tmp_path, text, near=(0.0, 0.0))
    assert far.place is None


def test_without_a_check_the_order_is_unknown(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (found,) = read_subtitles(tmp_path, "GPS(47.001,8.002,512.0) BAROMETER(60.0)")
    assert found.place is None and found.rel_alt == 60.0
    assert caplog.messages == [
        f"{tmp_path / 'FLIGHT.SRT'}: the order of latitude and longitude in GPS(a, b) is unknown"
    ]
    # Where the map lies on the diagonal it tells nothing, either.
    (found,) = read_subtitles(tmp_path, "GPS(8.02,8.01,512.0) BAROMETER(60.0)", near=(8.0, 8.0))
    assert found.place is None


def test_home_with_letters_tells_the_order(tmp_path: Path) -> None:
    (found,) = read_subtitles(tmp_path, "HOME(E: 8.0, N: 47.0) GPS(8.002,47.001,17) BAROMETER:60.0")
    assert found.place == (47.001, 8.002)


def test_a_stated_distance_tells_the_order(tmp_path: Path) -> None:
    """One degree to the east is 556 m in 60 degrees north, and 1113 m the other way around."""
    texts = [f"GPS (8.0{k}, 60.0, 17), HOME (8.0, 60.0), D {556.6 * k:.2f}m, H 9m" for k in (1, 2)]
    assert [item.place for item in read_subtitles(tmp_path, *texts)] == [(60.0, 8.01), (60.0, 8.02)]
    texts = [text.replace("556.6", "1113.2") for text in texts]
    texts = [f"GPS (60.0, 8.0{k}, 17), HOME (60.0, 8.0), D {556.6 * k:.2f}m, H 9m" for k in (1, 2)]
    assert [item.place for item in read_subtitles(tmp_path, *texts)] == [(60.0, 8.01), (60.0, 8.02)]


def test_a_speed_that_no_drone_has_tells_the_order(tmp_path: Path) -> None:
    """At 80 degrees north the other order would be 5.8 times as fast."""
    texts = [f"GPS (80.0, {8 + 0.003 * k:.4f}, 17), H 9m" for k in range(8)]
    assert read_subtitles(tmp_path, *texts)[7].place == (80.0, 8.021)
    texts = [f"GPS ({8 + 0.0006 * k:.4f}, 80.0, 17), H 9m, H.S 11.6m/s" for k in range(8)]
    assert read_subtitles(tmp_path, *texts)[7].place == (80.0, 8.0042)


@pytest.mark.parametrize(
    "text",
    [
        "GPS(8,5000,47,1000,17) H 60.0m",
        "GPS(8,47,17) H 60,0m",
        "GPS(8.5000, 47,1000, 17) H 60.0m",
        "GPS(8.5.1, 47.1, 17) H 60.0m",
        "GPS(8°30', 47°6', 17) H 60.0m",
        "GPS(E: 8.5, E: 47.1, 17m) H 60.0m",
        "GPS(N: -47.1, E: 8.5, 17m) H 60.0m",
    ],
)
def test_pairs_that_cannot_be_taken_apart_are_unknown(
    tmp_path: Path, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    (found,) = read_subtitles(tmp_path, text, near=(47.1, 8.5))
    assert found.place is None
    assert len(caplog.messages) >= 1 and "GPS" in caplog.messages[0]


@pytest.mark.parametrize(
    ("text", "place", "height"),
    [
        ("[latitude: 47,000400] [longitude: 8,000400] [rel_alt: 60,500]", (47.0004, 8.0004), 60.5),
        ("[latitude: 47,5] [longitude: -8,25] [rel_alt: 1,234]", (47.5, -8.25), 1.234),
        ("[latitude: 47,1 longitude: 8,2 rel_alt: 5]", (47.1, 8.2), 5.0),
        ("latitude: 47.1, longitude: 8.2, rel_alt: 5.0", (47.1, 8.2), 5.0),
        ("[latitude: 47.1 N] [longitude: 8.2 W] [rel_alt: 5.0 m]", (47.1, -8.2), 5.0),
        ("[lat: S 47.1°] [lon: 8.2°] [rel_alt: +5.0]", (-47.1, 8.2), 5.0),
        # A comma that may divide thousands, and a file with both marks.
        ("[latitude: 47.1] [longitude: 8.2] [rel_alt: 1,234]", (47.1, 8.2), None),
        ("[latitude: 47,1] [longitude: 8.2] [rel_alt: 5.0]", None, 5.0),
        ("[latitude: 47.1] [longitude: 8.2] [rel_alt: 1,234.5]", (47.1, 8.2), None),
        ("[latitude: 47.1] [longitude: 8.2] [rel_alt: 1 234.5]", (47.1, 8.2), None),
        ("[latitude: 47. 1] [longitude: 8.2] [rel_alt: 5.0]", None, 5.0),
        (f"[latitude: 0.{'0' * 300}471e303] [longitude: 8.2] [rel_alt: 5.0]", None, 5.0),
        ("[latitude: 47.1x] [longitude: 8.2] [rel_alt: 5.0]", None, 5.0),
        ("[latitude: 47<b>.1</b>] [longitude: 8.2] [rel_alt: 5.0]", None, 5.0),
        ("[latitude: 47.1] [longitude: 8.2 N] [rel_alt: 5.0]", None, 5.0),
        ("[rel_alt: 5.0] [latitude: 47.1] [longitude: 8.2", None, 5.0),
        ("[latitude: 47.1] [latitude: 47.2] [longitude: 8.2] [rel_alt: 5.0]", None, 5.0),
        ("[latitude: 4.71e1] [longitude: 8.2] [rel_alt: 5.0]", (47.1, 8.2), 5.0),
    ],
)
def test_numbers_are_read_whole_or_not_at_all(
    tmp_path: Path, text: str, place: tuple[float, float] | None, height: float | None
) -> None:
    (found,) = read_subtitles(tmp_path, "[gb_yaw: 1 gb_pitch: 2 gb_roll: 3] " + text)
    assert (found.place, found.rel_alt) == (place, height)


def test_a_file_that_tells_nothing_for_sure_is_refused_by_the_field(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="latitude 47,000 is not understood.*decimal mark"):
        read_subtitles(tmp_path, "[latitude: 47,000] [longitude: 8,500]")


@pytest.mark.parametrize(
    ("text", "rel_alt", "abs_alt"),
    [
        ("[rel_alt: 100ft abs_alt: 1000 ft]", 30.48, 304.8),
        ("[rel_alt: 100.0 feet] [abs_alt: 300 m]", 30.48, 300.0),
        ("BAROMETER(100.0ft)", 30.48, None),
        ("BAROMETER:60.0M", 60.0, None),
        ("BAROMETER(60.0)", 60.0, None),
        ("GPS(N: 47.0, E: 8.0, 1000ft) H 100ft", 30.48, 304.8),
        ("[rel_alt: 100 fathoms] [abs_alt: 300.0]", None, None),
        # In a file with feet a number without a unit may be either.
        ("[rel_alt: 100ft] [abs_alt: 300.0]", 30.48, None),
        ("[altitude: 300.0] BAROMETER(60.0)", 60.0, None),
        ("[abs_alt: 0.0 rel_alt: -3.5]", -3.5, 0.0),
    ],
)
def test_units_of_heights(
    tmp_path: Path, text: str, rel_alt: float | None, abs_alt: float | None
) -> None:
    (found,) = read_subtitles(tmp_path, "[gb_yaw: 1 gb_pitch: 2 gb_roll: 3] " + text)
    assert found.rel_alt == pytest.approx(rel_alt) and found.abs_alt == pytest.approx(abs_alt)


@pytest.mark.parametrize(
    ("text", "lenses", "focal"),
    [
        ("[fnum: 3.4] [focal_len: 162.00]", (), 162.0),
        ("[fnum: 4.4] [focal_len: 166.00] [dzoom_ratio: 1.00]", (), 166.0),
        ("[focal_len: 24,00]", (), 24.0),
        ("[focal_len: 240mm]", (), 240.0),
        ("[fnum : 280] [focal_len : 240]", (), 24.0),
        ("[fnum : 440] [focal_len : 1620]", (), 162.0),
        ("[focal_len : 240] [dzoom_ratio: 10000, delta:0]", (), 24.0),
        ("[fnum: 3.4] [focal_len : 240]", (), None),
        ("[focal_len : 240]", (), None),
        ("[fnum: 280] [focal_len: 240] [fnum: 2]", (), None),
        # The map's lens tells.
        ("[focal_len : 240]", (24.6,), 24.0),
        ("[focal_len : 240]", (235.0,), 240.0),
        ("[focal_len : 240]", (24.6, 235.0), None),
        ("[focal_len : 240]", (50.0,), None),
        ("[focal_len: 24.00in]", (), None),
        ("[focal_len: 4.50]", (), None),
        ("[focal_len: 24.0.0]", (), None),
        ("[focal_len: 0]", (), None),
    ],
)
def test_units_of_focal_lengths(
    tmp_path: Path, text: str, lenses: Sequence[float], focal: float | None
) -> None:
    (found,) = read_subtitles(tmp_path, text + " [rel_alt: 5]", lenses=lenses)
    assert found.focal_mm == pytest.approx(focal)


@pytest.mark.parametrize(
    ("text", "zoom"),
    [
        ("[dzoom_ratio: 2.00]", 2.0),
        ("[dzoom_ratio: 1.00]", 1.0),
        ("[dzoom_ratio: 20000, delta:0]", 2.0),
        ("[dzoom_ratio:15000,delta:3]", 1.5),
        ("[dzoom_ratio: 2,50]", 2.5),
        ("DZOOM 2.000, ISO 100", 2.0),
        ("[dzoom_ratio: 2]", 2.0),
        ("[dzoom_ratio: 2.0x]", 2.0),
        ("", 1.0),
        ("[dzoom_ratio: 20000]", None),
        ("[dzoom_ratio: 200]", None),
        ("[dzoom_ratio: 200%]", None),
        ("[dzoom_ratio: 0.50]", None),
        ("[dzoom_ratio: 2, delta:0]", None),
        ("[dzoom_ratio: auto]", None),
        ("[dzoom_ratio: 1.00] [lens_zoom: 3.0]", None),
    ],
)
def test_scales_of_zoom(
    tmp_path: Path, text: str, zoom: float | None, caplog: pytest.LogCaptureFixture
) -> None:
    height = "[rel_alt: 5,0]" if "2,50" in text else "[rel_alt: 5.0]"
    (found,) = read_subtitles(tmp_path, f"{text} {height}")
    assert found.zoom == zoom
    assert (zoom is None) == any("zoom" in line for line in caplog.messages)


def test_fields_that_some_subtitles_lack(tmp_path: Path) -> None:
    """One lens is that of all; of several, those of the others are not known."""
    height = "[rel_alt: 5.0]"
    same = read_subtitles(
        tmp_path, f"[focal_len: 24.00] {height}", height, f"[focal_len: 24.00] {height}"
    )
    assert [item.focal_mm for item in same] == [24.0, 24.0, 24.0]
    zooming = read_subtitles(
        tmp_path, f"[focal_len: 24.00] {height}", height, f"[focal_len: 48.00] {height}"
    )
    assert [item.focal_mm for item in zooming] == [24.0, None, 48.0]


def test_a_roll_that_is_missing_is_not_zero(tmp_path: Path) -> None:
    first, second = read_subtitles(
        tmp_path,
        "[gb_yaw: 1.0 gb_pitch: -90.0] [rel_alt: 5.0]",
        "[gb_yaw: 1.0 gb_pitch: -90.0 gb_roll: 0.0] [rel_alt: 5.0]",
    )
    assert (first.gimbal, second.gimbal) == (None, (1.0, -90.0, 0.0))


def test_whole_angles_beyond_a_turn_are_in_another_unit(tmp_path: Path) -> None:
    """Those of tenths that could be degrees are not taken for them."""
    first, second = read_subtitles(
        tmp_path,
        "[gb_yaw: -676 gb_pitch: -900 gb_roll: 1] [rel_alt: 5.0]",
        "[gb_yaw: -10 gb_pitch: -300 gb_roll: 1] [rel_alt: 5.0]",
    )
    assert (first.gimbal, second.gimbal) == (None, None)


@pytest.mark.parametrize("jump", [(0.0, 0.0), (47.0, 0.0), (0.0, 8.0), (47.1, 8.0)])
def test_jumps_are_no_positions(
    tmp_path: Path, jump: tuple[float, float], caplog: pytest.LogCaptureFixture
) -> None:
    places = [(47.0 + 1e-5 * k, 8.0) for k in range(12)]
    places[6] = jump
    texts = [f"[latitude: {a:.6f}] [longitude: {b:.6f}] [rel_alt: 5.0]" for a, b in places]
    found = [item.place for item in read_subtitles(tmp_path, *texts)]
    assert found[6] is None and sum(place is None for place in found) == 1
    assert (jump != (0.0, 0.0)) == any("1 positions jump" in line for line in caplog.messages)


@pytest.mark.parametrize(
    "encoding",
    ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le", "cp1252"],
)
def test_encodings(tmp_path: Path, encoding: str) -> None:
    text = (
        "1\n00:00:00,000 --> 00:00:01,000\nGPS (8.5, 47.1, 9), H 5.0m, G.PRY (1.0°, 2.0°, 3.0°)\n"
    )
    path = tmp_path / "FLIGHT.SRT"
    path.write_bytes(text.encode(encoding))
    (found,) = read_telemetry(path, near=(47.0, 8.4))
    assert (found.place, found.gimbal) == ((47.1, 8.5), (3.0, 1.0, 2.0))


@pytest.mark.parametrize(
    "text",
    [
        '<font size="28">[latitude: 47.1] [longitude: 8.2]</font> [rel_alt: 5.0]',
        "{\\an8}[latitude: 47.1]<br>[longitude:&nbsp;8.2]<br/>[rel_alt: 5.0]",
        "<b>[latitude:</b> 47.1&deg;] <i>[longitude: 8.2&#176;]</i> [rel_alt: 5.0]",
    ],
)
def test_tags_and_entities(tmp_path: Path, text: str) -> None:
    (found,) = read_subtitles(tmp_path, text)
    assert (found.place, found.rel_alt) == ((47.1, 8.2), 5.0)
