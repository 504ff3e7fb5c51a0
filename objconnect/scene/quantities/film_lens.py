"""35 mm equivalent focal lengths and digital zoom in the telemetry of drones.

A focal length is in millimetres (``162.00``) or in tenths (``240``), a zoom is a ratio (``2.00``)
or in ten-thousandths (``20000, delta:0``). The value alone is ambiguous: tele cameras have 162 mm,
wide ones 24.0 mm. The number format of the file or the lens of the map decides.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

from objconnect.scene.quantities.reading import Reading, known, unknown

SAME_LENS: Final = 0.15
"""Largest relative difference of focal lengths of one lens, because equivalents are whole
millimetres and some makers refer them to the width instead of the diagonal."""
# Range of drones' equivalent focal lengths (mm), and the largest digital zoom.
_SHORTEST_MM: Final = 8.0
_LONGEST_MM: Final = 3000.0
_MAX_ZOOM: Final = 100.0
# Largest f-number of a lens.
_MAX_F_NUMBER: Final = 64.0
_TEN_THOUSANDTHS: Final = 1e4


def has_decimals(text: str) -> bool:
    """Return whether a number is written with a decimal mark."""
    return "." in text or "," in text


def scales_whole_numbers(f_numbers: Collection[str], zooms_with_delta: bool) -> bool | None:
    """Return whether a file writes fractions as scaled whole numbers.

    Args:
        f_numbers: texts of the aperture, such as ``2.8`` or ``280``.
        zooms_with_delta: whether the file writes zooms in ten-thousandths, with a ``delta``.

    Returns:
        True if whole numbers must be scaled, False if they must not; None if there is evidence of
        neither or of both.
    """
    whole = [float(text) for text in f_numbers if text.isdecimal() and float(text) > 0]
    scaled = zooms_with_delta or any(number > _MAX_F_NUMBER for number in whole)
    plain = any(number <= _MAX_F_NUMBER for number in whole)
    return None if scaled == plain else scaled


def millimetres_per_unit(
    texts: Sequence[str],
    numbers: Sequence[float],
    scaled: bool | None,
    lenses: Collection[float] = (),
) -> Reading[float]:
    """Return the factor from the numbers of ``focal_len`` to millimetres.

    Args:
        texts: the numbers as they are written; at least one.
        numbers: their values.
        scaled: result of ``scales_whole_numbers``; only True determines the unit.
        lenses: equivalent focal lengths of the map's cameras, mm.
    """
    source = "focal_len"
    if any(map(has_decimals, texts)):
        return known(1.0, source)
    if scaled:
        return known(0.1, source)
    number = numbers[0]
    fitting = [
        unit
        for unit in (1.0, 0.1)
        if any(abs(unit * value / lens - 1) < SAME_LENS for value in numbers for lens in lenses)
    ]
    if len(fitting) == 1:
        doubt = f"focal_len {number:g} is read as {fitting[0] * number:g} mm, like the map's lens"
        return known(fitting[0], source, doubt)
    return unknown(source, f"focal_len {number:g} may be in millimetres or in tenths of them")


def plausible_focal(focal_mm: float) -> float | None:
    """Return an equivalent focal length, mm; None if it is outside the range of drones' lenses."""
    return focal_mm if _SHORTEST_MM <= focal_mm <= _LONGEST_MM else None


def zoom_ratio(text: str, number: float, in_ten_thousandths: bool, name: str) -> Reading[float]:
    """Return a digital zoom as a ratio, at least 1.

    A whole number below 10 is a ratio. A larger one is known only if the file writes
    ten-thousandths.

    Args:
        text: the number as it is written.
        number: its value.
        in_ten_thousandths: whether the file writes whole numbers with a ``delta``.
        name: name of the field.

    Examples:
        >>> zoom_ratio("2.00", 2.0, False, "dzoom_ratio").value
        2.0
        >>> zoom_ratio("20000", 20000.0, True, "dzoom_ratio").value
        2.0
        >>> zoom_ratio("20000", 20000.0, False, "dzoom_ratio").is_known
        False
    """
    if not has_decimals(text):
        if in_ten_thousandths:
            number /= _TEN_THOUSANDTHS
        elif number >= 10:
            return unknown(name, f"the scale of {name} {text} is unknown")
    if 1 <= number <= _MAX_ZOOM:
        return known(number, name)
    return unknown(name, f"{name} {text} is not a digital zoom")
