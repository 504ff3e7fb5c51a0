"""The frame of ODM's reconstructions: metres east, north and up, or a projected system.

OpenSfM writes ``reconstruction.json`` in metres east, north and up from ``reference_lla``. ODM then
runs ``export_geocoords --reconstruction``, which transforms the reconstruction to a UTM zone minus
an offset and overwrites the file; the original is kept as ``reconstruction.topocentric.json``. Both
files have the same fields and the same ``reference_lla``. The frame is inferred from the other
file, from the file name, from the GPS positions of the shots (which stay along east and north),
from a project of plain OpenSfM (which transforms nothing), or it is stated by the user. It is an
error if the frame remains unknown or if two sources contradict each other.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.named_systems import NamedSystem, parse_system
from objconnect.scene.geometry.geodesy import FARTHEST_M, Geodetic, geodetic_from_enu, is_same_place
from objconnect.scene.imports.poses import CoordinateFrame
from objconnect.scene.quantities.horizontal_axes import Axes, convergence, infer_axes, utm_zone
from objconnect.scene.quantities.reading import Reading, known, unknown
from objconnect.scene.storage.files import read_text

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

TOPOCENTRIC: Final = "reconstruction.topocentric.json"
"""ODM's name of the reconstruction in metres east, north and up."""

_REMEDY: Final = f"give ODM's {TOPOCENTRIC}, or keep odm_georeferencing/coords.txt in its project"
_FRAME_OF_NAME: Final[dict[str, CoordinateFrame]] = {
    TOPOCENTRIC: "topocentric",
    "reconstruction.geocoords.json": "projected",  # written by OpenSfM's export_geocoords
}
_FRAME_OF_AXES: Final[dict[Axes, CoordinateFrame]] = {
    "east and north": "topocentric",
    "grid": "projected",
}
_OPTION: Final = "--poses-frame"
# A folder of plain OpenSfM has all of these; ODM has a list of photographs instead of images.
_OPENSFM_FILES: Final = ("images", "exif", "camera_models.json")
_ODM_FILE: Final = "image_list.txt"
# Largest distance of a camera from the origin of its world, metres.
_MAX_ORIGIN_DISTANCE_M: Final = 100_000.0
# Two files hold one reconstruction if a similarity maps their poses within these tolerances (m,
# radians, share of the extent) with a scale this near to one.
_SAME_M, _SAME_RAD, _SAME_SHARE, _SAME_SCALE = 0.02, 2e-3, 1e-3, 0.01
# Axes closer than this (radians) are treated as equal: over a flight they differ by centimetres.
_SMALL_ANGLE: Final = 2e-4


@dataclass(frozen=True)
class Shots:
    """N shots of a reconstruction.

    Attributes:
        names: file names.
        world_from_cam: (N, 4, 4) in the frame of the file.
        gps_positions: (N, 3) metres east, north and up; NaN if not measured.
        origin: geodetic origin of the world.
        frame: frame that the file states; None if it states none.
    """

    names: Sequence[str]
    world_from_cam: Array
    gps_positions: Array
    origin: Geodetic
    frame: CoordinateFrame | None = None

    @property
    def centres(self) -> Array:
        """Return the camera centres, (N, 3)."""
        return self.world_from_cam[:, :3, 3]


def convert_to_topocentric(
    path: Path, shots: Shots, sibling: Shots | None, stated: CoordinateFrame | None = None
) -> Shots:
    """Return shots in metres east, north and up from their origin.

    Args:
        path: file of the shots.
        shots: shots in the frame of the file.
        sibling: shots of the file ``TOPOCENTRIC`` in the same folder; None without one.
        stated: frame that the user states; None if not stated.

    Raises:
        InputError: the frame of the file is unknown, or contradicts the files beside it or the
            user.
    """
    if not _has_finite_poses(shots) or not len(shots.names):
        return shots  # unchanged, because ``check_poses`` reports the error
    if path.name == TOPOCENTRIC:
        return _check_without_coords(path, shots, stated)
    if sibling is not None and not _has_finite_poses(sibling):
        raise InputError(f"{path}: {TOPOCENTRIC} beside it has a pose that is not finite")
    if sibling is not None:
        topocentric_shots = _take_from_sibling(path, shots, sibling, stated)
        if topocentric_shots is not None:
            return topocentric_shots
    system = _find_system(path)
    if system is not None:
        return _undo_system(path, shots, *system, stated)
    return _check_without_coords(path, shots, stated)


def _has_finite_poses(shots: Shots) -> bool:
    return bool((np.abs(shots.world_from_cam) <= FARTHEST_M).all())


def _require_near_origin(path: Path, shots: Shots) -> Shots:
    """Return the shots, or raise ``InputError`` if the cameras are too far from the origin."""
    if np.abs(np.median(shots.centres[:, :2], axis=0)).max() > _MAX_ORIGIN_DISTANCE_M:
        raise InputError(
            f"{path}: its shots are not in metres from reference_lla but in a projected system, as "
            f"export_geocoords writes: give OpenSfM's own reconstruction, or {TOPOCENTRIC}"
        )
    return shots


def _take_from_sibling(
    path: Path, shots: Shots, sibling: Shots, stated: CoordinateFrame | None
) -> Shots | None:
    """Return the shots with the poses of the topocentric file; None if that lacks a shot."""
    row = {name: k for k, name in enumerate(sibling.names)}
    if not set(shots.names) <= row.keys():
        return None
    if not is_same_place(shots.origin, sibling.origin, _SAME_M):
        raise InputError(
            f"{path}: its reference_lla differs from that of {TOPOCENTRIC} beside it: remove the "
            "file of the other reconstruction"
        )
    topocentric_poses = sibling.world_from_cam[[row[name] for name in shots.names]]
    if np.allclose(topocentric_poses, shots.world_from_cam, rtol=0, atol=1e-6):
        _require_agreement(path, {f"{TOPOCENTRIC} beside it": "topocentric", _OPTION: stated})
        return shots
    if not _is_transformed(shots.world_from_cam, topocentric_poses):
        raise InputError(
            f"{path} and {TOPOCENTRIC} beside it hold different reconstructions: give "
            f"{TOPOCENTRIC}, or move one of the files to another folder"
        )
    _require_agreement(path, {f"{TOPOCENTRIC} beside it": "projected", _OPTION: stated})
    log.warning("%s is in a projected system: poses are those of %s", path, TOPOCENTRIC)
    return replace(shots, world_from_cam=topocentric_poses, origin=sibling.origin)


def _is_transformed(projected: Array, enu_poses: Array) -> bool:
    """Return whether two sets of poses differ by shift, scale and rotation about the vertical.

    The scale must be near one.

    Args:
        projected: (N, 4, 4) world_from_cam.
        enu_poses: (N, 4, 4) world_from_cam in metres east, north and up.
    """
    left, _, right = np.linalg.svd(
        (projected[:, :3, :3] @ enu_poses[:, :3, :3].transpose(0, 2, 1)).sum(0)
    )
    rotation = left @ right
    residual = rotation @ enu_poses[:, :3, :3] - projected[:, :3, :3]
    if np.abs(residual).max() > _SAME_RAD or rotation[2, 2] < math.cos(_SAME_RAD):
        return False
    projected_centres = projected[:, :3, 3] - projected[:, :3, 3].mean(0)
    enu_centres = (enu_poses[:, :3, 3] - enu_poses[:, :3, 3].mean(0)) @ rotation.T
    extent = float(np.linalg.norm(enu_centres, axis=1).max())
    spread = float((enu_centres**2).sum())
    scale = float((projected_centres * enu_centres).sum()) / spread if spread > 0 else 1.0
    distance = float(np.abs(projected_centres - scale * enu_centres).max())
    return abs(scale - 1) < _SAME_SCALE and distance < _SAME_M + _SAME_SHARE * extent


def _find_system(path: Path) -> tuple[NamedSystem, Array] | None:
    """Return the projected system of ODM's project and its offset (2,), from coords.txt."""
    # The path is made absolute, because ``parent.parent`` of a relative one may equal ``parent``.
    parent = path.parent.resolve()
    for folder in (parent / "odm_georeferencing", parent.parent / "odm_georeferencing"):
        for file in (folder / "coords.txt", folder / "odm_georeferencing_model_geo.txt"):
            if file.is_file():
                return _read_system(file)
    file = parent / "coords.txt"
    return _read_system(file) if file.is_file() else None


def _read_system(file: Path) -> tuple[NamedSystem, Array]:
    header, *rest = read_text(file, "ODM's coordinate system").split("\n")
    try:
        offset = np.array([float(word) for word in rest[0].split()])
    except (ValueError, IndexError):
        offset = np.zeros(0)
    if len(offset) != 2 or not np.isfinite(offset).all():
        raise InputError(f"{file}:2: expected the offsets east and north, as ODM writes them")
    return parse_system(header, f"{file}:1"), offset


def _undo_system(
    path: Path, shots: Shots, system: NamedSystem, offset: Array, stated: CoordinateFrame | None
) -> Shots:
    """Return the shots with ODM's transform undone, if the file was transformed."""
    linear, shift = _export_transform(path, shots.origin, system, offset)
    angle = math.atan2(linear[1, 0], linear[0, 0])
    topocentric_shots = _undo_transform(shots, linear, shift)
    difference = float(np.abs(topocentric_shots.world_from_cam - shots.world_from_cam).max())
    if difference < _SAME_M and abs(angle) < _SMALL_ANGLE:
        return topocentric_shots
    if _find_frame(path, shots, angle, stated, system.projection.name).value == "topocentric":
        return _require_near_origin(path, shots)
    log.warning("%s is in %s: its poses are transformed back", path, system.projection.name)
    return _require_near_origin(path, topocentric_shots)


def _export_transform(
    path: Path, origin: Geodetic, system: NamedSystem, offset: Array
) -> tuple[Array, Array]:
    """Return the linear part (3, 3) and shift (3,) of the affine map of export_geocoords."""
    steps = np.vstack([np.zeros(3), np.eye(3)])
    places = [geodetic_from_enu(step, origin) for step in steps]
    projected = np.array([system.projection.from_geodetic(place) for place in places])
    if not np.isfinite(projected).all():
        raise InputError(f"{path}: reference_lla is not a place in {system.projection.name}")
    # OpenSfM keeps the altitude: the system's own heights do not matter.
    projected[:, 2] = [place.altitude for place in places]
    shift = projected[0] - [*offset, 0.0]
    if np.abs(shift[:2]).max() > _MAX_ORIGIN_DISTANCE_M:
        raise InputError(f"{path}: reference_lla is not near the offset in ODM's coords.txt")
    return (projected[1:] - projected[0]).T, shift


def _undo_transform(shots: Shots, linear: Array, shift: Array) -> Shots:
    """Return the shots before the affine map of export_geocoords."""
    left, _, right = np.linalg.svd(linear)
    world_from_cam = shots.world_from_cam.copy()
    world_from_cam[:, :3, :3] = (left @ right).T @ world_from_cam[:, :3, :3]
    world_from_cam[:, :3, 3] = np.linalg.solve(linear, (shots.centres - shift).T).T
    return replace(shots, world_from_cam=world_from_cam)


def _check_without_coords(path: Path, shots: Shots, stated: CoordinateFrame | None) -> Shots:
    """Check the frame of a file without ODM's coords.txt, or of the file ``TOPOCENTRIC``."""
    _require_near_origin(path, shots)
    zone = utm_zone(shots.origin.longitude)
    grid = f"a UTM grid, such as zone {zone}"
    frame = _find_frame(path, shots, convergence(shots.origin, zone), stated, grid)
    if frame.value == "projected":
        raise InputError(
            f"{path}: its poses are in a projected system according to {frame.source}, and its "
            f"offset is unknown: {_REMEDY}"
        )
    return shots


def _find_frame(
    path: Path, shots: Shots, angle: float, stated: CoordinateFrame | None, grid: str
) -> Reading[CoordinateFrame]:
    """Return the frame of a file on which all sources agree.

    Args:
        path: file of the shots.
        shots: shots in the frame of the file.
        angle: meridian convergence of the projected system, radians, as ``convergence`` returns it.
        stated: frame that the user states.
        grid: name of the projected system, for messages.

    Raises:
        InputError: no source states the frame, or two contradict each other.
    """
    axes = infer_axes(shots.centres[:, :2], shots.gps_positions[:, :2], angle)
    why, gps_frame = axes.why, None
    if axes.value is not None and abs(angle) > _SMALL_ANGLE:
        gps_frame = _FRAME_OF_AXES[axes.value]
    elif axes.value is not None:
        degrees = math.degrees(_SMALL_ANGLE)
        why = f"{axes.source} cannot distinguish axes within {degrees:.2g} degrees"
    frame = _require_agreement(
        path,
        {
            "its name": _FRAME_OF_NAME.get(path.name),
            f"gps_position ({why})" if why else "gps_position": gps_frame,
            "its field frame": shots.frame,
            "the OpenSfM project that holds it": "topocentric"
            if _is_plain_opensfm(path.parent)
            else None,
            _OPTION: stated,
        },
    )
    if not frame.is_known:
        raise InputError(
            f"{path}: whether its poses are topocentric (metres east and north of reference_lla) "
            f"or projected ({grid}) cannot be determined ({why}): {_REMEDY}, or state {_OPTION}"
        )
    return frame


def _require_agreement(
    path: Path, sources: Mapping[str, CoordinateFrame | None]
) -> Reading[CoordinateFrame]:
    """Return the frame that the sources state; unknown if none states one.

    Raises:
        InputError: two sources contradict each other.
    """
    stated = [(source, frame) for source, frame in sources.items() if frame is not None]
    if not stated:
        return unknown(", ".join(sources))
    first, frame = stated[0]
    for source, other in stated[1:]:
        if other != frame:
            remedy = f"leave out {_OPTION}" if source == _OPTION else "give OpenSfM's own file"
            raise InputError(
                f"{path}: its poses are {frame} according to {first}, but {other} according to "
                f"{source}: {remedy}"
            )
    return known(frame, first)


def _is_plain_opensfm(folder: Path) -> bool:
    """Return whether a folder is a project of plain OpenSfM, not of ODM."""
    is_project = all((folder / name).exists() for name in _OPENSFM_FILES)
    return is_project and not (folder / _ODM_FILE).exists()
