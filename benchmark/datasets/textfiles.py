"""Strict readers of the text files that describe flights; every fault is named by file and line."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from scene.geometry.camera import MODELS, Camera
from scene.geometry.pose import FARTHEST_M, Pose
from scene.localizer import Prior
from scene.maps.colmap_files import check_pose
from scene.storage.files import inside, read_text
from scene.storage.names import from_cell, leading_name, words, written
from scene.storage.tables import read_table

_POSE: Final = ("name", "qw", "qx", "qy", "qz", "tx", "ty", "tz")
_PRIOR: Final = ("name", "e", "n", "u", "sigma_m", "qw", "qx", "qy", "qz", "sigma_deg")
_GPS: Final = ("name", "e", "n", "u")

# A sigma below this (m, deg) is none of a receiver or a gimbal, and weights beyond all numbers.
_LEAST_SIGMA: Final = 1e-6

# A name ends where the model of a camera begins.
_MODEL: Final = re.compile(rf"\s+(?=({'|'.join(MODELS)})(\s|$))")
_SPACE: Final = re.compile(r"\s+")

T = TypeVar("T")


def read_poses(path: Path, centres: bool = False) -> dict[str, Pose]:
    """Read ``name qw qx qy qz tx ty tz`` lines, world to camera, metres; in the file's order.

    Names are as ``scene.storage.names.written`` has them; one without quotes may hold spaces, too.

    Args:
        path: of the file.
        centres: the last three columns are the camera's centre in the world, not the translation.

    Raises:
        InputError: unreadable file, wrong number of columns, a number that is none or not finite, a
            quaternion off unit length by more than 0.001, a camera further from the map than
            anything on earth, or a name given twice.
    """
    poses: dict[str, Pose] = {}
    for where, line in _lines(path, "pose file"):
        try:
            name, numbers = leading_name(line, len(_POSE) - 1)
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
    """A line that ``read_poses`` reads, without its end: ``name qw qx qy qz tx ty tz``."""
    numbers = [*cam_from_world.quaternion().tolist(), *cam_from_world.translation.tolist()]
    return " ".join([written(name), *(f"{number:.{decimals}f}" for number in numbers)])


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read ``name MODEL width height params...`` lines; in the file's order.

    Raises:
        InputError: unreadable file, a line that is no camera, or a name given twice.
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
    """A name, which may hold spaces where a camera's model follows it, and the camera."""
    if line.startswith('"'):
        name, *rest = words(line)
        return name, Camera.parse(rest)
    model = _MODEL.search(line) or _SPACE.search(line)
    if model is None:
        return line, Camera.parse([])
    return line[: model.start()], Camera.parse(line[model.end() :].split())


def read_pairs(path: Path) -> dict[str, tuple[str, ...]]:
    """Read the pair list of hloc: lines ``query reference``; references by query, in order.

    Raises:
        InputError: unreadable file, a line of other than two names, or no line.
    """
    pairs: dict[str, list[str]] = {}
    for where, line in _lines(path, "pair list"):
        try:
            query, reference = words(line)
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
    """Read ``name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg``: positions and attitudes with their sigmas.

    Raises:
        InputError: as ``read_poses``, or a sigma that is not positive.
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
    """Read the columns ``name``, ``e``, ``n``, ``u`` of a ``gps.csv``: (3,) metres by photograph.

    Raises:
        InputError: unreadable file, a missing column, wrong number of columns, a number that is
            none, not finite or not on earth, or a name given twice.
    """
    fixes: dict[str, NDArray[np.float64]] = {}
    for where, row in read_table(path, "GPS table", _GPS):
        position = _numbers(where, [row[column] for column in _GPS[1:]])
        if np.abs(position).max() > FARTHEST_M:
            raise InputError(f"{where}: {row['name']} lies more than {FARTHEST_M:g} m away")
        _add(fixes, _name(where, row), position, where)
    return fixes


def require_same_case(path: Path, listed: Collection[str], photographs: Collection[str]) -> None:
    """Refuse a table whose names differ from those of the photographs in capitals alone: on another
    file system, or after a rename, every row of it would go unused without a word.

    Args:
        path: of the table.
        listed: names in it.
        photographs: names they may be of.

    Raises:
        InputError: it names a photograph only so.
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
    """Where each line is, as ``file:line``, and the line; comments and blank lines are skipped."""
    for number, line in enumerate(read_text(path, what).split("\n"), 1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield f"{path}:{number}", stripped


def _name(where: str, row: Mapping[str, str]) -> str:
    try:
        return from_cell(row["name"])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


def _numbers(where: str, words: Sequence[str]) -> NDArray[np.float64]:
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
    if not inside(name):
        raise InputError(f"{where}: {name!r} does not lie in the folder of photographs")
    if name in table:
        raise InputError(f"{where}: {name} is listed twice")
    table[name] = value
