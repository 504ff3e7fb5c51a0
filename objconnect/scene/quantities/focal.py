"""The focal length of a photograph, from the fields that several programs may have written.

A camera states it in millimetres of its own sensor, for 35 mm film, or in pixels. Programs that
resize, crop or turn a photograph change some of the fields and leave others. Each field is
therefore a source of its own; where they contradict each other, or where nothing shows that the
only one is of this picture, there are candidates and no value.

Focal lengths are in longest sides of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.scene.quantities.numbers import to_number
from objconnect.scene.quantities.reading import Reading, known, unknown

SAME_ASPECT: Final = 0.01
"""Aspect ratios of one picture in two sizes, in whole pixels, differ by less than this share."""

# Two sources agree where they differ by less than this share: equivalents are whole millimetres.
_AGREE: Final = 0.15
# Two values of one source are one where they differ by less than this share.
_SAME: Final = 0.02
# No sensor is wider than this for its height: such pictures are panoramas, or parts of one.
_WIDEST: Final = 2.4
# Pixels of a sensor are square up to this share.
_SQUARE: Final = 0.05
# Focal lengths outside this range (longest sides) are damaged values.
_RANGE: Final = (1 / 36, 10_000 / 36)
# The size of 35 mm film (mm).
FILM_LENGTH: Final = 36.0
_FILM_DIAGONAL: Final = math.hypot(36, 24)
# Images with a larger aspect ratio are much wider than 3:2: they are parts of 4:3 sensors.
_WIDE: Final = 1.6
# Units of resolution, millimetres. EXIF has 2 and 3, and some programs write 4 and 5.
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
        reading: The value in longest sides, or why there is none.
        candidates: Values that fields state where they contradict each other or where none of them
            can be checked, the likeliest first.
        agrees: Whether a calibration in pixels belongs to the picture.
    """

    reading: Reading[float]
    candidates: tuple[float, ...] = ()
    agrees: bool = True


@dataclass(frozen=True)
class Lens:
    """A calibration in pixels.

    Attributes:
        focal: Focal length in longest sides of the picture that it was stated for.
        sized: Whether its optical centre shows that it is of a picture of that size.
    """

    focal: float
    sized: bool


@dataclass(frozen=True)
class _Source:
    """What one field says.

    Attributes:
        name: Its name.
        values: One of them is the focal length.
        alike: Values that are not meant by the standard, and that some programs write.
        sized: Whether it is of this picture, whatever a program did with it.
    """

    name: str
    values: tuple[float, ...]
    alike: tuple[float, ...] = ()
    sized: bool = True

    def says(self, focal: float) -> bool:
        """Return whether the field means that focal length, too."""
        return any(_near(focal, value, _AGREE) for value in (*self.values, *self.alike))


def read_focal(detail: Mapping[str, object], size: Size, lens: Lens | None = None) -> FocalLength:
    """Return the focal length of a photograph in longest sides.

    Args:
        detail: Fields of EXIF by name.
        size: Width and height of the picture as it is, pixels.
        lens: Calibration in XMP; None without one.
    """
    sources = list(_sources(detail, size, lens))
    if not sources:
        return FocalLength(unknown("FocalLength"))
    cut = _cut(detail, size)
    if cut:
        return FocalLength(unknown(sources[0].name, cut), agrees=False)
    found, zoomed = _common(sources), to_number(detail.get("DigitalZoomRatio")) > 1
    # Fields in pixels share the size that a program may have changed, and a zoom may look like it.
    checked = all(one.sized for one in sources) if zoomed else any(one.sized for one in sources)
    if len(found) == 1 and checked:
        agrees = lens is None or _near(lens.focal, found[0], _AGREE)
        return FocalLength(known(found[0], sources[0].name), agrees=agrees)
    # A number for film is the one that survives most programs.
    candidates = found or [value for source in sources[::-1] for value in source.values]
    why = _why(sources, found, zoomed, detail)
    return FocalLength(unknown(sources[0].name, why), _each(candidates), agrees=False)


def is_turned(detail: Mapping[str, object], size: Size, orientation: object) -> bool:
    """Return whether a picture was turned upright after it was taken.

    Args:
        detail: Fields of EXIF by name, of which the size is of the picture as it was taken.
        size: Width and height of the picture as it is, pixels.
        orientation: The field ``Orientation``; programs that write the size of the picture as it is
            to be shown leave it there.
    """
    taken = read_exif_size(detail)
    upright = to_number(orientation) not in _SIDEWAYS
    return taken is not None and upright and (taken[0] < taken[1]) != (size[0] < size[1])


def read_exif_size(detail: Mapping[str, object]) -> Size | None:
    """Return the size that EXIF states for the picture; None where it is missing or none."""
    sides = [to_number(detail.get(f"ExifImage{side}")) for side in ("Width", "Height")]
    if not all(1 <= side < 1e6 for side in sides):
        return None
    return int(sides[0]), int(sides[1])


def equivalent(focal_35mm: float, size: Size) -> float:
    """Return an equivalent focal length (mm) in longest sides of the picture.

    The equivalent refers to the diagonal (CIPA DCG-001).
    """
    aspect = max(size) / min(size)
    diagonal = math.hypot(1, 1 / aspect) if aspect < _WIDE else math.hypot(1, 3 / 4)
    return focal_35mm / _FILM_DIAGONAL * diagonal


def _sources(detail: Mapping[str, object], size: Size, lens: Lens | None) -> Iterator[_Source]:
    """Yield what each field says, the most exact one first."""
    zoom = to_number(detail.get("DigitalZoomRatio"))
    times = (zoom, 1.0) if 1 < zoom < math.inf else (1.0,)
    # A program that resizes a picture may write its new size beside the old resolution.
    width = to_number(detail.get("ExifImageWidth"))
    sized = width >= 1 and width not in size
    sized |= lens is not None and lens.sized
    planes = _focal_plane(detail, size)
    if planes:
        values = tuple(plane * each for plane in planes for each in times)
        yield _Source("FocalPlaneXResolution", values, sized=sized)
    if lens is not None and _sane(lens.focal):
        values = tuple(lens.focal * each for each in times)
        yield _Source("XMP's calibration", values, sized=sized)
    film = to_number(detail.get("FocalLengthIn35mmFilm"))
    if film > 0 and _sane(focal := equivalent(film, size)):
        values = tuple(focal * each for each in times)
        wide = tuple(film / FILM_LENGTH * each for each in times)
        yield _Source("FocalLengthIn35mmFilm", values, wide)


def _focal_plane(detail: Mapping[str, object], size: Size) -> tuple[float, ...]:
    """Return what millimetres of focal length and pixels of the sensor mean; one of them is true.

    A picture that was turned upright has its sides the other way round.
    """
    focal, per_unit, other = (
        to_number(detail.get(name))
        for name in ("FocalLength", "FocalPlaneXResolution", "FocalPlaneYResolution")
    )
    width = to_number(detail.get("ExifImageWidth"))
    if not (focal > 0 and per_unit > 0 and width >= 1):
        return ()
    unit = detail.get("FocalPlaneResolutionUnit")
    # The standard's default is an inch. Some programs leave out what is not their default.
    units = (_INCH, _CENTIMETRE) if unit is None else (_UNITS.get(_whole(unit), math.nan),)
    taken = read_exif_size(detail)
    if taken is not None:
        sides: tuple[float, ...] = (float(max(taken)),)
    elif size[0] >= size[1] or width == size[0]:
        sides = (width * max(size) / size[0],)
    elif width == size[1]:
        sides = (width,)
    else:  # upright, and nothing says whether it was turned
        sides = (width, width * size[1] / size[0])
    # Where the two resolutions differ, one of them is of another size or unit.
    pers = (per_unit, other) if other > 0 and not _near(per_unit, other, _SQUARE) else (per_unit,)
    values = [focal * per / (each * side) for per in pers for each in units for side in sides]
    return tuple(value for value in values if _sane(value))


def _common(sources: Sequence[_Source]) -> tuple[float, ...]:
    """Return the values of the most exact source that all others mean, too."""
    first, *others = sources
    return _each([v for v in first.values if all(other.says(v) for other in others)])


def _each(values: Sequence[float]) -> tuple[float, ...]:
    """Return values without repetitions."""
    kept: list[float] = []
    for value in values:
        if not any(_near(value, other, _SAME) for other in kept):
            kept.append(value)
    return tuple(kept)


def _cut(detail: Mapping[str, object], size: Size) -> str:
    """Return why the picture is a part of the one that was taken; empty where it is not."""
    if max(size) > _WIDEST * min(size):
        return f"it is {size[0]} x {size[1]} pixels: a panorama, or a part of a picture"
    taken = read_exif_size(detail)
    if taken is None:
        return ""
    for width, height in (taken, taken[::-1]):
        off = abs(width * size[1] - height * size[0])
        if off <= max(SAME_ASPECT * height * size[0], width, height):
            return ""
    return (
        f"it is {size[0]} x {size[1]} pixels and ExifImageWidth and ExifImageHeight say "
        f"{taken[0]} x {taken[1]}: it was cropped"
    )


def _why(
    sources: Sequence[_Source],
    found: Sequence[float],
    zoomed: bool,
    detail: Mapping[str, object],
) -> str:
    """Return why sources do not tell the focal length, in millimetres of film."""
    said = [
        f"{source.name} {' or '.join(f'{v * FILM_LENGTH:.0f}' for v in _each(source.values))} mm"
        for source in sources
    ]
    if len(found) == 1 and not zoomed:
        return f"nothing shows that {said[0]} of film is of a picture of this size"
    if found and zoomed:
        return f"DigitalZoomRatio may be in it or not: {', '.join(said)} of film"
    if found:
        missing = [
            name
            for name in ("FocalPlaneResolutionUnit", "ExifImageHeight")
            if detail.get(name) is None
        ]
        why = f"{missing[0]} is missing" if missing else "FocalPlaneYResolution is another"
        return f"{why}: {', '.join(said)} of film"
    return f"its fields contradict each other: {', '.join(said)} of film"


def _near(first: float, second: float, share: float) -> bool:
    return max(first, second) < (1 + share) * min(first, second)


def _sane(focal: float) -> bool:
    return _RANGE[0] <= focal <= _RANGE[1]


def _whole(value: object) -> int:
    number = to_number(value)
    return int(number) if math.isfinite(number) else 0
