"""Strict readers of a flight's text files; every error names the file and the line."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.manifest import ALL_CONDITIONS
from objconnect.scene.errors import InputError
from objconnect.scene.flights.priors import PriorTable, StatedPrior
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.geometry.colmap_models import CONVERTIBLE_MODELS
from objconnect.scene.geometry.geodesy import FARTHEST_M, Geodetic, is_on_earth
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.colmap_files import check_pose
from objconnect.scene.quantities.position_columns import (
    POSITION_COLUMNS,
    CoordinateFrame,
    PositionColumns,
    position_columns,
)
from objconnect.scene.storage.files import is_safe_path, read_text
from objconnect.scene.storage.names import quote_name, split_name, split_words, unquote_cell
from objconnect.scene.storage.tables import read_header, read_table

_POSE_COLUMNS: Final = ("name", "qw", "qx", "qy", "qz", "tx", "ty", "tz")
_QUATERNION_COLUMNS: Final = ("qw", "qx", "qy", "qz")
_SIGMA_M: Final = "sigma_m"
_SIGMA_DEG: Final = "sigma_deg"
_GPS_COLUMNS: Final = ("name", "e", "n", "u")
_CONDITION_COLUMNS: Final = ("name", "condition")

# Smallest sigma (metres, degrees): no sensor is better, and weights would overflow.
_LEAST_SIGMA: Final = 1e-6

# The space between a name and the camera model behind it.
_MODEL: Final = re.compile(rf"\s+(?=({'|'.join((*MODELS, *CONVERTIBLE_MODELS))})(\s|$))")
_SPACE: Final = re.compile(r"\s+")

T = TypeVar("T")


def read_poses(
    path: Path, centres: bool = False, max_rounding_m: float | None = None
) -> dict[str, Pose]:
    """Read poses from lines ``name qw qx qy qz tx ty tz``, world to camera, in metres.

    Names are quoted as by ``quote_name``; a name without quotes may contain spaces.

    Args:
        path: text file.
        centres: whether the last three columns are the camera centre instead of the translation.
        max_rounding_m: largest error (m) of a camera centre due to the rounding of its quaternion,
            which matters for large coordinates; None accepts any.

    Returns:
        cam_from_world by name, in the order of the file.

    Raises:
        InputError: the file cannot be read, or a line has the wrong number of columns, a value
            that is not a finite number, a quaternion off unit length by more than 0.001, a camera
            that is not on earth, a rounding error above ``max_rounding_m``, or a repeated name.
    """
    poses: dict[str, Pose] = {}
    for where, line in _lines(path, "pose file"):
        try:
            name, numbers = split_name(line, len(_POSE_COLUMNS) - 1)
        except ValueError as error:
            raise InputError(
                f"{where}: expected {len(_POSE_COLUMNS)} columns ({' '.join(_POSE_COLUMNS)}), "
                f"{error}"
            ) from None
        values = _numbers(where, numbers)
        check_pose(values[:4], values[4:], f"{where}: {name}")
        if max_rounding_m is not None:
            _require_exact_centre(values, max_rounding_m, f"{where}: {name}")
        pose = Pose.from_quaternion(values[:4], values[4:])
        if centres:
            pose = Pose(pose.rotation, -(pose.rotation @ pose.translation))
        _add(poses, name, pose, where)
    return poses


def _require_exact_centre(values: NDArray[np.float64], max_rounding_m: float, where: str) -> None:
    """Refuse a pose (7,) whose quaternion is too coarse for its translation.

    If the length of a quaternion differs from one by d, the centre for a translation t is uncertain
    by ``|t| d``.
    """
    rounding_m = np.linalg.norm(values[4:]) * abs(float(np.linalg.norm(values[:4])) - 1)
    if rounding_m > max_rounding_m:
        raise InputError(
            f"{where}: the quaternion has too few digits for a translation this long: the position "
            f"is uncertain by {rounding_m:.2f} m; write it with 12 digits or more"
        )


def pose_line(name: str, cam_from_world: Pose, decimals: int) -> str:
    """Return a line that ``read_poses`` reads, without the line break."""
    numbers = [*cam_from_world.quaternion().tolist(), *cam_from_world.translation.tolist()]
    return " ".join([quote_name(name), *(f"{number:.{decimals}f}" for number in numbers)])


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read cameras from lines ``name MODEL width height params...``.

    Returns:
        Cameras by name, in the order of the file.

    Raises:
        InputError: the file cannot be read, a line does not describe a camera, or a name is given
            twice.
    """
    cameras: dict[str, Camera] = {}
    for where, line in _lines(path, "query list"):
        try:
            name, camera = _camera_of(line)
        except ValueError as error:
            raise InputError(f"{where}: {error}") from None
        _add(cameras, name, camera, where)
    return cameras


def _camera_of(line: str) -> tuple[str, Camera]:
    """Split a line into name and camera; a name that contains spaces ends before the model."""
    if line.startswith('"'):
        name, *rest = split_words(line)
        return name, Camera.parse(rest)
    gap = _MODEL.search(line) or _SPACE.search(line)
    if gap is None:
        return line, Camera.parse([])
    return line[: gap.start()], Camera.parse(line[gap.end() :].split())


def read_pairs(path: Path) -> dict[str, tuple[str, ...]]:
    """Read a pair list of hloc with lines ``query reference``.

    Returns:
        Reference images by query, both in the order of the file.

    Raises:
        InputError: the file cannot be read, a line does not have two names, or there is no line.
    """
    pairs: dict[str, list[str]] = {}
    for where, line in _lines(path, "pair list"):
        try:
            query, reference = split_words(line)
        except ValueError:
            raise InputError(
                f"{where}: expected 'query reference', got {line!r}; put names with spaces in "
                "double quotes"
            ) from None
        pairs.setdefault(query, []).append(reference)
    if not pairs:
        raise InputError(f"pair list {path} holds no pair")
    return {query: tuple(references) for query, references in pairs.items()}


def read_priors(path: Path) -> PriorTable:
    """Read a table of priors with the columns ``name,e,n,u`` or ``name,lat,lon,alt``.

    East, north and up are metres in the map's frame; latitude and longitude are degrees, altitudes
    metres above the ellipsoid. An unknown height may be left out or be empty. Attitudes
    (cam_from_world) are the columns ``qw,qx,qy,qz``. ``sigma_m`` and ``sigma_deg`` are standard
    deviations of position and attitude per axis.

    Returns:
        The stated priors, in the order of the file.

    Raises:
        InputError: the file cannot be read; a column is unknown, missing or given twice; a value
            is not a finite number; a quaternion is off unit length by more than 0.001; a position
            is not on earth; a sigma is not positive or out of range; or a name is repeated.
    """
    header = read_header(path, "priors")
    columns = _position_columns(path, header)
    rows: dict[str, StatedPrior] = {}
    for where, row in read_table(path, "priors", ("name",)):
        _add(rows, _name(where, row), _parse_prior(where, row, columns), where)
    return PriorTable(path, rows)


def _position_columns(path: Path, header: Sequence[str]) -> PositionColumns:
    """Return the position columns of a table of priors."""
    attitude = [column for column in _QUATERNION_COLUMNS if column in header]
    reading = position_columns(header, ("name", _SIGMA_M, *_QUATERNION_COLUMNS, _SIGMA_DEG))
    columns = reading.require(f"{path}:1", f"{POSITION_COLUMNS}, and leave other columns out")
    if attitude and len(attitude) < len(_QUATERNION_COLUMNS):
        missing = ", ".join(column for column in _QUATERNION_COLUMNS if column not in header)
        raise InputError(f"{path}:1: the attitude lacks the column {missing}")
    if _SIGMA_DEG in header and not attitude:
        raise InputError(
            f"{path}:1: {_SIGMA_DEG} is given without an attitude: add "
            f"{', '.join(_QUATERNION_COLUMNS)}"
        )
    return columns


def _parse_prior(where: str, row: Mapping[str, str], columns: PositionColumns) -> StatedPrior:
    """Return the stated prior of a row; an empty cell states nothing."""
    if row.get(""):
        raise InputError(f"{where}: the column of {row['']!r} has no name")
    first, second = (float(x) for x in _numbers(where, [row[name] for name in columns.horizontal]))
    vertical = None if columns.vertical is None else _parse_number(where, row, columns.vertical)
    if columns.frame is CoordinateFrame.MAP:
        if max(abs(first), abs(second), abs(vertical or 0.0)) > FARTHEST_M:
            raise InputError(
                f"{where}: {row['name']} lies more than {FARTHEST_M:g} m away from the map's origin"
            )
    elif not is_on_earth(Geodetic(first, second, vertical or 0.0)):
        names = ", ".join(columns.horizontal)
        raise InputError(
            f"{where}: {names} are not a place on earth: give degrees up to 90 and 180, and an "
            "altitude in metres"
        )
    sigmas = {name: _parse_number(where, row, name) for name in (_SIGMA_M, _SIGMA_DEG)}
    _check_sigmas(where, {name: sigma for name, sigma in sigmas.items() if sigma is not None})
    return StatedPrior(
        where,
        columns.frame,
        (first, second),
        vertical,
        sigmas[_SIGMA_M],
        _rotation(where, row),
        sigmas[_SIGMA_DEG],
    )


def _parse_number(where: str, row: Mapping[str, str], column: str) -> float | None:
    """Return the number in a cell; None where the column is missing or the cell is empty."""
    return float(_numbers(where, [row[column]])[0]) if row.get(column) else None


def _check_sigmas(where: str, sigmas: Mapping[str, float]) -> None:
    """Refuse sigmas that are not positive or out of range."""
    names = " and ".join(sigmas)
    if any(sigma <= 0 for sigma in sigmas.values()):
        raise InputError(f"{where}: {names} must be positive")
    if not all(_LEAST_SIGMA <= sigma <= FARTHEST_M for sigma in sigmas.values()):
        raise InputError(f"{where}: {names} must lie between {_LEAST_SIGMA:g} and {FARTHEST_M:g}")


def _rotation(where: str, row: Mapping[str, str]) -> NDArray[np.float64] | None:
    """Return the attitude of a row, (3, 3); None where its cells are empty or missing."""
    words = [row.get(column, "") for column in _QUATERNION_COLUMNS]
    if not any(words):
        return None
    quaternion = _numbers(where, words)
    check_pose(quaternion, np.zeros(3), f"{where}: {row['name']}")
    rotation: NDArray[np.float64] = Pose.from_quaternion(quaternion, np.zeros(3)).rotation.numpy()
    return rotation


def read_gps(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the columns ``name``, ``e``, ``n``, ``u`` of a ``gps.csv``.

    Returns:
        (3,) east, north, up in metres by photograph, in the order of the file.

    Raises:
        InputError: the file cannot be read, a column is missing, or a row has the wrong number of
            columns, a value that is not a finite number, a position that is not on earth, or a
            repeated name.
    """
    fixes: dict[str, NDArray[np.float64]] = {}
    for where, row in read_table(path, "GPS table", _GPS_COLUMNS):
        position = _numbers(where, [row[column] for column in _GPS_COLUMNS[1:]])
        if np.abs(position).max() > FARTHEST_M:
            raise InputError(
                f"{where}: {row['name']} lies more than {FARTHEST_M:g} m away from the origin"
            )
        _add(fixes, _name(where, row), position, where)
    return fixes


def read_conditions(path: Path) -> dict[str, str]:
    """Read the columns ``name``, ``condition`` of a ``conditions.csv``.

    Returns:
        The condition of each photograph, such as ``winter-dusk``, in the order of the file.

    Raises:
        InputError: the file cannot be read, a column is missing, or a row has the wrong number of
            columns, a condition that is empty, not printable or "all", or a repeated name.
    """
    conditions: dict[str, str] = {}
    for where, row in read_table(path, "table of conditions", _CONDITION_COLUMNS):
        condition = row["condition"].strip()
        if not condition:
            raise InputError(f"{where}: the condition is empty: give a name like winter-dusk")
        if not condition.isprintable():
            raise InputError(f"{where}: {condition!r} has a control character: remove it")
        if condition == ALL_CONDITIONS:
            raise InputError(
                f"{where}: {condition!r} stands for all conditions: give a name like winter-dusk"
            )
        _add(conditions, _name(where, row), condition, where)
    return conditions


def require_same_case(path: Path, listed: Collection[str], photographs: Collection[str]) -> None:
    """Refuse a table whose names differ from the photographs' in upper or lower case only.

    Without this check the rows of such a table would be ignored silently.

    Args:
        path: file of the table, for the message.
        listed: names in the table.
        photographs: names of the photographs.

    Raises:
        InputError: a name differs from that of a photograph only in upper or lower case.
    """
    by_folded = {name.casefold(): name for name in photographs if name not in listed}
    for name in listed:
        photograph = by_folded.get(name.casefold())
        if photograph is not None and name not in photographs:
            raise InputError(
                f"{path} lists {name!r}, but the photograph is called {photograph!r}: write names "
                "as the files have them"
            )


def _lines(path: Path, what: str) -> Iterator[tuple[str, str]]:
    """Yield each line with its location ``file:line``; skip comments and blank lines."""
    for number, line in enumerate(read_text(path, what).split("\n"), 1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield f"{path}:{number}", stripped


def _name(where: str, row: Mapping[str, str]) -> str:
    """Return the name of a row's photograph; ``where`` is the row's location."""
    try:
        return unquote_cell(row["name"])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


def _numbers(where: str, words: Sequence[str]) -> NDArray[np.float64]:
    """Return words as finite numbers, (N,); ``where`` is their location in the file."""
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            raise InputError(f"{where}: {word!r} is not a number") from None
        if not math.isfinite(values[-1]):
            raise InputError(f"{where}: {word!r} is not a finite number")
    return np.array(values)


def _add(table: dict[str, T], name: str, value: T, where: str) -> None:
    """Add an entry, whose name must be safe and new; ``where`` is its location."""
    if not is_safe_path(name):
        raise InputError(f"{where}: {name!r} does not lie in the folder of photographs")
    if name in table:
        raise InputError(f"{where}: {name} is listed twice: remove one of the rows")
    table[name] = value
