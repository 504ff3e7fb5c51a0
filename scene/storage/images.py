"""Photographs: reading with one clear error, writing with the EXIF of a drone."""

from __future__ import annotations

import math
import shutil
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError
from PIL.TiffImagePlugin import IFDRational

from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.geodesy import Geodetic
from scene.storage.atomic import atomic_write
from scene.storage.files import require_readable
from scene.storage.xmp import DroneXmp, parse_xmp

# The exceptions that libraries raise on a damaged image or EXIF.
_DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
)
# A file of a few bytes may claim any size. Pillow refuses twice the number that it warns of.
_MOST_PIXELS: Final = 2 * (Image.MAX_IMAGE_PIXELS or 0)
# Pillow's warnings about large images and damaged EXIF do not help the user of a command.
warnings.filterwarnings("ignore", module=r"PIL\.")
# The largest payload of a segment of a JPEG, with its identifier (bytes).
_SEGMENT: Final = 65_500
# Focal lengths outside this range (mm) and altitudes above this one (m) are damaged values.
_FOCAL_MM: Final = (1.0, 10_000.0)
_MAX_ALTITUDE_M: Final = 1e6
# The size of 35 mm film, for which equivalent focal lengths are given (mm).
_FILM_LENGTH = 36.0
_FILM_DIAGONAL = math.hypot(36, 24)
# Images with a larger aspect ratio are much wider than 3:2.
_WIDE = 1.6
# EXIF's units of resolution, millimetres.
_CENTIMETRE = 3
_MILLIMETRES = {2: 25.4, _CENTIMETRE: 10.0}


def read_rgb(path: Path, camera: Camera | None = None) -> NDArray[np.uint8]:
    """Read a photograph as stored, (H, W, 3) uint8 RGB; an EXIF rotation is not applied.

    Grey values of more than 8 bits are scaled from the smallest to the largest value of the
    photograph, because thermal and machine vision cameras use a small part of their range.

    Args:
        path: file to read.
        camera: if given, the photograph must have the size of this camera.

    Raises:
        InputError: the file is missing, not a regular file, truncated, not an image, of more than
            179 million pixels, or not of the size of ``camera``.
    """
    with _opened(path) as image:
        if image.mode.startswith(("I", "F")):
            pixels = _stretched(np.asarray(image), path)
        else:
            pixels = np.asarray(image.convert("RGB"))
    if camera is not None and pixels.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"image {path} is {pixels.shape[1]} x {pixels.shape[0]} pixels but its camera is "
            f"{camera.width} x {camera.height}: resize the image or use its own calibration"
        )
    return pixels


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image file; errors of the block are reported like those of opening it."""
    if not path.exists() and not path.is_symlink():
        hint = ": the model it is named in was made on Windows" if "\\" in path.name else ""
        raise InputError(f"image {path} does not exist{hint}")
    require_readable(path, "image")
    try:
        with Image.open(path) as image:
            yield image
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{path} is not an image this program can read") from None
    except Image.DecompressionBombError:
        raise InputError(
            f"image {path} has more than {_MOST_PIXELS / 1e6:.0f} million pixels: make it smaller"
        ) from None
    except _DAMAGE as error:
        raise InputError(f"image {path} is damaged: {error}") from None


def _stretched(grey: NDArray[Any], path: Path) -> NDArray[np.uint8]:
    """Scale grey values (H, W) of any type from their range to 0..255, (H, W, 3) uint8."""
    values = grey.astype(np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"image {path} has values that are not finite")
    low, high = values.min(), values.max()
    scaled = (values - low) * (255 / (high - low) if high > low else 0.0)
    return np.repeat(np.rint(scaled).astype(np.uint8)[..., None], 3, axis=-1)


def check_photographs(root: Path, cameras: Mapping[str, Camera]) -> None:
    """Make sure that photographs exist, are whole, and have the size of their cameras.

    COLMAP silently skips what it cannot read, and decodes half of a truncated file.

    Args:
        root: folder that the names are relative to.
        cameras: cameras by image name.

    Raises:
        InputError: as for ``read_rgb``, about the first photograph with a fault.
    """
    for name, camera in cameras.items():
        read_rgb(root / name, camera)


@dataclass(frozen=True)
class Exif:
    """The metadata that a drone writes into a photograph.

    Attributes:
        position: measured position of the aircraft, or None.
        time: time of the photograph, or None.
        make: maker of the camera.
        model: model of the camera.
        focal_35mm: focal length in millimetres for film whose longer side is 36 mm, or None.
        xmp: what the drone wrote into the XMP; it is read only.
    """

    position: Geodetic | None
    time: datetime | None
    make: str = "ObjConnect"
    model: str = "simulated camera"
    focal_35mm: float | None = None
    xmp: DroneXmp = field(default_factory=DroneXmp)

    @property
    def gimbal(self) -> tuple[float, float, float] | None:
        """Return yaw clockwise from north, pitch above the horizon and roll of the camera, degrees;
        None if unknown."""
        return self.xmp.gimbal

    @property
    def focal_in_longest_sides(self) -> float | None:
        """Return the focal length in longest sides of the picture; None if unknown."""
        return None if self.focal_35mm is None else self.focal_35mm / _FILM_LENGTH


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of a photograph as stored, pixels.

    Raises:
        InputError: the file is missing or not an image.
    """
    with _opened(path) as image:
        return image.size


def write_jpeg(path: Path, rgb: NDArray[np.uint8], exif: Exif, quality: int = 95) -> None:
    """Write a photograph (H, W, 3) uint8 with EXIF.

    Chroma is not subsampled, so that the compression has little effect on features.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    with atomic_write(path) as partial:
        Image.fromarray(rgb).save(
            partial,
            "JPEG",
            quality=quality,
            subsampling=0,
            exif=_encode(exif, (rgb.shape[1], rgb.shape[0])).tobytes(),
        )


def write_resized(source: Path, out: Path, longest: int, *, over: bool = False) -> None:
    """Copy a photograph with its metadata, at most ``longest`` pixels wide and high.

    Args:
        source: photograph to copy.
        out: JPEG to write.
        longest: largest width and height, pixels.
        over: rotate the image by 180 degrees.

    Raises:
        InputError: the photograph is missing or damaged, or ``out`` cannot be written.
    """
    rgb = read_rgb(source)
    height, width = rgb.shape[:2]
    scale = min(1.0, longest / max(width, height))
    with atomic_write(out) as partial:
        if scale == 1 and not over:
            shutil.copyfile(source, partial)
            return
        size = (round(scale * width), round(scale * height))
        with _opened(source) as original:
            kept = {key: original.info[key] for key in ("exif", "xmp") if key in original.info}
        if len(kept.get("xmp", b"")) > _SEGMENT:
            del kept["xmp"]
        if len(kept.get("exif", b"")) > _SEGMENT:  # thumbnails or maker notes
            kept["exif"] = _encode(read_exif(source), size).tobytes()
        picture = Image.fromarray(rgb[::-1, ::-1] if over else rgb)
        smaller = picture.resize(size, Image.Resampling.LANCZOS)
        smaller.save(partial, "JPEG", quality=95, subsampling=0, **kept)


def _encode(exif: Exif, size: tuple[int, int]) -> Image.Exif:
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
        # The tag above holds whole millimetres only; the pixel pitch gives the exact value.
        detail[ExifTags.Base.FocalPlaneXResolution] = _rational(10 * max(size) / _FILM_LENGTH)
        detail[ExifTags.Base.FocalPlaneResolutionUnit] = _CENTIMETRE
        detail[ExifTags.Base.ExifImageWidth] = size[0]
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
    """Read a photograph's metadata; fields that are missing or meaningless are None.

    Raises:
        InputError: the file is missing or not an image.
    """
    with _opened(path) as image:
        size, xmp = image.size, image.info.get("xmp", b"")
        try:
            tags = image.getexif()
            detail = tags.get_ifd(ExifTags.IFD.Exif)
            gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
        except _DAMAGE:  # the image itself may be whole
            tags, detail, gps = Image.Exif(), {}, {}
    stamp = detail.get(ExifTags.Base.DateTimeOriginal)
    packet = xmp if isinstance(xmp, bytes) else str(xmp).encode()
    drone = parse_xmp(packet, _size_taken(detail, size))
    return Exif(
        position=_decode_position(gps, drone.altitude),
        time=_decode_time(
            stamp,
            detail.get(ExifTags.Base.SubsecTimeOriginal),
            detail.get(ExifTags.Base.OffsetTimeOriginal),
        ),
        make=_text(tags.get(ExifTags.Base.Make)),
        model=_text(tags.get(ExifTags.Base.Model)),
        focal_35mm=_decode_focal(detail, size),
        xmp=drone,
    )


def _text(value: object) -> str:
    """Return a text field without the zero bytes that cameras pad it with."""
    return str(value or "").strip("\0 ")


def _decode_focal(detail: dict[int, Any], size: tuple[int, int]) -> float | None:
    """Return the focal length in millimetres for film whose longer side is 36 mm.

    It is computed from the pixel pitch if the camera gives it, else from the 35 mm equivalent.
    """
    try:
        unit = _MILLIMETRES[int(detail.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))]
        pitch = unit / float(detail[ExifTags.Base.FocalPlaneXResolution])
        sensor = pitch * float(detail[ExifTags.Base.ExifImageWidth])
        # The longer side of the film is that of the picture, upright or not.
        in_widths = float(detail[ExifTags.Base.FocalLength]) / sensor
        focal = _FILM_LENGTH * in_widths * size[0] / max(size)
    except _DAMAGE:
        focal = math.nan
    if _FOCAL_MM[0] <= focal <= _FOCAL_MM[1]:
        return focal
    try:
        focal = float(detail[ExifTags.Base.FocalLengthIn35mmFilm])
    except _DAMAGE:
        return None
    if not _FOCAL_MM[0] <= focal <= _FOCAL_MM[1]:
        return None
    # The equivalent refers to the diagonal (CIPA DCG-001); wide images are crops of 4:3 sensors.
    aspect = max(size) / min(size)
    diagonal = math.hypot(1, 1 / aspect) if aspect < _WIDE else math.hypot(1, 3 / 4)
    return focal * _FILM_LENGTH / _FILM_DIAGONAL * diagonal


def _size_taken(detail: dict[int, Any], size: tuple[int, int]) -> tuple[int, int]:
    """Return the size in which a photograph was taken; programs that resize it keep the tags."""
    try:
        width = int(detail[ExifTags.Base.ExifImageWidth])
        height = int(detail[ExifTags.Base.ExifImageHeight])
    except _DAMAGE:
        return size
    return (width, height) if min(width, height) > 0 else size


def _decode_time(stamp: object, fraction: object, offset: object) -> datetime | None:
    """Return a time stamp in UTC, with the decimal fraction of a second if the camera gives one.

    Without an offset from UTC, as drones often write none, the time counts as UTC.
    """
    digits = _text(fraction)
    try:
        whole = datetime.strptime(str(stamp), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
        with suppress(ValueError):
            whole = datetime.strptime(f"{stamp}{_text(offset)}", "%Y:%m:%d %H:%M:%S%z")
        whole = whole.astimezone(UTC)
        return whole + timedelta(seconds=float(f"0.{digits}") if digits.isdecimal() else 0)
    except (ValueError, OverflowError):  # a datetime ends with the year 9999
        return None


def _decode_position(gps: dict[int, object], altitude_m: float | None) -> Geodetic | None:
    """Return the position; ``altitude_m`` stands where EXIF has none."""

    def angle(tag: int, reference: int, negative: str) -> float | None:
        parts = gps.get(tag)
        if not isinstance(parts, tuple) or len(parts) != 3:
            return None
        degrees = float(sum(float(part) / 60**k for k, part in enumerate(parts)))
        return -degrees if gps.get(reference) == negative else degrees

    try:
        latitude: float | None = angle(ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLatitudeRef, "S")
        longitude = angle(ExifTags.GPS.GPSLongitude, ExifTags.GPS.GPSLongitudeRef, "W")
        altitude = float(str(gps.get(ExifTags.GPS.GPSAltitude, math.nan)))
    except _DAMAGE:
        return None
    if latitude is None or longitude is None:
        return None
    # A receiver without a fix writes 0/0, which reads as NaN, or latitude and longitude of zero.
    if not (abs(latitude) <= 90 and abs(longitude) <= 180) or latitude == longitude == 0:
        return None
    if gps.get(ExifTags.GPS.GPSAltitudeRef) in (b"\x01", 1):
        altitude = -altitude
    if not abs(altitude) <= _MAX_ALTITUDE_M:
        altitude = altitude_m or 0.0
    return Geodetic(latitude, longitude, altitude)


def _rational(value: float, denominator: int = 10_000) -> IFDRational:
    return IFDRational(Fraction(round(value * denominator), denominator))


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    whole = int(degrees)
    minutes = (degrees - whole) * 60
    seconds = (minutes - int(minutes)) * 60
    return _rational(whole, 1), _rational(int(minutes), 1), _rational(seconds)
