"""The result of a reader of poses, the description of a format, and checks of poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import FARTHEST_M, Geodetic

CoordinateFrame = Literal["topocentric", "projected"]
"""The coordinate frame of poses: metres east, north and up of an origin, or coordinates of a
projected system, such as UTM."""

# Largest deviation of a rotation matrix from orthonormal rows; files hold six digits or more.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class ForeignPoses:
    """N photographs of another program, in this project's conventions.

    Attributes:
        names: unique names as in the file: paths, file names, or labels without a suffix; times in
            seconds for a trajectory.
        cameras: calibrated camera of each photograph; None if the file has none.
        cam_from_world: (N, 4, 4) float64, OpenCV axes; NaN if the file has positions only.
        positions: camera centres, (N, 3) float64 in the file's world.
        origin: geodetic origin of a world that is east-north-up in metres; None if the file states
            no origin. Scale and vertical direction of the world may then be arbitrary.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera | None, ...]
    cam_from_world: NDArray[np.float64]
    positions: NDArray[np.float64]
    origin: Geodetic | None

    @property
    def has_attitude(self) -> bool:
        """Return whether the file has poses rather than positions only."""
        return bool(np.isfinite(self.cam_from_world).all())

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Format:
    """A reader of one format.

    Attributes:
        matches: returns whether a path is of this format, whole or damaged, from its name and first
            bytes.
        read: reads a path, and raises InputError for a missing or invalid file.
        description: phrase for such a file or folder in error messages.
        read_in_frame: reads a path with the coordinate frame that the user states; None if the
            format determines the frame.
    """

    matches: Callable[[Path], bool]
    read: Callable[[Path], ForeignPoses]
    description: str
    read_in_frame: Callable[[Path, CoordinateFrame | None], ForeignPoses] | None = None


def check_poses(
    path: Path,
    names: Sequence[str],
    cameras: Sequence[Camera | None],
    world_from_cam: NDArray[np.float64],
    origin: Geodetic | None = None,
) -> ForeignPoses:
    """Return poses after checking them; rotations become exactly orthonormal.

    Args:
        path: file or folder, for messages.
        names: N names.
        cameras: N cameras.
        world_from_cam: (N, 4, 4).
        origin: as in ``ForeignPoses``.

    Raises:
        InputError: there is no photograph, a name is repeated, a number is not finite, a camera is
            not on earth, or a matrix is not a rotation.
    """
    _require_names(path, names)
    rotation, centres = world_from_cam[:, :3, :3], world_from_cam[:, :3, 3]
    _require_finite(path, names, world_from_cam.reshape(len(names), -1), centres)
    left, _, right = np.linalg.svd(rotation)
    nearest = left @ right
    deviation = np.abs(nearest - rotation).max((1, 2))
    wrong = (deviation > _ROTATION_TOLERANCE) | (np.linalg.det(nearest) < 0)
    if wrong.any():
        name = names[int(np.flatnonzero(wrong)[0])]
        raise InputError(
            f"{path}: the rotation of {name!r} is scaled, sheared or mirrored: write a rotation "
            "matrix, with orthonormal rows and determinant 1"
        )
    cam_from_world = np.tile(np.eye(4), (len(names), 1, 1))
    cam_from_world[:, :3, :3] = nearest.transpose(0, 2, 1)
    cam_from_world[:, :3, 3] = -(cam_from_world[:, :3, :3] @ centres[..., None])[..., 0]
    return ForeignPoses(tuple(names), tuple(cameras), cam_from_world, centres.copy(), origin)


def check_positions(
    path: Path, names: Sequence[str], positions: NDArray[np.float64], origin: Geodetic | None
) -> ForeignPoses:
    """Return positions (N, 3) without attitudes after checking them; see ``check_poses``."""
    _require_names(path, names)
    _require_finite(path, names, positions, positions)
    unknown = np.full((len(names), 4, 4), np.nan)
    return ForeignPoses(tuple(names), (None,) * len(names), unknown, positions, origin)


def begins_with(path: Path, first: str) -> bool:
    """Return whether the first character of a file, ignoring white space, is ``first``."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(256)
    except OSError:
        return False
    return head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == first.encode()


def _require_names(path: Path, names: Sequence[str]) -> None:
    if not names:
        raise InputError(f"{path} has no photograph with a pose")
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(f"{path}: {name!r} is listed twice")
        seen.add(name)


def _require_finite(
    path: Path, names: Sequence[str], values: NDArray[np.float64], centres: NDArray[np.float64]
) -> None:
    bad = ~np.isfinite(values).all(1) | ~(np.abs(centres) <= FARTHEST_M).all(1)
    if bad.any():
        name = names[int(np.flatnonzero(bad)[0])]
        raise InputError(f"{path}: {name!r} has a pose that is not finite or not on earth")
