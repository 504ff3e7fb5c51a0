"""What a drone writes into a photograph as XMP: attitude, height, RTK, lens and shutter.

The fields are DJI's of the namespace ``drone-dji``, as the manuals of Mavic 3 and Matrice 4 list
them ("Photo File: XMP Data List"). Other makers that use the same names are read as well.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final
from xml.parsers import expat

import numpy as np

from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.quantities.numbers import parse_number

_RTK_FIXED: Final = 50
# Standard deviations (m) outside this range and numbers beyond the other one are damaged values.
_SIGMAS_M: Final = (1e-4, 1e3)
_MOST: Final = 1e6
# A longer text is none of the fields (characters).
_LONGEST: Final = 1000
# A principal point further from the middle, in sizes of the picture, belongs to another size.
_FARTHEST: Final = 0.1
# Fields that tell where a photograph was taken.
_PLACES: Final = (
    *("GpsLatitude", "GpsLongitude", "GpsLongtitude", "Latitude", "Longitude"),
    *("GPSLatitude", "GPSLongitude", "GPSAltitude", "GPSAltitudeRef"),
    *("AbsoluteAltitude", "RelativeAltitude"),
)


@dataclass(frozen=True)
class DroneXmp:
    """The fields of a photograph's XMP; each is None where it is missing or meaningless.

    Attributes:
        gimbal: yaw clockwise from north, pitch above the horizon and roll of the camera, degrees.
        places: the texts of its fields by name, from which position and altitude are read.
        rtk_sigma: standard deviations of the position to the east, north and up, metres, where it
            is a fixed solution of RTK.
        camera: calibration by the maker, of the picture in the size in which it was taken.
        sized: whether the optical centre shows that the calibration is of that size.
        speed: horizontal speed of the aircraft, m/s.
        shutter: kind of the shutter, such as ``Mechanical``.
    """

    gimbal: tuple[float, float, float] | None = None
    places: Mapping[str, str] = field(default_factory=dict)
    rtk_sigma: tuple[float, float, float] | None = None
    camera: Camera | None = None
    sized: bool = False
    speed: float | None = None
    shutter: str | None = None


def parse_xmp(packet: bytes, size: tuple[int, int]) -> DroneXmp:
    """Return the fields of an XMP packet, in which each is an attribute or an element.

    Of a damaged packet, what stands before the damage is read. So it is with a document type, which
    XMP does not have: no entity is ever expanded.

    Args:
        packet: the packet, in an encoding that XML declares.
        size: width and height of the picture when it was taken, pixels.
    """
    texts = _texts(packet)
    numbers = {name: value for name, text in texts.items() if (value := _number(text)) is not None}
    gimbal = _three(numbers, "Gimbal{}Degree", "Yaw", "Pitch", "Roll")
    sigma = _three(numbers, "RtkStd{}", "Lon", "Lat", "Hgt")
    fixed = numbers.get("RtkFlag") == _RTK_FIXED
    if sigma is not None and not (
        fixed and _SIGMAS_M[0] <= min(sigma) <= max(sigma) <= _SIGMAS_M[1]
    ):
        sigma = None
    velocity = [numbers.get(f"Flight{axis}Speed", math.nan) for axis in "XY"]
    return DroneXmp(
        gimbal=gimbal,
        places={name: texts[name] for name in _PLACES if name in texts},
        rtk_sigma=sigma,
        camera=_camera(numbers, texts.get("DewarpData", ""), size),
        sized=all(f"CalibratedOpticalCenter{axis}" in numbers for axis in "XY"),
        speed=math.hypot(*velocity) if np.isfinite(velocity).all() else None,
        shutter=texts.get("ShutterType"),
    )


def _texts(packet: bytes) -> dict[str, str]:
    """Return the texts of attributes and elements by their names without prefix."""
    found: dict[str, str] = {}
    inside: list[str] = []

    def start(_: str, attributes: dict[str, str]) -> None:
        inside.clear()
        found.update({k.rpartition(":")[2]: v[:_LONGEST].strip() for k, v in attributes.items()})

    def end(name: str) -> None:
        if text := "".join(inside)[:_LONGEST].strip():
            found[name.rpartition(":")[2]] = text
        inside.clear()

    def refuse(*_: object) -> None:
        raise ValueError("XMP has no document type")

    # Namespaces are not resolved, for programs that edit photographs lose their declarations.
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = inside.append
    parser.StartDoctypeDeclHandler = refuse
    with contextlib.suppress(expat.ExpatError, ValueError, LookupError):
        parser.Parse(packet.strip(b"\0\r\n\t "), True)
    return found


def _number(text: str) -> float | None:
    value = parse_number(text)
    return value if value is not None and abs(value) <= _MOST else None


def _three(
    numbers: Mapping[str, float], name: str, *parts: str
) -> tuple[float, float, float] | None:
    try:
        first, second, third = (numbers[name.format(part)] for part in parts)
    except KeyError:
        return None
    return first, second, third


def _camera(numbers: Mapping[str, float], dewarp: str, size: tuple[int, int]) -> Camera | None:
    """Return the lens as it was measured, else as it was designed.

    A picture that was dewarped has the designed lens, without distortion.
    """
    width, height = size
    focal = numbers.get("CalibratedFocalLength", 0.0)
    x, y = (
        numbers.get(f"CalibratedOpticalCenter{a}", s / 2) for a, s in zip("XY", size, strict=True)
    )
    if not _amid(x - width / 2, y - height / 2, size):
        return None
    if numbers.get("DewarpFlag") != 1 and (measured := _measured(dewarp, size)) is not None:
        return measured
    return Camera("SIMPLE_PINHOLE", width, height, (focal, x, y)) if focal > 0 else None


def _measured(dewarp: str, size: tuple[int, int]) -> Camera | None:
    """Return the camera of ``date;fx,fy,cx,cy,k1,k2,p1,p2,k3``, cx and cy from the middle.

    The coefficients are OpenCV's, and so is the camera.
    """
    try:
        fx, fy, x, y, k1, k2, p1, p2, k3 = map(float, dewarp.rpartition(";")[2].split(","))
        if not _amid(x, y, size):
            return None
        params = (fx, fy, size[0] / 2 + x, size[1] / 2 + y, k1, k2, p1, p2)
        if k3 == 0:
            return Camera("OPENCV", *size, params)
        return Camera("FULL_OPENCV", *size, (*params, k3, 0.0, 0.0, 0.0))
    except (ValueError, ArithmeticError, InputError):
        return None


def _amid(x: float, y: float, size: tuple[int, int]) -> bool:
    """Return whether a point (x, y) from the middle of a picture can be its principal point."""
    return abs(x) <= _FARTHEST * size[0] and abs(y) <= _FARTHEST * size[1]
