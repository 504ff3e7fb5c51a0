"""The XMP of a drone's photograph: attitude, position, RTK, lens, speed, shutter and panorama.

The fields are DJI's in the namespace ``drone-dji``, listed in the manuals of Mavic 3 and Matrice 4
("Photo File: XMP Data List"). Autel's have the same names and meaning. Attitudes in namespaces of
other makers are not read, because their axes are not known.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final
from xml.parsers import expat

import numpy as np

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.quantities.numbers import parse_number

# Value of RtkFlag for a fixed solution.
_RTK_FIXED: Final = 50
# Plausible range of standard deviations (m), and largest plausible number.
_SIGMAS_M: Final = (1e-4, 1e3)
_MAX_NUMBER: Final = 1e6
# Longest text of a field (characters).
_MAX_TEXT: Final = 1000
# Largest distance of a principal point from the middle, as a share of the picture's side.
_MAX_OFFSET: Final = 0.1
# Fields of attitudes, and the namespaces and prefixes in which they have DJI's meaning.
_ATTITUDE: Final = re.compile(r"Gimbal(Yaw|Pitch|Roll)Degree")
_DJI_NAMESPACE: Final = re.compile(r"dji|autel|^(drone)?:", re.IGNORECASE)
LARGEST_ANGLES: Final = (360.0, 180.0, 360.0)
"""Largest absolute angles (yaw, pitch, roll; degrees)."""

# Elements with fields of other pictures, or of places that an editing program adds.
_OTHER_PICTURES: Final = re.compile(
    r"(.*:)?(LocationShown|LocationCreated|Pantry|Ingredients|History)"
)
# Fields of position and altitude.
_POSITION_FIELDS: Final = (
    *("GpsLatitude", "GpsLongitude", "GpsLongtitude", "Latitude", "Longitude"),
    *("GPSLatitude", "GPSLongitude", "GPSAltitude", "GPSAltitudeRef"),
    *("AbsoluteAltitude", "RelativeAltitude"),
)


@dataclass(frozen=True)
class DroneXmp:
    """The fields of a photograph's XMP; missing and invalid ones are None.

    Attributes:
        gimbal: yaw clockwise from north, pitch above the horizon and roll of the camera, degrees.
        position_texts: texts of the fields of position and altitude by name.
        rtk_sigma: standard deviations of the position to the east, north and up, metres, for a
            fixed RTK solution.
        camera: calibration by the maker, for the size in which the picture was taken.
        size_confirmed: whether the optical centre is stated. If ``camera`` is not None, the centre
            then fits the size in which the picture was taken.
        speed: horizontal speed of the aircraft, m/s.
        shutter: kind of the shutter, such as ``Mechanical``.
        panorama: projection of a panorama, such as ``equirectangular``.
        doubts: why a stated attitude is not used.
    """

    gimbal: tuple[float, float, float] | None = None
    position_texts: Mapping[str, str] = field(default_factory=dict)
    rtk_sigma: tuple[float, float, float] | None = None
    camera: Camera | None = None
    size_confirmed: bool = False
    speed: float | None = None
    shutter: str | None = None
    panorama: str | None = None
    doubts: tuple[str, ...] = ()


def parse_xmp(packets: bytes | Sequence[bytes], size: tuple[int, int]) -> DroneXmp:
    """Return the fields of XMP packets; a field is an attribute or an element.

    A field with several values is invalid. Reading stops at damage and at a document type
    declaration, which XMP does not have, so that no declared entity is expanded.

    Args:
        packets: one or several packets, in an encoding that XML declares.
        size: width and height of the picture when it was taken, pixels.
    """
    texts: dict[str, str] = {}
    foreign: set[str] = set()
    for packet in [packets] if isinstance(packets, bytes) else packets:
        _FieldParser(texts, foreign).read(packet)
    numbers = {
        name: value for name, text in texts.items() if (value := _parse_plausible(text)) is not None
    }
    gimbal, doubts = _gimbal(numbers, texts, foreign)
    sigma = _read_three(numbers, "RtkStd{}", "Lon", "Lat", "Hgt")
    fixed = numbers.get("RtkFlag") == _RTK_FIXED
    if sigma is not None and not (
        fixed and _SIGMAS_M[0] <= min(sigma) <= max(sigma) <= _SIGMAS_M[1]
    ):
        sigma = None
    velocity = [numbers.get(f"Flight{axis}Speed", math.nan) for axis in "XY"]
    return DroneXmp(
        gimbal=gimbal,
        position_texts={name: texts[name] for name in _POSITION_FIELDS if name in texts},
        rtk_sigma=sigma,
        camera=_camera(numbers, texts.get("DewarpData", ""), size),
        size_confirmed=all(f"CalibratedOpticalCenter{axis}" in numbers for axis in "XY"),
        speed=math.hypot(*velocity) if np.isfinite(velocity).all() else None,
        shutter=texts.get("ShutterType"),
        panorama=texts.get("ProjectionType"),
        doubts=doubts,
    )


class _FieldParser:
    """A parser that collects attributes and elements of packets by name without prefix.

    Attributes:
        texts: texts by name; two values that differ are joined.
        foreign: names with prefix of attitudes in namespaces of other makers.
    """

    def __init__(self, texts: dict[str, str], foreign: set[str]) -> None:
        self.texts, self.foreign = texts, foreign
        self._namespaces: dict[str, str] = {}
        self._text: list[str] = []
        self._other_depth = 0  # levels of nested elements inside one of ``_OTHER_PICTURES``

    def read(self, packet: bytes) -> None:
        """Add the fields of a packet; if it is damaged, only those before the damage."""
        # Namespaces are not resolved, because editing programs lose their declarations.
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler = self._text.append
        parser.StartDoctypeDeclHandler = self._refuse
        with contextlib.suppress(expat.ExpatError, ValueError, LookupError):
            parser.Parse(packet.strip(b"\0\r\n\t "), True)

    def _start(self, element: str, attributes: dict[str, str]) -> None:
        self._text.clear()
        self._other_depth += self._other_depth > 0 or _OTHER_PICTURES.fullmatch(element) is not None
        for name, value in attributes.items():
            if name.startswith("xmlns:"):
                self._namespaces[name.partition(":")[2]] = value
        for name, value in attributes.items():
            self._add(name, value)

    def _end(self, element: str) -> None:
        if text := "".join(self._text).strip():
            self._add(element, text)
        self._text.clear()
        self._other_depth -= self._other_depth > 0

    def _add(self, name: str, value: str) -> None:
        prefix, _, local = name.rpartition(":")
        value = value[:_MAX_TEXT].strip()
        if self._other_depth:
            return
        if _ATTITUDE.fullmatch(local) and not _DJI_NAMESPACE.search(
            f"{prefix}:{self._namespaces.get(prefix, '')}"
        ):
            self.foreign.add(f"{prefix}:{local}")
            return
        old = self.texts.get(local, value)
        number = parse_number(value)
        same = old == value or (number is not None and parse_number(old) == number)
        self.texts[local] = old if same else f"{old} and {value}"[:_MAX_TEXT]

    def _refuse(self, *_: object) -> None:
        raise ValueError("XMP has no document type")


def _gimbal(
    numbers: Mapping[str, float], texts: Mapping[str, str], foreign: set[str]
) -> tuple[tuple[float, float, float] | None, tuple[str, ...]]:
    """Return yaw, pitch and roll, and the reason why stated ones are not used."""
    names = [f"Gimbal{part}Degree" for part in ("Yaw", "Pitch", "Roll")]
    bad = [
        f"{name} {texts[name][:40]!r} is not an angle"
        for name, most in zip(names, LARGEST_ANGLES, strict=True)
        if name in texts and not abs(numbers.get(name, math.nan)) <= most
    ]
    if bad:
        return None, (bad[0],)
    angles = _read_three(numbers, "Gimbal{}Degree", "Yaw", "Pitch", "Roll")
    if angles is None and foreign:
        return None, (f"{min(foreign)} is not DJI's, and its axes are not known",)
    return angles, ()


def _parse_plausible(text: str) -> float | None:
    value = parse_number(text)
    return value if value is not None and abs(value) <= _MAX_NUMBER else None


def _read_three(
    numbers: Mapping[str, float], name: str, *parts: str
) -> tuple[float, float, float] | None:
    try:
        first, second, third = (numbers[name.format(part)] for part in parts)
    except KeyError:
        return None
    return first, second, third


def _camera(numbers: Mapping[str, float], dewarp: str, size: tuple[int, int]) -> Camera | None:
    """Return the measured calibration, else the nominal one.

    A dewarped picture has the nominal focal length without distortion.
    """
    width, height = size
    focal = numbers.get("CalibratedFocalLength", 0.0)
    x, y = (
        numbers.get(f"CalibratedOpticalCenter{a}", s / 2) for a, s in zip("XY", size, strict=True)
    )
    if not _is_near_middle(x - width / 2, y - height / 2, size):
        return None
    if numbers.get("DewarpFlag") != 1 and (measured := _parse_dewarp(dewarp, size)) is not None:
        return measured
    return Camera("SIMPLE_PINHOLE", width, height, (focal, x, y)) if focal > 0 else None


def _parse_dewarp(dewarp: str, size: tuple[int, int]) -> Camera | None:
    """Return the camera of ``date;fx,fy,cx,cy,k1,k2,p1,p2,k3``, with (cx, cy) from the middle."""
    try:
        fx, fy, x, y, k1, k2, p1, p2, k3 = map(float, dewarp.rpartition(";")[2].split(","))
        if not _is_near_middle(x, y, size):
            return None
        params = (fx, fy, size[0] / 2 + x, size[1] / 2 + y, k1, k2, p1, p2)
        if k3 == 0:
            return Camera("OPENCV", *size, params)
        return Camera("FULL_OPENCV", *size, (*params, k3, 0.0, 0.0, 0.0))
    except (ValueError, ArithmeticError, InputError):
        return None


def _is_near_middle(x: float, y: float, size: tuple[int, int]) -> bool:
    """Return whether (x, y) from the middle of a picture is a plausible principal point."""
    return abs(x) <= _MAX_OFFSET * size[0] and abs(y) <= _MAX_OFFSET * size[1]
