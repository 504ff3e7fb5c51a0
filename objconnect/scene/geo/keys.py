"""The unit of heights in the GeoKeys of a GeoTIFF.

If the file also has the code of a vertical system, GDAL ignores this unit and reports feet as
metres.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from PIL import TiffImagePlugin

# The tag GeoKeyDirectory holds four numbers of a header, then four numbers of each key.
_GEO_KEY_DIRECTORY: Final = 34735
# The key VerticalUnits; its values are EPSG codes, and 0 is undefined.
_VERTICAL_UNITS: Final = 4099
_METRES_PER_UNIT: Final = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}


def unit_of_heights(path: Path) -> float | str | None:
    """Return the unit of heights in the GeoKeys of a GeoTIFF.

    Returns:
        The length of the unit, metres; the name and value of the key if the unit is unknown; None
        without the key.
    """
    code = _keys(path).get(_VERTICAL_UNITS)
    return _METRES_PER_UNIT.get(code, f"VerticalUnitsGeoKey {code}") if code else None


def _keys(path: Path) -> dict[int, int]:
    """Return the keys whose values are numbers."""
    try:
        with path.open("rb") as file:
            header = file.read(8)
            # The header of a BigTIFF, version 43, is twice as long.
            header += file.read(8) if header[2] == 43 or header[3] == 43 else b""
            directory: Any = TiffImagePlugin.ImageFileDirectory_v2(header)
            file.seek(directory.next)
            directory.load(file)
            numbers = [int(number) for number in directory[_GEO_KEY_DIRECTORY]]
    except Exception:  # GDAL has read the file; keys that cannot be read are treated as missing
        return {}
    entries = [numbers[k : k + 4] for k in range(4, len(numbers) - 3, 4)]
    return {key: value for key, tag, count, value in entries if tag == 0 and count == 1}
