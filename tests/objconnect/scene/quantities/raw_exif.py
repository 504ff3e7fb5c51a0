"""JPEGs with any EXIF and XMP, written byte by byte."""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image

Field = tuple[int, int, bytes]
"""Type, number of values and their bytes, little-endian."""

GPS = {
    "GPSLatitudeRef": 1, "GPSLatitude": 2, "GPSLongitudeRef": 3, "GPSLongitude": 4,
    "GPSAltitudeRef": 5, "GPSAltitude": 6, "GPSStatus": 9, "GPSMapDatum": 18,
}  # fmt: skip
DETAIL = {
    "ExifVersion": 0x9000, "DateTimeOriginal": 0x9003, "FocalLength": 0x920A,
    "ExifImageWidth": 0xA002, "ExifImageHeight": 0xA003, "FocalPlaneXResolution": 0xA20E,
    "FocalPlaneYResolution": 0xA20F, "FocalPlaneResolutionUnit": 0xA210, "DigitalZoomRatio": 0xA404,
    "FocalLengthIn35mmFilm": 0xA405,
}  # fmt: skip


def text(value: str | bytes) -> Field:
    """Return a text with its zero byte."""
    raw = (value if isinstance(value, bytes) else value.encode()) + b"\0"
    return 2, len(raw), raw


def byte(*values: int) -> Field:
    return 1, len(values), bytes(values)


def make_undefined(raw: bytes) -> Field:
    return 7, len(raw), raw


def short(*values: int) -> Field:
    return 3, len(values), struct.pack(f"<{len(values)}H", *values)


def long(*values: int) -> Field:
    return 4, len(values), struct.pack(f"<{len(values)}I", *values)


def rational(*values: float | None, most: int = 10_000_000) -> Field:
    """Return rationals; None is 0/0."""
    pairs = [(0, 0) if v is None else _fraction(v, most) for v in values]
    return 5, len(pairs), b"".join(struct.pack("<II", *pair) for pair in pairs)


def sign(*values: float, most: int = 1_000_000) -> Field:
    pairs = [_fraction(v, most) for v in values]
    return 10, len(pairs), b"".join(struct.pack("<ii", *pair) for pair in pairs)


def _fraction(value: float, most: int) -> tuple[int, int]:
    fraction = Fraction(value).limit_denominator(int(min(most, 2e9 / max(abs(value), 1))))
    return fraction.numerator, fraction.denominator


def exif(detail: Mapping[str, Field], gps: Mapping[str, Field]) -> bytes:
    """Return the segment of EXIF with two directories."""
    first = {0x8769: long(0), 0x8825: long(0)}
    at = 8 + len(_directory(first, 8))
    inner = _directory({DETAIL[name]: field for name, field in detail.items()}, at)
    first = {0x8769: long(at), 0x8825: long(at + len(inner))}
    places = _directory({GPS[name]: field for name, field in gps.items()}, at + len(inner))
    return b"Exif\0\0II*\0\x08\0\0\0" + _directory(first, 8) + inner + places


def _directory(fields: Mapping[int, Field], start: int) -> bytes:
    body, extra = struct.pack("<H", len(fields)), b""
    after = start + 2 + 12 * len(fields) + 4
    for tag, (kind, count, data) in sorted(fields.items()):
        if len(data) <= 4:
            value = data.ljust(4, b"\0")
        else:
            value = struct.pack("<I", after + len(extra))
            extra += data + b"\0" * (len(data) % 2)
        body += struct.pack("<HHI", tag, kind, count) + value
    return body + b"\0\0\0\0" + extra


def xmp(fields: Mapping[str, str], *, elements: bool = False) -> bytes:
    """Return a packet of fields, whose names have their prefix."""
    spaces = {
        "drone-dji": "http://www.dji.com/drone-dji/1.0/",
        "exif": "http://ns.adobe.com/exif/1.0/",
    }
    declared = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in spaces.items())
    rdf = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
    inside = "".join(f"<{k}>{v}</{k}>" for k, v in fields.items()) if elements else ""
    said = "" if elements else " ".join(f'{k}="{v}"' for k, v in fields.items())
    return (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="{rdf}"><rdf:Description '
        f"{declared} {said}>{inside}</rdf:Description></rdf:RDF></x:xmpmeta>"
    ).encode()


def write(path: Path, size: tuple[int, int], segment: bytes, packet: bytes = b"") -> None:
    """Write a grey JPEG with both."""
    stream = io.BytesIO()
    Image.fromarray(np.full((size[1], size[0]), 128, np.uint8)).save(stream, "JPEG", quality=10)
    plain, segments = stream.getvalue(), [segment]
    if packet:
        segments.append(b"http://ns.adobe.com/xap/1.0/\0" + packet)
    head = b"".join(b"\xff\xe1" + struct.pack(">H", len(s) + 2) + s for s in segments)
    path.write_bytes(plain[:2] + head + plain[2:])
