"""Strict readers of the text files that describe flights; every fault is named by file and line."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from scene.camera import Camera
from scene.colmap_files import check_pose
from scene.errors import InputError
from scene.files import inside, read_text
from scene.localizer import Prior
from scene.pose import Pose

_POSE: Final = ("name", "qw", "qx", "qy", "qz", "tx", "ty", "tz")
_PRIOR: Final = ("name", "e", "n", "u", "sigma_m", "qw", "qx", "qy", "qz", "sigma_deg")
_GPS: Final = ("name", "e", "n", "u")

T = TypeVar("T")


def read_poses(path: Path, centres: bool = False) -> dict[str, Pose]:
    """Read ``name qw qx qy qz tx ty tz`` lines, world to camera, metres; in the file's order.

    Args:
        path: of the file.
        centres: the last three columns are the camera's centre in the world, not the translation.

    Raises:
        InputError: unreadable file, wrong number of columns, a number that is none or not finite, a
            quaternion off unit length by more than 0.001, or a name given twice.
    """
    poses: dict[str, Pose] = {}
    for where, words in _lines(path, "pose file"):
        if len(words) != len(_POSE):
            raise InputError(
                f"{where}: expected {len(_POSE)} columns ({' '.join(_POSE)}), got {len(words)}"
            )
        numbers = _numbers(where, words[1:])
        check_pose(numbers[:4], numbers[4:], f"{where}: {words[0]}")
        pose = Pose.from_quaternion(numbers[:4], numbers[4:])
        if centres:
            pose = Pose(pose.rotation, -(pose.rotation @ pose.translation))
        _add(poses, words[0], pose, where)
    return poses


def pose_line(name: str, cam_from_world: Pose, decimals: int) -> str:
    """A line that ``read_poses`` reads, without its end: ``name qw qx qy qz tx ty tz``."""
    numbers = [*cam_from_world.quaternion().tolist(), *cam_from_world.translation.tolist()]
    return " ".join([name, *(f"{number:.{decimals}f}" for number in numbers)])


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read ``name MODEL width height params...`` lines; in the file's order.

    Raises:
        InputError: unreadable file, a line that is no camera, or a name given twice.
    """
    cameras: dict[str, Camera] = {}
    for where, words in _lines(path, "query list"):
        try:
            _add(cameras, words[0], Camera.parse(words[1:]), where)
        except InputError as error:
            message = str(error)
            raise InputError(
                message if message.startswith(where) else f"{where}: {error}"
            ) from None
    return cameras


def read_priors(path: Path) -> dict[str, Prior]:
    """Read ``name,e,n,u,sigma_m,qw,qx,qy,qz,sigma_deg``: positions and attitudes with their sigmas.

    Raises:
        InputError: as ``read_poses``, or a sigma that is not positive.
    """
    priors: dict[str, Prior] = {}
    for where, row in _table(path, "priors", _PRIOR):
        numbers = _numbers(where, [row[column] for column in _PRIOR[1:]])
        position, sigma, quaternion, sigma_deg = numbers[:3], numbers[3], numbers[4:8], numbers[8]
        check_pose(quaternion, position, f"{where}: {row['name']}")
        if sigma <= 0 or sigma_deg <= 0:
            raise InputError(f"{where}: sigma_m and sigma_deg must be positive")
        rotation = Pose.from_quaternion(quaternion, np.zeros(3)).rotation.numpy()
        prior = Prior(position, np.full(3, sigma), rotation, float(sigma_deg))
        _add(priors, row["name"], prior, where)
    return priors


def read_gps(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the columns ``name``, ``e``, ``n``, ``u`` of a ``gps.csv``: (3,) metres by photograph.

    Raises:
        InputError: unreadable file, a missing column, wrong number of columns, a number that is
            none or not finite, or a name given twice.
    """
    fixes: dict[str, NDArray[np.float64]] = {}
    for where, row in _table(path, "GPS table", _GPS):
        _add(fixes, row["name"], _numbers(where, [row[column] for column in _GPS[1:]]), where)
    return fixes


def _lines(path: Path, what: str) -> Iterator[tuple[str, list[str]]]:
    """Where each line is, as ``file:line``, and its words; comments and blank lines are skipped."""
    for number, line in enumerate(read_text(path, what).splitlines(), 1):
        words = line.split()
        if words and not words[0].startswith("#"):
            yield f"{path}:{number}", words


def _table(path: Path, what: str, columns: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Where each row of a CSV file is, and its values by column; other columns may be there too."""
    rows = csv.reader(read_text(path, what).splitlines())
    header = [name.strip() for name in next(rows, [])]
    missing = [column for column in columns if column not in header]
    if missing:
        raise InputError(f"{path}:1: {what} lacks the column {', '.join(missing)}")
    for values in rows:
        where = f"{path}:{rows.line_num}"
        if values and len(values) != len(header):
            raise InputError(f"{where}: expected {len(header)} columns, got {len(values)}")
        if values:
            yield where, dict(zip(header, (v.strip() for v in values), strict=True))


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
