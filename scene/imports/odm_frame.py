"""The frame of ODM's reconstructions: metres east, north and up, or a projected system.

OpenSfM writes ``reconstruction.json`` in metres east, north and up from ``reference_lla``. ODM then
runs ``export_geocoords --reconstruction``, which moves it to a UTM zone minus an offset by one
affine map, and puts the result in the place of the first file, which it keeps as
``reconstruction.topocentric.json``. Both have the same fields and the same ``reference_lla``. They
are told apart by the file beside them, or by GPS positions of the shots, which the move leaves
along east and north.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scene.errors import InputError
from scene.geo.named_systems import NamedSystem, named_system
from scene.geometry.geodesy import FARTHEST_M, Geodetic, geodetic_from_enu
from scene.quantities.horizontal_axes import axes_of, convergence, utm_zone
from scene.storage.files import read_text

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

TOPOCENTRIC: Final = "reconstruction.topocentric.json"
"""The name under which ODM keeps the reconstruction in metres east, north and up."""

_REMEDY: Final = f"give ODM's {TOPOCENTRIC}, or keep odm_georeferencing/coords.txt beside it"
# A camera lies no further than this from the origin of its world, metres.
_FARTHEST_M: Final = 100_000.0
# Two files are of one reconstruction where a similarity maps poses so closely (m, radians, and
# parts of the extent); a projected system's scale is so near to one.
_SAME_M, _SAME_RAD, _SAME_PART, _SCALE = 0.02, 2e-3, 1e-3, 0.01
# Axes closer than this are not told apart (radians): over a flight they differ by centimetres.
_SMALL_TURN: Final = 2e-4
# Names of folders of ODM's projects.
_NAMES_ODM: Final = re.compile(r"\b(web)?odm\b|odm_|opendronemap")


@dataclass(frozen=True)
class Shots:
    """N shots of a reconstruction.

    Attributes:
        names: file names.
        world_from_cam: (N, 4, 4) in the frame of the file.
        measured: (N, 3) GPS positions, metres east, north and up; NaN where there is none.
        origin: place of the world's origin.
    """

    names: Sequence[str]
    world_from_cam: Array
    measured: Array
    origin: Geodetic

    @property
    def centres(self) -> Array:
        """Return the camera centres, (N, 3)."""
        return self.world_from_cam[:, :3, 3]


def topocentric(path: Path, shots: Shots, beside: Shots | None) -> Shots:
    """Return shots in metres east, north and up from their origin.

    Args:
        path: file of the shots.
        shots: shots as the file has them.
        beside: shots of the file ``TOPOCENTRIC`` in the same folder; None without one.

    Raises:
        InputError: the frame of the file cannot be told, or contradicts the files beside it.
    """
    if not _is_sane(shots):
        return shots  # as the file has it: ``poses.posed`` says what is wrong
    if path.name == TOPOCENTRIC or not len(shots.names):
        return _near(path, shots)
    if beside is not None and not _is_sane(beside):
        raise InputError(f"{path}: {TOPOCENTRIC} beside it has a pose that is not finite")
    if beside is not None:
        found = _from_beside(path, shots, beside)
        if found is not None:
            return found
    system = _system_of(path)
    if system is not None:
        return _from_system(path, shots, *system)
    return _near(path, _alone(path, shots))


def _is_sane(shots: Shots) -> bool:
    return bool((np.abs(shots.world_from_cam) <= FARTHEST_M).all())


def _near(path: Path, shots: Shots) -> Shots:
    """Refuse cameras that no flight around the origin has."""
    if len(shots.names) and np.abs(np.median(shots.centres[:, :2], axis=0)).max() > _FARTHEST_M:
        raise InputError(
            f"{path}: its shots are not in metres from reference_lla but in a projected system, as "
            f"export_geocoords writes: give the reconstruction from before, or {TOPOCENTRIC}"
        )
    return shots


def _from_beside(path: Path, shots: Shots, beside: Shots) -> Shots | None:
    """Return the poses of the topocentric file, where it has all shots."""
    row = {name: k for k, name in enumerate(beside.names)}
    if not set(shots.names) <= row.keys():
        return None
    there = beside.world_from_cam[[row[name] for name in shots.names]]
    if np.allclose(there, shots.world_from_cam, rtol=0, atol=1e-6):
        return shots
    if not _is_moved(shots.world_from_cam, there):
        raise InputError(
            f"{path} and {TOPOCENTRIC} beside it are of two reconstructions: give the latter, or "
            "move it away"
        )
    log.warning("%s is in a projected system: poses are those of %s", path, TOPOCENTRIC)
    return replace(shots, world_from_cam=there, origin=beside.origin)


def _is_moved(projected: Array, there: Array) -> bool:
    """Return whether a turn about the vertical, a shift and a scale near one map both."""
    left, _, right = np.linalg.svd(
        (projected[:, :3, :3] @ there[:, :3, :3].transpose(0, 2, 1)).sum(0)
    )
    turn = left @ right
    off = turn @ there[:, :3, :3] - projected[:, :3, :3]
    if np.abs(off).max() > _SAME_RAD or turn[2, 2] < math.cos(_SAME_RAD):
        return False
    own = projected[:, :3, 3] - projected[:, :3, 3].mean(0)
    other = (there[:, :3, 3] - there[:, :3, 3].mean(0)) @ turn.T
    extent = float(np.linalg.norm(other, axis=1).max())
    spread = float((other**2).sum())
    scale = float((own * other).sum()) / spread if spread > 0 else 1.0
    most = float(np.abs(own - scale * other).max())
    return abs(scale - 1) < _SCALE and most < _SAME_M + _SAME_PART * extent


def _system_of(path: Path) -> tuple[NamedSystem, Array] | None:
    """Return the projected system of ODM's project and its offset (2,), from coords.txt."""
    for folder in (path.parent / "odm_georeferencing", path.parent.parent / "odm_georeferencing"):
        for file in (folder / "coords.txt", folder / "odm_georeferencing_model_geo.txt"):
            if file.is_file():
                return _stated(file)
    beside = path.parent / "coords.txt"
    return _stated(beside) if beside.is_file() else None


def _stated(file: Path) -> tuple[NamedSystem, Array]:
    header, *rest = read_text(file, "ODM's coordinate system").split("\n")
    try:
        offset = np.array([float(word) for word in rest[0].split()])
    except (ValueError, IndexError):
        offset = np.zeros(0)
    if len(offset) != 2 or not np.isfinite(offset).all():
        raise InputError(f"{file}:2: expected the offsets east and north, as ODM writes them")
    return named_system(header, f"{file}:1"), offset


def _from_system(path: Path, shots: Shots, system: NamedSystem, offset: Array) -> Shots:
    """Undo ODM's move where GPS positions of the shots tell that there was one."""
    linear, shift = _move(path, shots.origin, system, offset)
    turn = math.atan2(linear[1, 0], linear[0, 0])
    back = _moved_back(shots, linear, shift)
    between = float(np.abs(back.world_from_cam - shots.world_from_cam).max())
    if between < _SAME_M and abs(turn) < _SMALL_TURN:
        return back
    axes = axes_of(shots.centres[:, :2], shots.measured[:, :2], turn)
    value = axes.require(
        path, f"it may be in metres east and north or in {system.projection.name}: {_REMEDY}"
    )
    if value == "east and north":
        return _near(path, shots)
    log.warning("%s is in %s: its poses are moved back", path, system.projection.name)
    return _near(path, back)


def _move(path: Path, origin: Geodetic, system: NamedSystem, offset: Array) -> tuple[Array, Array]:
    """Return the linear part (3, 3) and shift (3,) of what export_geocoords does."""
    steps = np.vstack([np.zeros(3), np.eye(3)])
    places = [geodetic_from_enu(step, origin) for step in steps]
    seen = np.array([system.projection.from_geodetic(place) for place in places])
    if not np.isfinite(seen).all():
        raise InputError(f"{path}: reference_lla is no place in {system.projection.name}")
    # OpenSfM leaves the altitude as it is: the system's own heights have no part in it.
    seen[:, 2] = [place.altitude for place in places]
    shift = seen[0] - [*offset, 0.0]
    if np.abs(shift[:2]).max() > _FARTHEST_M:
        raise InputError(f"{path}: reference_lla is not near the offset in ODM's coords.txt")
    return (seen[1:] - seen[0]).T, shift


def _moved_back(shots: Shots, linear: Array, shift: Array) -> Shots:
    left, _, right = np.linalg.svd(linear)
    there = shots.world_from_cam.copy()
    there[:, :3, :3] = (left @ right).T @ there[:, :3, :3]
    there[:, :3, 3] = np.linalg.solve(linear, (shots.centres - shift).T).T
    return replace(shots, world_from_cam=there)


def _alone(path: Path, shots: Shots) -> Shots:
    """Check the frame of a file that nothing of ODM lies beside."""
    grid = convergence(shots.origin, utm_zone(shots.origin.longitude))
    axes = axes_of(shots.centres[:, :2], shots.measured[:, :2], grid)
    if axes.value == "grid" and abs(grid) > _SMALL_TURN:
        raise InputError(
            f"{path}: its poses are in a projected system ({axes.why}, as a UTM grid is): {_REMEDY}"
        )
    told = np.isfinite(shots.measured).any() or (abs(grid) > _SMALL_TURN and _is_of_odm(path))
    if axes.value != "east and north" and told:
        log.warning(
            "%s is read as metres east and north; whether ODM has moved it to a projected system "
            "cannot be told: %s",
            path,
            axes.why,
        )
    return shots


def _is_of_odm(path: Path) -> bool:
    """Return whether the names of a file's folders are those of ODM's projects."""
    folder = path.absolute().parent
    names = [part.lower() for part in folder.parts[-2:]]
    return names[-1:] == ["opensfm"] or any(map(_NAMES_ODM.search, names))
