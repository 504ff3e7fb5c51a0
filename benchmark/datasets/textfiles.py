"""Strict readers of the text files that describe flights; errors name the file and the line."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from scene.bundle.manifest import ALL_CONDITIONS
from scene.errors import InputError
from scene.geometry.camera import MODELS, Camera
from scene.geometry.colmap_models import READ
from scene.geometry.geodesy import FARTHEST_M
from scene.geometry.pose import Pose
from scene.localizer import Prior
from scene.maps.colmap_files import check_pose
from scene.storage.files import is_safe_path, read_text
from scene.storage.names import quote_name, split_name, split_words, unquote_cell
from scene.storage.tables import read_table

_POSE: Final = ("name", "qw", "qx", "qy", "qz", "tx", "ty", "tz")
_PRIOR: Final = ("name", "e", "n", "u", "sigma_m", "qw", "qx", "qy", "qz", "sigma_deg")
_GPS: Final = ("name", "e", "n", "u")
_CONDITIONS: Final = ("name", "condition")

# Smallest sigma (metres, degrees): no receiver or gimbal is better, and weights would overflow.
_LEAST_SIGMA: Final = 1e-6

# A name ends where the model of a camera begins.
_MODEL: Final = re.compile(rf"\s+(?=({'|'.join((*MODELS, *READ))})(\s|$))")
_SPACE: Final = re.compile(r"\s+")

T = TypeVar("T")


def read_poses(path: Path, centres: bool = False) -> dict[str, Pose]:
    """Read poses from lines ``name qw qx qy qz tx ty tz``, world to camera, in metres.

    Names are written as by ``quote_name``; a name without quotes may hold spaces.

    Args:
        path: text file.
        centres: whether the last three columns are the camera's centre in the world instead of the
            translation.

    Returns:
        cam_from_world by name, in the order of the file.

    Raises:
        InputError: the file cannot be read, or a line has the wrong number of columns, a word that
            is not a finite number, a quaternion off unit length by more than 0.001, a camera
            farther away than any place on earth, or a name that was given before.
    """
    poses: dict[str, Pose] = {}
    for where, line in _lines(path, "pose file"):
        try:
            name, numbers = split_name(line, len(_POSE) - 1)
        except ValueError as error:
            raise InputError(
                f"{where}: expected {len(_POSE)} columns ({' '.join(_POSE)}), {error}"
            ) from None
        values = _numbers(where, numbers)
        check_pose(values[:4], values[4:], f"{where}: {name}")
        pose = Pose.from_quaternion(values[:4], values[4:])
        if centres:
            pose = Pose(pose.rotation, -(pose.rotation @ pose.translation))
        _add(poses, name, pose, where)
    return poses


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
    """Split a line into name and camera; the name may hold spaces before a camera's model."""
    if line.startswith('"'):
        name, *rest = split_words(line)
        return name, Camera.parse(rest)
    model = _MODEL.search(line) or _SPACE.search(line)
    if model is None:
        return line, Camera.parse([])
    return line[: model.start()], Camera.parse(line[model.end() :].split())


def read_pairs(path: Path) -> dict[str, tuple[str, ...]]:
    """Read a pair list of hloc, which has lines ``query reference``.

    Returns:
        References by query, both in the order of the file.

    Raises:
        InputError: the file cannot be read, a line does not have two names, or there is no line.
    """
    pairs: dict[str, list[str]] = {}
    for where, line in _lines(path, "pair list"):
        try:
            query, reference = split_words(line)
        except ValueError:
            raise InputError(
                f"{where}: expected 'query reference', got {line!r}; names with spaces stand in "
                "double quotes"
            ) from None
        pairs.setdefault(query, []).append(reference)
    if not pairs:
        raise InputError(f"pair list {path} holds no pair")
    return {query: tuple(references) for query, references in pairs.items()}


def read_priors(path: Path) -> dict[str, Prior]:
    """Read priors from a table ``name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg``.

    Positions are in metres, attitudes are cam_from_world, and sigmas hold per axis.

    Returns:
        Priors by photograph, in the order of the file.

    Raises:
        InputError: as for ``read_poses``, or a sigma is not positive or out of range.
    """
    priors: dict[str, Prior] = {}
    for where, row in read_table(path, "priors", _PRIOR):
        numbers = _numbers(where, [row[column] for column in _PRIOR[1:]])
        position, sigma, quaternion, sigma_deg = numbers[:3], numbers[3], numbers[4:8], numbers[8]
        check_pose(quaternion, position, f"{where}: {row['name']}")
        if sigma <= 0 or sigma_deg <= 0:
            raise InputError(f"{where}: sigma_m and sigma_deg must be positive")
        if not (min(sigma, sigma_deg) >= _LEAST_SIGMA and max(sigma, sigma_deg) <= FARTHEST_M):
            raise InputError(
                f"{where}: sigma_m and sigma_deg must lie between {_LEAST_SIGMA:g} and "
                f"{FARTHEST_M:g}"
            )
        rotation = Pose.from_quaternion(quaternion, np.zeros(3)).rotation.numpy()
        prior = Prior(position, np.full(3, sigma), rotation, float(sigma_deg))
        _add(priors, _name(where, row), prior, where)
    return priors


def read_gps(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the columns ``name``, ``e``, ``n``, ``u`` of a ``gps.csv``.

    Returns:
        (3,) east, north, up in metres by photograph, in the order of the file.

    Raises:
        InputError: the file cannot be read, a column is missing, a row has the wrong number of
            columns, a word that is not a finite number, a place that is not on earth, or a name
            that was given before.
    """
    fixes: dict[str, NDArray[np.float64]] = {}
    for where, row in read_table(path, "GPS table", _GPS):
        position = _numbers(where, [row[column] for column in _GPS[1:]])
        if np.abs(position).max() > FARTHEST_M:
            raise InputError(f"{where}: {row['name']} lies more than {FARTHEST_M:g} m away")
        _add(fixes, _name(where, row), position, where)
    return fixes


def read_conditions(path: Path) -> dict[str, str]:
    """Read the columns ``name``, ``condition`` of a ``conditions.csv``.

    Returns:
        The condition of each photograph, such as ``winter-dusk``, in the order of the file.

    Raises:
        InputError: the file cannot be read, a column is missing, a row has the wrong number of
            columns, a condition that is empty, not printable or called "all", or a name that was
            given before.
    """
    conditions: dict[str, str] = {}
    for where, row in read_table(path, "table of conditions", _CONDITIONS):
        condition = row["condition"].strip()
        if not condition or not condition.isprintable() or condition == ALL_CONDITIONS:
            raise InputError(f"{where}: {condition!r} is no condition: give a name as winter-dusk")
        _add(conditions, _name(where, row), condition, where)
    return conditions


def require_same_case(path: Path, listed: Collection[str], photographs: Collection[str]) -> None:
    """Refuse a table whose names differ from those of the photographs in upper or lower case.

    Without this check every row of such a table would silently go unused.

    Args:
        path: file of the table, for the message.
        listed: names in the table.
        photographs: names of the photographs.

    Raises:
        InputError: a name of the table equals a photograph's but for upper or lower case.
    """
    of = {name.casefold(): name for name in photographs if name not in listed}
    for name in listed:
        photograph = of.get(name.casefold())
        if photograph is not None and name not in photographs:
            raise InputError(
                f"{path} lists {name!r}, but the photograph is called {photograph!r}: write names "
                "as the files have them"
            )


def _lines(path: Path, what: str) -> Iterator[tuple[str, str]]:
    """Yield each line with its place ``file:line``; skip comments and blank lines."""
    for number, line in enumerate(read_text(path, what).split("\n"), 1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield f"{path}:{number}", stripped


def _name(where: str, row: Mapping[str, str]) -> str:
    """Return the photograph that a row of a table is about; ``where`` is the row's place."""
    try:
        return unquote_cell(row["name"])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


def _numbers(where: str, words: Sequence[str]) -> NDArray[np.float64]:
    """Return words as finite numbers, (N,); ``where`` is their place in the file."""
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
    """Add an entry to a table that must not hold its name yet; ``where`` is its place."""
    if not is_safe_path(name):
        raise InputError(f"{where}: {name!r} does not lie in the folder of photographs")
    if name in table:
        raise InputError(f"{where}: {name} is listed twice")
    table[name] = value
