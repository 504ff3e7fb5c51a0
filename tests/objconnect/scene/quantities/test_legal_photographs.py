"""Random photographs with a known truth in legal EXIF and XMP: it is found, or unknown.

A picture may be resized, turned or cropped by a program that updates some fields and not others.
Left out is what no field shows: a part of a picture of the same shape whose fields are as before,
and a crop of a picture that states nothing but its focal length for film.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from objconnect.scene.storage.exif import Exif, read_exif
from tests.objconnect.scene.quantities import raw_exif as raw
from tests.objconnect.scene.quantities.raw_exif import Field

COUNT = 600
NATIVE = ((400, 300), (360, 240), (384, 216))


@dataclass
class Made:
    """A photograph and what is true of it.

    Attributes:
        size: of the picture.
        position: latitude and longitude.
        altitude: metres.
        focal: in longest sides of the picture.
        gimbal: yaw, pitch and roll.
        coarse: whether only whole millimetres of film tell the focal length.
        turned: whether fields show that the picture was turned after it was taken, so that the
            attitude is not its own.
    """

    rng: np.random.Generator
    size: tuple[int, int] = (0, 0)
    position: tuple[float, float] = (0.0, 0.0)
    altitude: float = 0.0
    focal: float = 0.0
    gimbal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coarse: bool = True
    turned: bool = False
    gps: dict[str, Field] = field(default_factory=dict)
    detail: dict[str, Field] = field(default_factory=dict)
    xmp: dict[str, str] = field(default_factory=dict)

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def pick(self, *items: Any) -> Any:
        return items[int(self.rng.integers(len(items)))]


def number(made: Made, value: float, decimals: int) -> str:
    """A number with a sign or without, and sometimes with a comma."""
    said = f"{value:{made.pick('', '+')}.{decimals}f}"
    return said.replace(".", ",") if made.chance(0.2) else said


def angle(made: Made, degrees: float) -> Field:
    whole, minutes = int(degrees), (degrees - int(degrees)) * 60
    seconds = (minutes - int(minutes)) * 60
    forms: list[Callable[[], Field]] = [
        lambda: raw.rational(whole, int(minutes), seconds),
        lambda: raw.rational(whole, minutes, 0),
        lambda: raw.rational(whole, minutes, None),
        lambda: raw.rational(whole, minutes),
        lambda: raw.rational(degrees),
        lambda: raw.rational(degrees, 0, 0),
        lambda: raw.rational(degrees, None, None),
        lambda: raw.text(f"{whole},{int(minutes)},{seconds:.6f}"),
        lambda: raw.text(f"{degrees:.8f}"),
    ]
    return forms[int(made.rng.integers(len(forms)))]()


def hemisphere(made: Made, word: str) -> Field:
    forms = [word[0], word[0].lower(), word, word.upper(), f"{word[0]} ", f" {word[0]}", word[0]]
    said = made.pick(*forms)
    padded = said.encode() + b"\0" * int(made.rng.integers(3))
    return made.pick(raw.text(padded), raw.make_undefined(padded))


def letter_tags(degrees: float, letters: str, made: Made) -> str:
    letter, value = letters[degrees < 0], abs(degrees)
    whole, minutes = int(value), (value - int(value)) * 60
    if made.chance(0.5):
        return f"{whole},{minutes:.7f}{letter}"
    return f"{whole},{int(minutes)},{(minutes - int(minutes)) * 60:.5f}{letter}"


def put_position(made: Made) -> None:
    latitude, longitude = made.rng.uniform(-89, 89), made.rng.uniform(-179, 179)
    made.position = (float(latitude), float(longitude))
    if made.chance(0.9):
        made.gps["GPSLatitude"] = angle(made, abs(latitude))
        made.gps["GPSLongitude"] = angle(made, abs(longitude))
        if made.chance(0.85):
            made.gps["GPSLatitudeRef"] = hemisphere(made, "North" if latitude >= 0 else "South")
        if made.chance(0.85):
            made.gps["GPSLongitudeRef"] = hemisphere(made, "East" if longitude >= 0 else "West")
        if made.chance(0.3):
            made.gps["GPSMapDatum"] = raw.text(made.pick("WGS-84", "WGS84", "wgs 84"))
    if made.chance(0.4):
        east = made.pick("GpsLongitude", "GpsLongtitude")
        made.xmp["drone-dji:GpsLatitude"] = number(made, latitude, 8)
        made.xmp[f"drone-dji:{east}"] = number(made, longitude, 8)
    if made.chance(0.3):
        made.xmp["exif:GPSLatitude"] = letter_tags(latitude, "NS", made)
        made.xmp["exif:GPSLongitude"] = letter_tags(longitude, "EW", made)


def put_altitude(made: Made) -> None:
    metres = round(float(made.rng.uniform(-300, 4000)), 2)
    made.altitude = metres
    kind = made.pick("whole", "whole", "none", "0/0")
    if kind != "none":
        below = metres < 0
        made.gps["GPSAltitude"] = raw.rational(abs(metres) if kind == "whole" else None)
        digit = int(below) + made.pick(0, 2)
        if below or made.chance(0.8):
            undefined = raw.make_undefined(bytes([digit]))
            made.gps["GPSAltitudeRef"] = made.pick(raw.byte(digit), undefined)
    if made.chance(0.5):
        made.xmp["drone-dji:AbsoluteAltitude"] = number(made, metres, 2)
    if made.chance(0.5):
        made.xmp["drone-dji:RelativeAltitude"] = number(made, made.rng.uniform(10, 120), 2)


def put_gimbal(made: Made) -> None:
    yaw, pitch, roll = (round(float(v), 2) for v in made.rng.uniform([-180, -90, -5], [180, 0, 5]))
    made.gimbal = (yaw, pitch, roll)
    for name, value in zip(("Yaw", "Pitch", "Roll"), made.gimbal, strict=True):
        if made.chance(0.9):
            made.xmp[f"drone-dji:Gimbal{name}Degree"] = number(made, value, 2)


def put_focal(made: Made) -> None:
    """A sensor, a lens, fields of a camera, and then what a program made of them."""
    native = made.pick(*NATIVE)
    sensor = float(made.rng.uniform(6, 36))  # mm, the longer side
    focal = float(made.rng.uniform(0.5, 3.0))  # longest sides
    unit, mm = made.pick((2, 25.4), (3, 10.0), (None, 25.4))
    per_unit = native[0] / sensor * mm
    zoom = float(made.pick(1, 1, 1, 1, 2, 3.5))
    plane, film = made.chance(0.7), made.chance(0.7)
    width, height = native
    operation = made.pick("none", "none", "resized", "turned", "cropped")
    stated = native
    updated = made.chance(0.5)
    if operation == "resized":
        width, height = width // 2, height // 2
    elif operation == "turned":
        width, height = height, width
    elif operation == "cropped":
        plane = True
        width = width // 2
    if updated:
        stated = (width, height)
    made.size = (width, height)
    made.turned = operation == "turned" and not updated
    made.focal = focal * zoom * native[0] / max(native)
    if operation == "cropped":
        made.focal *= native[0] / max(made.size)
    diagonal = math.hypot(*native) / native[0] if native[0] / native[1] < 1.6 else 1.25
    if film:
        equivalent = focal * math.hypot(36, 24) / diagonal * made.pick(1, zoom)
        made.detail["FocalLengthIn35mmFilm"] = raw.short(round(equivalent))
    if plane:
        made.detail["FocalPlaneXResolution"] = raw.rational(per_unit * made.pick(1, zoom))
        if unit is not None:
            made.detail["FocalPlaneResolutionUnit"] = raw.short(unit)
    made.detail["FocalLength"] = raw.rational(focal * sensor, most=1000)
    if operation == "cropped" or made.chance(0.9):
        made.detail["ExifImageWidth"] = made.pick(raw.short, raw.long)(stated[0])
        made.detail["ExifImageHeight"] = made.pick(raw.short, raw.long)(stated[1])
    made.turned &= "ExifImageHeight" in made.detail
    made.coarse = not {"FocalPlaneXResolution", "ExifImageWidth"} <= made.detail.keys()
    if zoom != 1 or made.chance(0.4):
        made.detail["DigitalZoomRatio"] = raw.rational(
            zoom if zoom != 1 else made.pick(0.0, 1.0, None)
        )
    if zoom == 1 and operation != "cropped" and made.chance(0.3):
        made.xmp["drone-dji:CalibratedFocalLength"] = number(made, focal * native[0], 4)
        if made.chance(0.7):
            for axis, side in zip("XY", native, strict=True):
                made.xmp[f"drone-dji:CalibratedOpticalCenter{axis}"] = number(made, side / 2, 2)


def make(seed: int) -> Made:
    made = Made(np.random.default_rng(seed))
    for put in (put_position, put_altitude, put_gimbal, put_focal):
        put(made)
    return made


def wrong(made: Made, exif: Exif) -> list[str]:
    """Return what was read and is not true."""
    found = []
    if exif.position is not None:
        read = np.array(exif.position[:2])
        if np.abs(read - made.position).max() > 1e-5:
            found.append(f"position {read} is {made.position}")
        if not math.isnan(exif.position.altitude) and not math.isclose(
            exif.position.altitude, made.altitude, abs_tol=0.02
        ):
            found.append(f"altitude {exif.position.altitude} is {made.altitude}")
    if exif.gimbal is not None and (made.turned or not np.allclose(exif.gimbal, made.gimbal)):
        found.append(f"gimbal {exif.gimbal} is {made.gimbal}")
    focal = exif.relative_focal
    if focal is not None and abs(math.log(focal / made.focal)) > (0.15 if made.coarse else 0.02):
        found.append(f"focal length {focal} is {made.focal}")
    camera = exif.xmp.camera
    if camera is not None:
        focal = camera.focal[0] / max(camera.width, camera.height)
        if abs(math.log(focal / made.focal)) > 0.02:
            found.append(f"calibrated focal length {focal} is {made.focal}")
    return found


def read(made: Made, path: Path) -> Exif:
    packet = raw.xmp(made.xmp, elements=made.chance(0.5)) if made.xmp else b""
    raw.write(path, made.size, raw.exif(made.detail, made.gps), packet)
    return read_exif(path)


def test_what_is_read_is_true_or_unknown(tmp_path: Path) -> None:
    faults, known = [], np.zeros(4, int)
    for seed in range(COUNT):
        made = make(seed)
        exif = read(made, tmp_path / "a.jpg")
        faults += [f"{seed}: {fault}: {made}" for fault in wrong(made, exif)]
        where = exif.position
        known += [
            where is not None,
            where is not None and not math.isnan(where.altitude),
            exif.gimbal is not None or made.turned,
            exif.relative_focal is not None,
        ]
        if exif.relative_focal is None and "FocalLengthIn35mmFilm" in made.detail:
            assert any("FocalLength" in doubt or "cropped" in doubt for doubt in exif.doubts)
        if where is None and "GPSLatitude" in made.gps:
            assert any("GPSL" in doubt for doubt in exif.doubts), made
    assert not faults, "\n".join(faults[:5])
    # Most is known: a reader that knows nothing would be true, too.
    assert (known > [0.75 * COUNT, 0.55 * COUNT, 0.6 * COUNT, 0.3 * COUNT]).all(), known


@pytest.mark.parametrize("change", ["hemisphere", "place"])
def test_a_contradiction_is_no_position(tmp_path: Path, change: str) -> None:
    """XMP of the other hemisphere, or of a place a kilometre away."""
    for seed in range(40):
        made = make(seed)
        latitude, longitude = made.position
        said = (-latitude, longitude) if change == "hemisphere" else (latitude + 0.01, longitude)
        made.gps["GPSLatitude"] = raw.rational(abs(latitude))
        made.gps["GPSLongitude"] = raw.rational(abs(longitude))
        made.gps["GPSLatitudeRef"] = raw.text("N" if latitude >= 0 else "S")
        made.gps["GPSLongitudeRef"] = raw.text("E" if longitude >= 0 else "W")
        made.xmp = {
            "drone-dji:GpsLatitude": f"{said[0]:.8f}",
            "drone-dji:GpsLongitude": f"{said[1]:.8f}",
        }
        exif = read(made, tmp_path / "a.jpg")
        assert exif.position is None
        assert any("contradict" in doubt for doubt in exif.doubts)
