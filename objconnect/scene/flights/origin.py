"""The geodetic origin of a flight, ``origin.json``."""

from __future__ import annotations

import math
import os
from pathlib import Path

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.files import parse_json, read_text


def read_origin(flight: Path) -> Geodetic | None:
    """Read the ``origin.json`` of a flight; None if it has none.

    Raises:
        InputError: the file cannot be read or holds no finite position.
    """
    file = flight / "origin.json"
    if not os.path.lexists(file):
        return None
    try:
        values = parse_json(read_text(file, "origin"))
        origin = Geodetic(float(values["lat"]), float(values["lon"]), float(values["alt"]))
    except (ValueError, KeyError, TypeError, OverflowError):
        origin = Geodetic(math.nan, math.nan, math.nan)
    if not all(map(math.isfinite, origin)):
        raise InputError(f"{file} must hold numbers lat, lon (degrees) and alt (metres)")
    return origin
