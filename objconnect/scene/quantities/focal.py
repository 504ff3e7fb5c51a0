"""The focal length of a photograph from the fields of EXIF and XMP.

Cameras state it in millimetres with the sensor's pixel pitch, as a 35 mm equivalent, or in pixels.
Programs that resize, crop or rotate a photograph update only some of the fields. Each field is
therefore a separate source. If sources contradict each other, or no source confirms that they refer
to this image size, the focal length is unknown and the stated values are candidates.

Focal lengths are ratios f / max(w, h) unless a unit is stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.numbers import to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

SAME_ASPECT: Final = 0.01
"""Largest relative difference of two aspect ratios that count as equal. Rounding to whole pixels
changes the aspect ratio of a resized picture."""

# Largest relative difference of two agreeing sources. Equivalents are rounded to millimetres.
_SOURCE_TOLERANCE: Final = 0.15
# Largest relative difference of two equal values of one source.
_VALUE_TOLERANCE: Final = 0.02
# Largest aspect ratio of a sensor. Wider pictures are panoramas or crops.
_MAX_SENSOR_ASPECT: Final = 2.4
# Largest relative difference of the sides of a sensor's pixels.
_MAX_PIXEL_DIFFERENCE: Final = 0.05
# Relative focal lengths outside this range are damaged values; it is 1 mm to 10 m for 35 mm film.
_FOCAL_RANGE: Final = (1 / 36, 10_000 / 36)
# Longer side and diagonal of 35 mm film (mm).
FILM_LENGTH: Final = 36.0
_FILM_DIAGONAL: Final = math.hypot(36, 24)
# Images with a larger aspect ratio, such as 16:9, are taken as crops of 4:3 sensors.
_MAX_FULL_ASPECT: Final = 1.6
# Millimetres per unit of resolution, by EXIF's code; some programs write 4 and 5.
_INCH, _CENTIMETRE = 25.4, 10.0
_UNITS: Final = {2: _INCH, 3: _CENTIMETRE, 4: 1.0, 5: 1e-3}

# Orientations that swap width and height.
_SIDEWAYS: Final = (5, 6, 7, 8)

Size = tuple[int, int]
"""Width and height, pixels."""


@dataclass(frozen=True)
class FocalLength:
    """The focal length of a photograph.

    Attributes:
        reading: the relative focal length f / max(w, h), or unknown with the reason.
        candidates: stated values if the focal length is unknown, the likeliest first.
        calibration_applies: whether a calibration in pixels applies to the picture.
    """

    reading: Reading[float]
    candidates: tuple[float, ...] = ()
    calibration_applies: bool = True


@dataclass(frozen=True)
class Lens:
    """A calibration in pixels.

    Attributes:
        focal: relative focal length f / max(w, h) of the calibrated image.
        size_confirmed: whether its optical centre confirms that it applies to this image size.
    """

    focal: float
    size_confirmed: bool


@dataclass(frozen=True)
class _Source:
    """The focal length that one field states.

    Attributes:
        name: name of the field.
        values: possible focal lengths, one of which is right.
        alternatives: values of programs that violate the standard.
        size_confirmed: whether the field certainly refers to this image size.
    """

    name: str
    values: tuple[float, ...]
    alternatives: tuple[float, ...] = ()
    size_confirmed: bool = True

    def allows(self, focal: float) -> bool:
        """Return whether the field is compatible with a focal length."""
        return any(
            _is_near(focal, value, _SOURCE_TOLERANCE)
            for value in (*self.values, *self.alternatives)
        )


def read_focal(detail: Mapping[str, object], size: Size, lens: Lens | None = None) -> FocalLength:
    """Return the relative focal length f / max(w, h) of a photograph.

    Args:
        detail: fields of EXIF by name.
        size: width and height of the picture, pixels.
        lens: calibration from XMP; None if there is none.
    """
    sources = list(_sources(detail, size, lens))
    if not sources:
        return FocalLength(unknown("FocalLength"))
    crop = _describe_crop(detail, size)
    if crop:
        return FocalLength(unknown(sources[0].name, crop), calibration_applies=False)
    common, zoomed = _common_values(sources), to_number(detail.get("DigitalZoomRatio")) > 1
    # Fields in pixels depend on the size, which a program may have changed. A changed size
    # and a digital zoom have the same effect on them.
    size_confirmed = (
        all(one.size_confirmed for one in sources)
        if zoomed
        else any(one.size_confirmed for one in sources)
    )
    if len(common) == 1 and size_confirmed:
        calibration_applies = lens is None or _is_near(lens.focal, common[0], _SOURCE_TOLERANCE)
        return FocalLength(
            known(common[0], sources[0].name), calibration_applies=calibration_applies
        )
    # Most programs keep the 35 mm equivalent, which is the last source.
    candidates = common or [value for source in sources[::-1] for value in source.values]
    why = _describe_doubt(sources, common, zoomed, detail)
    return FocalLength(
        unknown(sources[0].name, why), _distinct(candidates), calibration_applies=False
    )


def is_rotated(detail: Mapping[str, object], size: Size, orientation: object) -> bool:
    """Return whether the pixels of a picture were rotated by a right angle after it was taken.

    Args:
        detail: fields of EXIF by name, with the size of the picture as it was taken.
        size: width and height of the picture now, pixels.
        orientation: the field ``Orientation``. If it swaps width and height, EXIF's size may be
            that of the displayed picture, and the result is False.
    """
    original_size = read_exif_size(detail)
    sides_kept = to_number(orientation) not in _SIDEWAYS
    return (
        original_size is not None
        and sides_kept
        and (original_size[0] < original_size[1]) != (size[0] < size[1])
    )


def read_exif_size(detail: Mapping[str, object]) -> Size | None:
    """Return the size of the picture that EXIF states; None if it is missing or invalid."""
    sides = [to_number(detail.get(f"ExifImage{side}")) for side in ("Width", "Height")]
    if not all(1 <= side < 1e6 for side in sides):
        return None
    return int(sides[0]), int(sides[1])


def ratio_of_equivalent(focal_35mm: float, size: Size) -> float:
    """Convert a 35 mm equivalent focal length (mm) to the relative focal length f / max(w, h).

    Equivalents refer to the diagonal (CIPA DCG-001).
    """
    aspect = max(size) / min(size)
    diagonal = math.hypot(1, 1 / aspect) if aspect < _MAX_FULL_ASPECT else math.hypot(1, 3 / 4)
    return focal_35mm / _FILM_DIAGONAL * diagonal


def _sources(detail: Mapping[str, object], size: Size, lens: Lens | None) -> Iterator[_Source]:
    """Yield the focal length of each field, the most exact field first."""
    zoom = to_number(detail.get("DigitalZoomRatio"))
    factors = (zoom, 1.0) if 1 < zoom < math.inf else (1.0,)
    # Programs that resize a picture may write the new size beside the old resolution. If they keep
    # the old size, it and the resolution belong together.
    width = to_number(detail.get("ExifImageWidth"))
    size_confirmed = width >= 1 and width not in size
    size_confirmed |= lens is not None and lens.size_confirmed
    planes = _focal_plane(detail, size)
    if planes:
        values = tuple(plane * each for plane in planes for each in factors)
        yield _Source("FocalPlaneXResolution", values, size_confirmed=size_confirmed)
    if lens is not None and _is_plausible(lens.focal):
        values = tuple(lens.focal * each for each in factors)
        yield _Source("XMP's calibration", values, size_confirmed=size_confirmed)
    equivalent_mm = to_number(detail.get("FocalLengthIn35mmFilm"))
    if equivalent_mm > 0 and _is_plausible(focal := ratio_of_equivalent(equivalent_mm, size)):
        values = tuple(focal * each for each in factors)
        by_width = tuple(equivalent_mm / FILM_LENGTH * each for each in factors)
        yield _Source("FocalLengthIn35mmFilm", values, by_width)


def _focal_plane(detail: Mapping[str, object], size: Size) -> tuple[float, ...]:
    """Return the possible focal lengths from millimetres and the pixel pitch of the sensor.

    If a picture was rotated to portrait, its longer side is EXIF's width.
    """
    focal, x_resolution, y_resolution = (
        to_number(detail.get(name))
        for name in ("FocalLength", "FocalPlaneXResolution", "FocalPlaneYResolution")
    )
    width = to_number(detail.get("ExifImageWidth"))
    if not (focal > 0 and x_resolution > 0 and width >= 1):
        return ()
    unit = detail.get("FocalPlaneResolutionUnit")
    # The standard's default is an inch, but programs also omit centimetres.
    units = (_INCH, _CENTIMETRE) if unit is None else (_UNITS.get(_to_integer(unit), math.nan),)
    original_size = read_exif_size(detail)
    if original_size is not None:
        sides: tuple[float, ...] = (float(max(original_size)),)
    elif size[0] >= size[1] or width == size[0]:
        sides = (width * max(size) / size[0],)
    elif width == size[1]:
        sides = (width,)
    else:  # portrait, and it is unknown whether it was rotated
        sides = (width, width * size[1] / size[0])
    # If the two resolutions differ, one of them refers to another image size or unit.
    differ = y_resolution > 0 and not _is_near(x_resolution, y_resolution, _MAX_PIXEL_DIFFERENCE)
    resolutions = (x_resolution, y_resolution) if differ else (x_resolution,)
    values = [
        focal * per / (each * side) for per in resolutions for each in units for side in sides
    ]
    return tuple(value for value in values if _is_plausible(value))


def _common_values(sources: Sequence[_Source]) -> tuple[float, ...]:
    """Return the values of the first source with which all others are compatible."""
    first, *others = sources
    return _distinct([v for v in first.values if all(other.allows(v) for other in others)])


def _distinct(values: Sequence[float]) -> tuple[float, ...]:
    """Return values without repetitions."""
    distinct: list[float] = []
    for value in values:
        if not any(_is_near(value, other, _VALUE_TOLERANCE) for other in distinct):
            distinct.append(value)
    return tuple(distinct)


def _describe_crop(detail: Mapping[str, object], size: Size) -> str:
    """Return the evidence that the image was cropped; empty if there is none."""
    if max(size) > _MAX_SENSOR_ASPECT * min(size):
        return f"it is {size[0]} x {size[1]} pixels: a panorama or a crop"
    original_size = read_exif_size(detail)
    if original_size is None:
        return ""
    for width, height in (original_size, original_size[::-1]):
        difference = abs(width * size[1] - height * size[0])
        if difference <= max(SAME_ASPECT * height * size[0], width, height):
            return ""
    return (
        f"it is {size[0]} x {size[1]} pixels and ExifImageWidth and ExifImageHeight say "
        f"{original_size[0]} x {original_size[1]}: it was cropped"
    )


def _describe_doubt(
    sources: Sequence[_Source],
    common: Sequence[float],
    zoomed: bool,
    detail: Mapping[str, object],
) -> str:
    """Return why the sources do not determine the focal length, with 35 mm equivalents."""
    stated = []
    for source in sources:
        values = (f"{value * FILM_LENGTH:.0f}" for value in _distinct(source.values))
        stated.append(f"{source.name} {' or '.join(values)} mm")
    if len(common) == 1 and not zoomed:
        return f"no field confirms that {stated[0]} (35 mm equivalent) applies to this image size"
    if common and zoomed:
        return f"DigitalZoomRatio may be included or not: {', '.join(stated)} (35 mm equivalent)"
    if common:
        missing = [
            name
            for name in ("FocalPlaneResolutionUnit", "ExifImageHeight")
            if detail.get(name) is None
        ]
        why = f"{missing[0]} is missing" if missing else "FocalPlaneYResolution differs"
        return f"{why}: {', '.join(stated)} (35 mm equivalent)"
    return f"its fields contradict each other: {', '.join(stated)} (35 mm equivalent)"


def _is_near(first: float, second: float, tolerance: float) -> bool:
    return max(first, second) < (1 + tolerance) * min(first, second)


def _is_plausible(focal: float) -> bool:
    return _FOCAL_RANGE[0] <= focal <= _FOCAL_RANGE[1]


def _to_integer(value: object) -> int:
    number = to_number(value)
    return int(number) if math.isfinite(number) else 0
