"""Reader of positions from a CSV file with the columns name,lat,lon,alt or name,e,n,u.

Latitudes and longitudes are degrees (WGS84), altitudes metres above the ellipsoid; e, n, u are
metres east, north and up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, is_on_earth, median_place
from objconnect.scene.imports.poses import ForeignPoses, Format, check_positions
from objconnect.scene.storage.tables import read_table

_GEODETIC, _LOCAL = ("lat", "lon", "alt"), ("e", "n", "u")


def _read(path: Path) -> ForeignPoses:
    names, rows, geodetic = [], [], False
    for where, row in read_table(path, "table of positions", ("name",)):
        geodetic = all(column in row for column in _GEODETIC)
        columns = _GEODETIC if geodetic else _LOCAL
        if not all(column in row for column in columns):
            raise InputError(f"{path}:1: expected the columns name,lat,lon,alt or name,e,n,u")
        try:
            rows.append([float(row[column]) for column in columns])
        except ValueError:
            raise InputError(f"{where}: {', '.join(columns)} must be numbers") from None
        if geodetic and not is_on_earth(Geodetic(*rows[-1])):
            raise InputError(f"{where}: {row['name']!r} is not a place on earth")
        names.append(row["name"])
    if not geodetic:
        return check_positions(path, names, np.array(rows).reshape(-1, 3), None)
    places = [Geodetic(*row) for row in rows]
    origin = median_place(places)
    positions = np.array([enu_from_geodetic(place, origin) for place in places])
    return check_positions(path, names, positions, origin)


FORMAT = Format(
    lambda path: path.is_file() and path.suffix.lower() == ".csv",
    _read,
    "a table of positions (.csv)",
)
