"""The unit of heights in the GeoKeys of a GeoTIFF.

GDAL ignores it beside the code of a vertical system, and reports feet as metres.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from PIL import TiffImagePlugin

_DIRECTORY: Final = (
    34735  # the tag GeoKeyDirectory: four numbers of a header, then four of each key
)
_HEIGHT: Final = 4099  # VerticalUnits
# Codes of EPSG; 0 is undefined.
_METRES: Final = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}


def unit_of_heights(path: Path) -> float | str | None:
    """Return the unit of heights in the GeoKeys of a GeoTIFF.

    Returns:
        Its length, metres; the name and value of the key if the unit is unknown; None without a
        key.
    """
    code = _keys(path).get(_HEIGHT)
    return _METRES.get(code, f"VerticalUnitsGeoKey {code}") if code else None


def _keys(path: Path) -> dict[int, int]:
    """Return the keys whose values are numbers."""
    try:
        with path.open("rb") as file:
            header = file.read(8)
            header += file.read(8) if header[2] == 43 or header[3] == 43 else b""
            directory: Any = TiffImagePlugin.ImageFileDirectory_v2(header)
            file.seek(directory.next)
            directory.load(file)
            numbers = [int(number) for number in directory[_DIRECTORY]]
    except Exception:  # GDAL has read the file; without readable keys there are none
        return {}
    entries = [numbers[k : k + 4] for k in range(4, len(numbers) - 3, 4)]
    return {key: value for key, tag, count, value in entries if tag == 0 and count == 1}
