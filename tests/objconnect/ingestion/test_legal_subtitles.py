"""Legal subtitles of all dialects with a known truth: the reader finds it, or says unknown.

Files are written with random units, orders, decimal marks, encodings and gaps. No reading may be
another value than the truth.
"""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import pytest

from objconnect.ingestion.telemetry import Telemetry, read_telemetry
from objconnect.scene.errors import InputError

pytest.importorskip("srt")
FILES = 350
SEED = 55
FIELDS = re.compile("latitude|GPS|RTK|alt|height|focal_len|zoom|gimbal", re.IGNORECASE)
# Drones write so many decimals at least; the truth is rounded by as much.
TOLERANCES = {"place": 6e-5, "rel_alt": 0.06, "abs_alt": 0.06, "gimbal": 0.06, "zoomed": 0.051}


@dataclass(frozen=True)
class Truth:
    """What was true when a subtitle was written."""

    place: tuple[float, float] | None
    home: tuple[float, float]
    rel_alt: float
    abs_alt: float
    gimbal: tuple[float, float, float]
    focal_mm: float
    zoom: float
    distance: float
    speed: float


@dataclass(frozen=True)
class Style:
    """How a file writes numbers."""

    mark: str
    height_unit: str
    latitude_first: bool
    focal_in_tenths: bool
    # "ratio", "delta", "bare" or "none"
    zoom: str
    dialect: str
    encoding: str
    tags: bool
    gaps: frozenset[str] = field(default=frozenset())

    def number(self, value: float, decimals: int) -> str:
        return f"{value:.{decimals}f}".replace(".", self.mark)

    def height(self, value: float) -> str:
        unit = {"": 1.0, "m": 1.0, "M": 1.0, "ft": 0.3048, " feet": 0.3048, " m": 1.0}
        # Feet with two decimals are as exact as metres with two.
        return self.number(value / unit[self.height_unit], 2) + self.height_unit

    def pair(self, place: tuple[float, float], *more: str) -> str:
        first, second = place if self.latitude_first else place[::-1]
        between = ", " if self.mark == "," or self.tags else ","
        return between.join([self.number(first, 6), self.number(second, 6), *more])


def bracket(truth: Truth, style: Style) -> str:
    words = []
    if not style.focal_in_tenths:
        words.append(f"[fnum: {style.number(2.8, 1)}] ")
        words.append(f"[focal_len: {style.number(truth.focal_mm, 2)}] ")
    else:
        words.append("[fnum : 280] " if style.zoom != "ratio" else "")
        words.append(f"[focal_len : {round(10 * truth.focal_mm)}] ")
    words.append(zoom_word(truth, style))
    if "place" not in style.gaps:
        latitude, longitude = truth.place or (0.0, 0.0)
        words.append(f"[latitude: {style.number(latitude, 6)}] ")
        words.append(f"[longitude: {style.number(longitude, 6)}] ")
    words.append(f"[rel_alt: {style.height(truth.rel_alt)} ")
    words.append(f"abs_alt: {style.height(truth.abs_alt)}] ")
    if "gimbal" not in style.gaps:
        yaw, pitch, roll = (style.number(value, 1) for value in truth.gimbal)
        words.append(f"[gb_yaw: {yaw} gb_pitch: {pitch} gb_roll: {roll}]")
    return "".join(words)


def zoom_word(truth: Truth, style: Style) -> str:
    return {
        "ratio": f"[dzoom_ratio: {style.number(truth.zoom, 2)}] ",
        "delta": f"[dzoom_ratio: {round(1e4 * truth.zoom)}, delta:0] ",
        "bare": f"[dzoom_ratio: {round(1e4 * truth.zoom)}] ",
        "none": "",
    }[style.zoom]


def compact(truth: Truth, style: Style) -> str:
    pair = style.pair(truth.place or (0.0, 0.0), "17")
    yaw, pitch, roll = (style.number(value, 1) for value in truth.gimbal)
    height = style.height(truth.rel_alt) + ("" if style.height_unit else "m")
    home = f"HOME ({style.pair(truth.home)}), " if "home" not in style.gaps else ""
    return (
        f"F/2.8, SS 206, ISO 150, EV 0, GPS ({pair}), {home}D {style.number(truth.distance, 2)}m, "
        f"H {height}, H.S {style.number(truth.speed, 2)}m/s, V.S {style.number(0.0, 2)}m/s, "
        f"G.PRY ({pitch}°, {roll}°, {yaw}°)"
    )


def barometric(truth: Truth, style: Style) -> str:
    home = f"HOME({style.pair(truth.home)}) " if "home" not in style.gaps else ""
    height = style.height(truth.rel_alt)
    barometer = f"BAROMETER({height})" if style.tags else f"BAROMETER:{height}"
    third = style.number(truth.abs_alt, 3) if style.latitude_first else "17"
    return f"{home}GPS({style.pair(truth.place or (0.0, 0.0), third)}) {barometer}"


def letter(truth: Truth, style: Style) -> str:
    latitude, longitude = truth.place or (0.0, 0.0)
    parts = [
        f"{'N' if latitude >= 0 else 'S'}: {style.number(abs(latitude), 6)}",
        f"{'E' if longitude >= 0 else 'W'}: {style.number(abs(longitude), 6)}",
    ]
    parts = parts if style.latitude_first else parts[::-1]
    altitude = style.height(truth.abs_alt) + ("" if style.height_unit else "m")
    return f"GPS({', '.join(parts)}, {altitude})"


DIALECTS: dict[str, Callable[[Truth, Style], str]] = {
    "bracketed": bracket,
    "compact": compact,
    "barometric": barometric,
    "lettered": letter,
}


def fly(random: Random, count: int, style: Style) -> list[Truth]:
    """A flight of some seconds, a subtitle each second."""
    latitude, longitude = random.uniform(-75, 75), random.uniform(-179, 179)
    if random.random() < 0.2:  # where both orders lie close together
        longitude = latitude + random.uniform(-0.05, 0.05)
    heading, speed = random.uniform(0, 2 * math.pi), random.uniform(0, 20)
    focal = random.choice([24.0, 28.0, 48.0, 70.0, 162.0, 166.0, 240.0, 12.7, 22.0])
    zoom = 1.0 if style.zoom == "none" else random.choice([1.0, 1.0, 2.0, 1.5, 4.0])
    zooms = random.random() < 0.3 and style.zoom != "none"
    home, truths = (latitude, longitude), []
    for second in range(count):
        metres = speed * second
        place = (
            latitude + metres * math.cos(heading) / 111_320,
            longitude + metres * math.sin(heading) / 111_320 / math.cos(math.radians(latitude)),
        )
        truths.append(
            Truth(
                None if random.random() < 0.05 else place,
                home,
                rel_alt=random.uniform(-20, 120),
                abs_alt=random.uniform(-20, 3000),
                gimbal=(random.uniform(-180, 180), random.uniform(-90, 30), random.uniform(-9, 9)),
                focal_mm=focal,
                zoom=zoom + (0.25 * second if zooms else 0),
                distance=metres,
                speed=speed,
            )
        )
    return truths


def add_style(random: Random) -> Style:
    return Style(
        mark=random.choice("..,"),
        height_unit=random.choice(["", "", "m", "M", " m", "ft", " feet"]),
        latitude_first=random.random() < 0.5,
        focal_in_tenths=random.random() < 0.4,
        zoom=random.choice(["ratio", "delta", "bare", "none"]),
        dialect=random.choice(sorted(DIALECTS)),
        encoding=random.choice(
            ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1", "utf-32"]
        ),
        tags=random.random() < 0.5,
        gaps=frozenset(name for name in ("place", "gimbal", "home") if random.random() < 0.2),
    )


def write(path: Path, random: Random, truths: list[Truth], style: Style) -> None:
    texts = []
    for k, truth in enumerate(truths):
        text = DIALECTS[style.dialect](truth, style)
        if style.tags:
            text = f'<font size="28">FrameCnt: {k + 1}, DiffTime: 1000ms\n{text}</font>'
        texts.append(f"{k + 1}\n00:00:{k:02d},000 --> 00:00:{k + 1:02d},000\n{text}\n")
    end = random.choice(["\n", "\r\n"])
    path.write_bytes("\n".join(texts).replace("\n", end).encode(style.encoding))


def is_true(name: str, found: object, truth: Truth, style: Style) -> bool:
    """Return whether a reading is the truth."""
    values: dict[str, object] = {
        "place": truth.place,
        "rel_alt": truth.rel_alt,
        "abs_alt": truth.abs_alt,
        "gimbal": truth.gimbal,
        "zoomed": truth.focal_mm * truth.zoom,
    }
    expected = values[name]
    if expected is None:
        return False
    pairs = zip(
        found if isinstance(found, tuple) else (found,),
        expected if isinstance(expected, tuple) else (expected,),
        strict=True,
    )
    return all(abs(a - b) <= TOLERANCES[name] for a, b in pairs)


def readings(said: Telemetry) -> dict[str, object]:
    return {
        "place": said.place,
        "rel_alt": said.rel_alt,
        "abs_alt": said.abs_alt,
        "gimbal": said.gimbal,
        "zoomed": said.effective_mm,
    }


def test_no_reading_is_another_value_than_the_truth(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    random, path = Random(SEED), tmp_path / "FLIGHT.SRT"
    known: Counter[str] = Counter()
    unknown: Counter[str] = Counter()
    for number in range(FILES):
        style = add_style(random)
        truths = fly(random, random.randint(3, 12), style)
        write(path, random, truths, style)
        north, east = (random.uniform(-0.03, 0.03) for _ in range(2))
        home = truths[0].home
        near = (home[0] + north, home[1] + east) if random.random() < 0.6 else None
        lenses = [truths[0].focal_mm * random.uniform(0.95, 1.05)] if random.random() < 0.3 else []
        caplog.clear()
        try:
            flight = read_telemetry(path, near, lenses)
        except InputError as error:
            assert FIELDS.search(str(error)) and "\n" not in str(error), f"{number}: {error}"
            continue
        assert len(flight) == len(truths)
        for said, truth in zip(flight, truths, strict=True):
            for name, found in readings(said).items():
                (unknown if found is None else known)[name] += 1
                about = f"file {number}: {name} is {found} of {truth}, written as {style}"
                assert found is None or is_true(name, found, truth, style), about
        if style.dialect != "lettered" and all(said.place is None for said in flight):
            told = style.dialect == "bracketed" and "place" in style.gaps
            assert told or caplog.messages or not any(truth.place for truth in truths)
    shares = {name: known[name] / (known[name] + unknown[name]) for name in known}
    # A reader that says "unknown" to all would be right, too, and useless.
    assert set(shares) == set(TOLERANCES)
    assert shares["place"] > 0.6 and shares["rel_alt"] > 0.4, shares
    assert min(shares.values()) > 0.15, shares
