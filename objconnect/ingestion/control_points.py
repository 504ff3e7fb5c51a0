"""Read ground control points in ODM's format ``gcp_list.txt``.

The first line names the coordinate system, see ``objconnect.scene.geo.named_systems``. Each
other line is a mark: ``x y z px py photograph [name]``, where x is east or longitude, y north or
latitude, and px and py are pixels with the centre of the top left one at (0, 0)
(https://docs.opendronemap.org/gcp).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.photographs import Flight, reduce_size
from objconnect.scene.errors import InputError
from objconnect.scene.geo.named_systems import NamedSystem, parse_system
from objconnect.scene.geometry.geodesy import Geodetic, enu_from_geodetic, is_on_earth
from objconnect.scene.imports.names import match_files
from objconnect.scene.storage.files import read_text

# Maximum median distance (m) of surveyed points from the middle of the photographs' GPS positions.
_MAX_DISTANCE_M = 20_000.0
_COLUMNS = "x y z px py photograph [name]"


@dataclass(frozen=True)
class ControlPoint:
    """A surveyed point.

    Attributes:
        name: name in the list, or "point" with its number there.
        geodetic: surveyed coordinates. Heights of a system with heights are converted to the
            ellipsoid; those of a two-dimensional system are taken as ellipsoidal.
        check: whether it is a check point, which does not take part in the adjustment.
        marks: (2,) COLMAP pixels at the photograph's size in the scene, by name of the photograph.
    """

    name: str
    geodetic: Geodetic
    check: bool = False
    marks: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    def position(self, origin: Geodetic) -> NDArray[np.float64]:
        """Return the surveyed position, (3,) metres from an origin."""
        return enu_from_geodetic(self.geodetic, origin)


def read_control_points(
    path: Path, flight: Flight, size: int, checks: Collection[str] = ()
) -> list[ControlPoint]:
    """Read the points of a list with their marks in the photographs of a flight.

    Args:
        path: the list.
        flight: photographs; marks in others are ignored.
        size: longest side of the photographs in the scene, to which marks are scaled, pixels.
        checks: names of the check points.

    Raises:
        InputError: the list cannot be read, names no coordinate system, has a bad line or one name
            for two points, or lacks the photographs or ``checks``; its points are not on earth or
            far from the photographs; pyproj is not installed.
    """
    header, *lines = read_text(path, "list of ground control points").split("\n")
    rows = [
        (f"{path}:{number}", line.split())
        for number, line in enumerate(lines, 2)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    system = parse_system(header, f"{path}:1")
    images = {image.file: image for image in flight.images}
    listed = dict.fromkeys(row[5] for _, row in rows if len(row) > 5)
    file_of = {name: file for file, name in match_files(list(images), list(listed), path).items()}
    points: dict[str, ControlPoint] = {}
    coordinates: dict[str, tuple[float, ...]] = {}
    for where, row in rows:
        *numbers, photograph, name = _parse_row(where, row)
        xyz, pixel = tuple(numbers[:3]), np.array(numbers[3:])
        name = name or next((n for n, known in coordinates.items() if known == xyz), "")
        name = name or f"point {len(points) + 1}"
        if coordinates.setdefault(name, xyz) != xyz:
            raise InputError(
                f"{where}: {name!r} has other coordinates than in an earlier line: give each point "
                "one position"
            )
        if name not in points:
            geodetic = system.to_geodetic(np.array(xyz), f"{path}:1")
            if not is_on_earth(geodetic):
                raise InputError(
                    f"{where}: the coordinates of {name!r} are not on earth: check line 1 and units"
                )
            points[name] = ControlPoint(name, geodetic, name in checks)
        if photograph not in file_of:
            continue
        image = images[file_of[photograph]]
        if image.name in points[name].marks:
            raise InputError(
                f"{where}: {name!r} is marked twice in {photograph}: remove one of the marks"
            )
        scale = np.array(reduce_size(image, size)) / np.array(image.size)
        points[name].marks[image.name] = (pixel + 0.5) * scale
    _require_marks(path, points, listed, flight, checks)
    _require_near(path, coordinates, system, flight)
    return list(points.values())


def _parse_row(where: str, row: list[str]) -> tuple[float, float, float, float, float, str, str]:
    shown = " ".join(row)[:60]
    if len(row) < 6:
        raise InputError(f"{where}: expected {_COLUMNS}, got {shown!r}")
    if not "".join(row).isprintable():
        raise InputError(f"{where}: {shown!r} has a control character: remove it")
    try:
        numbers = [float(word) for word in row[:5]]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise InputError(f"{where}: x y z px py must be finite numbers, got {shown!r}")
    x, y, z, px, py = numbers
    return x, y, z, px, py, row[5], " ".join(row[6:])


def _require_marks(
    path: Path,
    points: dict[str, ControlPoint],
    listed: Collection[str],
    flight: Flight,
    checks: Collection[str],
) -> None:
    """Refuse a list without marks in the photographs or without the named check points."""
    if not any(point.marks for point in points.values()):
        first = next(iter(listed), "")
        raise InputError(
            f"{path} names none of the photographs: its first name is {first!r}, the first of the "
            f"folder {flight.images[0].file!r}"
        )
    for name in checks:
        if name not in points:
            raise InputError(
                f"{path} has no point {name!r} for --gcp-check; it has {', '.join(points)[:200]}"
            )


def _require_near(
    path: Path,
    coordinates: Mapping[str, tuple[float, ...]],
    system: NamedSystem,
    flight: Flight,
) -> None:
    """Refuse points far from the GPS positions of the photographs."""
    known = [image.exif.position for image in flight.images if image.exif.position is not None]
    if not known:
        return
    middle = Geodetic(
        float(np.median([position.latitude for position in known])),
        float(np.median([position.longitude for position in known])),
        0.0,
    )
    listed = np.array(list(coordinates.values()))
    distance_m = _distance(listed, system, middle)
    if not distance_m > _MAX_DISTANCE_M:
        return
    remedy = f"check the system of line 1, {system.projection.name}, and the unit of x and y"
    if _distance(listed[:, [1, 0, 2]], system, middle) <= _MAX_DISTANCE_M:
        remedy = "x and y are exchanged: give east or longitude first"
    raise InputError(
        f"{path}: its points lie {distance_m / 1000:.0f} km from the photographs' GPS positions: "
        f"{remedy}"
    )


def _distance(coordinates: NDArray[np.float64], system: NamedSystem, middle: Geodetic) -> float:
    """Return the median distance (m) of points (N, 3) from ``middle``; infinite if not on earth."""
    distances = []
    for row in coordinates:
        try:
            point = system.projection.to_geodetic(row)
        except InputError:
            return math.inf
        distances.append(np.linalg.norm(enu_from_geodetic(point._replace(altitude=0.0), middle)))
    return float(np.median(distances))
