"""Metadata of photographs (EXIF and XMP): reading, and writing of photographs with EXIF."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.quantities.altitudes import SEA_LEVEL_DOUBT, read_altitude
from objconnect.scene.quantities.focal import (
    FILM_LENGTH,
    FocalLength,
    Lens,
    is_rotated,
    read_exif_size,
    read_focal,
)
from objconnect.scene.quantities.positions import read_position
from objconnect.scene.quantities.reading import unknown
from objconnect.scene.quantities.times import read_time
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import DAMAGE, open_image, read_rgb
from objconnect.scene.storage.xmp import DroneXmp, parse_xmp

# Largest payload of a JPEG segment with its identifier (bytes).
_MAX_SEGMENT_BYTES: Final = 65_500
_TWO_BLOCKS: Final = "the file has two blocks of EXIF that differ, and the first is taken"
# Denominator of the numbers that we write.
_DENOMINATOR: Final = 10_000
# Identifier of an XMP segment.
_XMP_IDENTIFIER: Final = b"http://ns.adobe.com/xap/1.0/\0"
# EXIF's code of the unit of resolution.
_CENTIMETRE = 3


@dataclass(frozen=True)
class Exif:
    """The metadata of a photograph.

    Attributes:
        position: measured position of the aircraft, or None; an unknown altitude is NaN.
        time: time of the photograph, or None.
        make: maker of the camera; empty if unknown.
        model: model of the camera; empty if unknown.
        focal_35mm: focal length in millimetres for film whose longer side is 36 mm, or None.
        xmp: XMP of the drone; it is never written.
        place_doubts: phrases about an unknown or contradictory position, with names of fields.
        lens_doubts: phrases about the focal length.
        capture_doubts: phrases about time, attitude and contradictory blocks of EXIF.
        focals: candidates of ``relative_focal``, if none of them is reliable.
    """

    position: Geodetic | None
    time: datetime | None
    make: str = "ObjConnect"
    model: str = "simulated camera"
    focal_35mm: float | None = None
    xmp: DroneXmp = field(default_factory=DroneXmp)
    place_doubts: tuple[str, ...] = ()
    lens_doubts: tuple[str, ...] = ()
    capture_doubts: tuple[str, ...] = ()
    focals: tuple[float, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Return all phrases about position, lens, time and attitude."""
        return (*self.place_doubts, *self.lens_doubts, *self.capture_doubts)

    @property
    def refers_to_sea_level(self) -> bool:
        """Return whether the altitude refers to sea level instead of the ellipsoid."""
        return any(doubt.endswith(SEA_LEVEL_DOUBT) for doubt in self.place_doubts)

    def convert_to_ellipsoid(self, undulation_m: float) -> Exif:
        """Return the metadata with an altitude above sea level converted to the ellipsoid.

        Args:
            undulation_m: height of the geoid above the ellipsoid at the position, metres.
        """
        if self.position is None or not self.refers_to_sea_level:
            return self
        up = self.position.altitude + undulation_m
        doubts = tuple(each for each in self.place_doubts if not each.endswith(SEA_LEVEL_DOUBT))
        return replace(self, position=self.position._replace(altitude=up), place_doubts=doubts)

    @property
    def gimbal(self) -> tuple[float, float, float] | None:
        """Return the camera's yaw, pitch and roll as in ``gimbal_pose``, degrees; None if
        unknown."""
        return self.xmp.gimbal

    @property
    def relative_focal(self) -> float | None:
        """Return the focal length divided by the longer image side (f / max(w, h), as in OpenSfM);
        None if unknown."""
        return None if self.focal_35mm is None else self.focal_35mm / FILM_LENGTH


def write_jpeg(path: Path, rgb: NDArray[np.uint8], exif: Exif, quality: int = 95) -> None:
    """Write a photograph (H, W, 3) uint8 with EXIF.

    Chroma is not subsampled, to preserve features.

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


def resize_file(source: Path, out: Path, longest: int, *, rotate_180: bool = False) -> None:
    """Copy a photograph with its metadata, at most ``longest`` pixels wide and high.

    Args:
        source: photograph to copy.
        out: JPEG to write.
        longest: largest width and height, pixels.
        rotate_180: whether to rotate the image by 180 degrees.

    Raises:
        InputError: the photograph is missing or damaged, or ``out`` cannot be written.
    """
    rgb = read_rgb(source)
    height, width = rgb.shape[:2]
    scale = min(1.0, longest / max(width, height))
    with atomic_write(out) as partial:
        if scale == 1 and not rotate_180:
            shutil.copyfile(source, partial)
            return
        size = (round(scale * width), round(scale * height))
        with open_image(source) as original:
            metadata = {key: original.info[key] for key in ("exif", "xmp") if key in original.info}
        if len(metadata.get("xmp", b"")) > _MAX_SEGMENT_BYTES:
            del metadata["xmp"]
        if len(metadata.get("exif", b"")) > _MAX_SEGMENT_BYTES:  # thumbnails or maker notes
            metadata["exif"] = _encode(read_exif(source), size).tobytes()
        picture = Image.fromarray(rgb[::-1, ::-1] if rotate_180 else rgb)
        smaller = picture.resize(size, Image.Resampling.LANCZOS)
        smaller.save(partial, "JPEG", quality=95, subsampling=0, **metadata)


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
        # The tag above holds whole millimetres; the pixel pitch gives the exact value.
        detail[ExifTags.Base.FocalPlaneXResolution] = _rational(10 * max(size) / FILM_LENGTH)
        detail[ExifTags.Base.FocalPlaneResolutionUnit] = _CENTIMETRE
        detail[ExifTags.Base.ExifImageWidth], detail[ExifTags.Base.ExifImageHeight] = size
    if exif.position is not None:
        gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
        place = exif.position
        gps[ExifTags.GPS.GPSLatitudeRef] = "N" if place.latitude >= 0 else "S"
        gps[ExifTags.GPS.GPSLatitude] = _sexagesimal(abs(place.latitude))
        gps[ExifTags.GPS.GPSLongitudeRef] = "E" if place.longitude >= 0 else "W"
        gps[ExifTags.GPS.GPSLongitude] = _sexagesimal(abs(place.longitude))
        if math.isfinite(place.altitude):
            gps[ExifTags.GPS.GPSAltitudeRef] = b"\x00" if place.altitude >= 0 else b"\x01"
            gps[ExifTags.GPS.GPSAltitude] = _rational(abs(place.altitude))
    return tags


def read_exif(path: Path) -> Exif:
    """Read a photograph's metadata; fields that are missing or invalid are None or empty.

    Contradictory fields are reported in ``doubts``.

    Raises:
        InputError: the file is missing or not an image.
    """
    with open_image(path) as image:
        size, packets, blocks = image.size, _xmp_packets(image), _count_exif_blocks(image)
        try:
            tags = image.getexif()
            detail = tags.get_ifd(ExifTags.IFD.Exif)
            gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
        except DAMAGE:  # the image itself may be whole
            tags, detail, gps = Image.Exif(), {}, {}
    exif_fields, gps_fields = _names(detail, ExifTags.TAGS), _names(gps, ExifTags.GPSTAGS)
    xmp = parse_xmp(packets, read_exif_size(exif_fields) or size)
    focal = read_focal(exif_fields, size, _lens(xmp.camera, xmp.size_confirmed))
    if xmp.panorama:
        kind = xmp.panorama[:40]
        why = f"it is a stitched panorama (ProjectionType {kind}) and has no single focal length"
        focal = FocalLength(unknown("ProjectionType", why), calibration_applies=False)
    if not focal.calibration_applies:
        xmp = replace(xmp, camera=None)
    if xmp.gimbal and is_rotated(exif_fields, size, tags.get(ExifTags.Base.Orientation)):
        doubt = "the image was rotated after capture, so GimbalYawDegree no longer applies to it"
        xmp = replace(xmp, gimbal=None, doubts=(*xmp.doubts, doubt))
    time = read_time(exif_fields, gps_fields)
    position = read_position(gps_fields, xmp.position_texts)
    altitude = read_altitude(gps_fields, xmp.position_texts)
    geodetic = None
    if position.value is not None:
        up = math.nan if altitude.value is None else altitude.value
        geodetic = Geodetic(*position.value, up)
    relative_focal = focal.reading.value
    return Exif(
        position=geodetic,
        time=time.value,
        make=_text(tags.get(ExifTags.Base.Make)),
        model=_text(tags.get(ExifTags.Base.Model)),
        focal_35mm=None if relative_focal is None else relative_focal * FILM_LENGTH,
        xmp=xmp,
        place_doubts=(*position.doubts, *(() if geodetic is None else altitude.doubts)),
        lens_doubts=focal.reading.doubts,
        capture_doubts=(*xmp.doubts, *time.doubts, *([_TWO_BLOCKS] if blocks > 1 else [])),
        focals=focal.candidates,
    )


def _xmp_packets(image: Image.Image) -> list[bytes]:
    """Return the XMP packets; some programs write several into a JPEG."""
    segments = [data for kind, data in getattr(image, "applist", ()) if kind == "APP1"]
    packets = [
        data[len(_XMP_IDENTIFIER) :] for data in segments if data.startswith(_XMP_IDENTIFIER)
    ]
    whole = image.info.get("xmp", b"")
    return packets or [whole if isinstance(whole, bytes) else str(whole).encode()]


def _count_exif_blocks(image: Image.Image) -> int:
    """Return the number of different EXIF blocks in a JPEG; only the first is read."""
    segments = [data for kind, data in getattr(image, "applist", ()) if kind == "APP1"]
    begins = (b"Exif\0\0II*\0", b"Exif\0\0MM\0*")
    return len({data for data in segments if data.startswith(begins)})


def _text(value: object) -> str:
    """Return a text field without its padding of zero bytes."""
    return str(value or "").strip("\0 ")


def _names(tags: Mapping[int, object], known: Mapping[int, str]) -> dict[str, object]:
    """Return the fields of a directory by name."""
    return {known[tag]: value for tag, value in tags.items() if tag in known}


def _lens(camera: Camera | None, size_confirmed: bool) -> Lens | None:
    if camera is None:
        return None
    return Lens(camera.focal[0] / max(camera.width, camera.height), size_confirmed)


def _rational(value: float, denominator: int = _DENOMINATOR) -> IFDRational:
    return IFDRational(Fraction(round(value * denominator), denominator))


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    # Round first, so that seconds stay below 60.
    seconds = Fraction(round(degrees * 3600 * _DENOMINATOR), _DENOMINATOR)
    minutes, seconds = divmod(seconds, 60)
    return _rational(minutes // 60, 1), _rational(minutes % 60, 1), _rational(float(seconds))
