"""Photographs: reading with one clear error, writing as a drone does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.TiffImagePlugin import IFDRational

from scene.camera import Camera
from scene.errors import InputError
from scene.files import written_whole
from scene.geodesy import Geodetic


def read_rgb(path: Path, camera: Camera | None = None) -> NDArray[np.uint8]:
    """Read a photograph as stored, (H, W, 3) uint8 RGB; an EXIF rotation is not applied.

    Args:
        path: the file.
        camera: when given, the size the photograph must have.

    Raises:
        InputError: missing, truncated, not an image, or not the size of ``camera``.
    """
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"))
    except FileNotFoundError:
        raise InputError(f"image {path} does not exist") from None
    except UnidentifiedImageError:
        raise InputError(f"{path} is not an image this program can read") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"image {path} is damaged: {error}") from None
    if camera is not None and pixels.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"image {path} is {pixels.shape[1]} x {pixels.shape[0]} pixels but its camera is "
            f"{camera.width} x {camera.height}: resize the image or use its own calibration"
        )
    return pixels


def check_photographs(root: Path, cameras: Mapping[str, Camera]) -> None:
    """Make sure photographs are there, whole, and of the size of their cameras.

    COLMAP skips what it cannot read and decodes half of a truncated file without a word.

    Args:
        root: folder the names are relative to.
        cameras: by image name.

    Raises:
        InputError: as ``read_rgb``, about the first photograph at fault.
    """
    for name, camera in cameras.items():
        read_rgb(root / name, camera)


@dataclass(frozen=True)
class Exif:
    """What a drone writes into a photograph.

    Attributes:
        position: where the aircraft believes it was, or None.
        time: when, or None.
        make: of the camera.
        model: of the camera.
        focal_35mm: focal length in millimetres of a 36 mm wide film, or None.
    """

    position: Geodetic | None
    time: datetime | None
    make: str = "ObjConnect"
    model: str = "simulated camera"
    focal_35mm: float | None = None


def write_jpeg(path: Path, rgb: NDArray[np.uint8], exif: Exif, quality: int = 95) -> None:
    """Write a photograph with EXIF. ``rgb`` is (H, W, 3) uint8.

    Chroma is kept at full resolution, so that compression costs features little.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    with written_whole(path) as partial:
        Image.fromarray(rgb).save(
            partial, "JPEG", quality=quality, subsampling=0, exif=_encode(exif).tobytes()
        )


def _encode(exif: Exif) -> Image.Exif:
    tags = Image.Exif()
    tags[ExifTags.Base.Make] = exif.make
    tags[ExifTags.Base.Model] = exif.model
    detail = tags.get_ifd(ExifTags.IFD.Exif)
    if exif.time is not None:
        stamp = exif.time.astimezone(UTC).strftime("%Y:%m:%d %H:%M:%S")
        tags[ExifTags.Base.DateTime] = stamp
        detail[ExifTags.Base.DateTimeOriginal] = stamp
        detail[ExifTags.Base.OffsetTimeOriginal] = "+00:00"
    if exif.focal_35mm is not None:
        detail[ExifTags.Base.FocalLength] = _rational(exif.focal_35mm)
        detail[ExifTags.Base.FocalLengthIn35mmFilm] = round(exif.focal_35mm)
    if exif.position is not None:
        gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
        place = exif.position
        gps[ExifTags.GPS.GPSLatitudeRef] = "N" if place.latitude >= 0 else "S"
        gps[ExifTags.GPS.GPSLatitude] = _sexagesimal(abs(place.latitude))
        gps[ExifTags.GPS.GPSLongitudeRef] = "E" if place.longitude >= 0 else "W"
        gps[ExifTags.GPS.GPSLongitude] = _sexagesimal(abs(place.longitude))
        gps[ExifTags.GPS.GPSAltitudeRef] = b"\x00" if place.altitude >= 0 else b"\x01"
        gps[ExifTags.GPS.GPSAltitude] = _rational(abs(place.altitude))
    return tags


def read_exif(path: Path) -> Exif:
    """Read what a drone wrote; fields it did not write are None.

    Raises:
        InputError: missing file or not an image.
    """
    try:
        with Image.open(path) as image:
            tags = image.getexif()
    except FileNotFoundError:
        raise InputError(f"image {path} does not exist") from None
    except (OSError, SyntaxError) as error:
        raise InputError(f"{path} is not an image this program can read: {error}") from None
    detail = tags.get_ifd(ExifTags.IFD.Exif)
    stamp = detail.get(ExifTags.Base.DateTimeOriginal)
    focal = detail.get(ExifTags.Base.FocalLengthIn35mmFilm)
    return Exif(
        position=_decode_position(tags.get_ifd(ExifTags.IFD.GPSInfo)),
        time=_decode_time(stamp),
        make=str(tags.get(ExifTags.Base.Make, "")),
        model=str(tags.get(ExifTags.Base.Model, "")),
        focal_35mm=float(focal) if focal else None,
    )


def _decode_time(stamp: object) -> datetime | None:
    try:
        return datetime.strptime(str(stamp), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None


def _decode_position(gps: dict[int, object]) -> Geodetic | None:
    def angle(tag: int, reference: int, negative: str) -> float | None:
        parts = gps.get(tag)
        if not isinstance(parts, tuple) or len(parts) != 3:
            return None
        degrees = float(sum(float(part) / 60**k for k, part in enumerate(parts)))
        return -degrees if gps.get(reference) == negative else degrees

    try:
        latitude: float | None = angle(ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLatitudeRef, "S")
        longitude = angle(ExifTags.GPS.GPSLongitude, ExifTags.GPS.GPSLongitudeRef, "W")
        altitude = float(str(gps.get(ExifTags.GPS.GPSAltitude, 0.0)))
    except (ValueError, ZeroDivisionError):
        return None
    if latitude is None or longitude is None:
        return None
    # A receiver without a fix writes 0/0, which reads as NaN.
    if not (abs(latitude) <= 90 and abs(longitude) <= 180):
        return None
    if not math.isfinite(altitude):
        altitude = 0.0
    below = gps.get(ExifTags.GPS.GPSAltitudeRef) in (b"\x01", 1)
    return Geodetic(latitude, longitude, -altitude if below else altitude)


def _rational(value: float, denominator: int = 10_000) -> IFDRational:
    return IFDRational(Fraction(round(value * denominator), denominator))


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    whole = int(degrees)
    minutes = (degrees - whole) * 60
    seconds = (minutes - int(minutes)) * 60
    return _rational(whole, 1), _rational(int(minutes), 1), _rational(seconds)
