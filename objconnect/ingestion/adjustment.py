"""Georegister a model of structure from motion by GPS, and bundle-adjust it in the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.georegister import Georegistration, georegister
from objconnect.ingestion.gps_delay import estimate_motions, find_delay, undo_delay
from objconnect.scene.colmap.structure_from_motion import (
    MeasuredPositions,
    RefinedLenses,
    adjust_to_positions,
)
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.atomic import atomic_folder

Array = NDArray[np.float64]

NO_ALTITUDE_SIGMA_M: Final = 1e4
"""Standard deviation of an altitude that is unknown or ignored (m)."""

# Focal lengths of EXIF are adjusted where depths within a picture differ by more than this share.
# Over flatter ground, EXIF is better than an estimate.
_MIN_RELIEF: Final = 0.25
# Principal points are adjusted where the mean of the x axes (unit vectors) of a lens's cameras is
# shorter than this. If all cameras face one way, a principal point cannot be distinguished from
# a shift.
_MAX_COMMON_DIRECTION: Final = 0.8
# Principal points are refined only where this reduces the reprojection error by more than this
# share. Otherwise errors of GPS would move them.
_MIN_GAIN: Final = 0.002
# Maximum number of estimates of the delay of GPS behind the photographs. Each one moves the camera
# centres, and so changes the velocities that the next estimate uses.
_MAX_DELAY_ESTIMATES: Final = 3


@dataclass(frozen=True)
class AdjustedModel:
    """A georegistered and adjusted model.

    Attributes:
        model: The adjusted model, in world metres.
        georegistration: The georegistration before the adjustment. Its ``level`` is "control" if
            the model was adjusted to control points.
        refined: The lens parameters that were adjusted.
        delay: Seconds by which fixes lag behind the photographs; 0 where unknown.
        undelayed_fixes: Fixes (3,) with the delay removed, by name, world metres; empty without a
            delay.
        folder: Folder of the COLMAP model as it was written; the coordinates of ``model`` may have
            been transformed since.
    """

    model: SparseMap
    georegistration: Georegistration
    refined: RefinedLenses
    delay: float
    undelayed_fixes: Mapping[str, Array]
    folder: Path


def adjust(
    model_path: Path,
    photographs: Sequence[Photograph],
    fixes: Mapping[str, Array],
    times: Mapping[str, float],
    work: Path,
) -> AdjustedModel:
    """Georegister a model by GPS and adjust it to keypoints and GPS.

    Args:
        model_path: Folder of the model.
        photographs: Photographs in the order they were taken; some may not be in the model.
        fixes: Measured positions (3,) by name, world metres.
        times: Time stamps in seconds, by name.
        work: Folder for the adjusted model.

    Raises:
        InputError: For the reasons of ``georegister``.
    """
    raw = read_model(model_path)
    order = [photograph.name for photograph in photographs if photograph.name in raw.images]
    georegistration, delay, used = _georegister_with_delay(raw, order, fixes, times)
    positions = {n: used[n] for n in raw.names if n in used and n not in georegistration.blunders}
    sigma = np.minimum(georegistration.sigma, NO_ALTITUDE_SIGMA_M)
    without_altitude = find_missing_altitudes(positions)
    if georegistration.level == "ground":
        without_altitude = set(positions)
    for name in positions:
        if name in without_altitude:
            height = georegistration.apply(raw.images[name].centre[None])[0, 2]
            positions[name] = np.array([*positions[name][:2], height])
    has_relief = _relief(raw) > _MIN_RELIEF
    focal = {p.lens for p in photographs if not p.calibrated and (has_relief or not p.focal_known)}

    def solve(principal_point: bool) -> AdjustedModel:
        out = work / ("adjusted-principal" if principal_point else "adjusted")
        refined = RefinedLenses(focal, principal_point)
        with atomic_folder(out) as folder:
            model = adjust_to_positions(
                model_path,
                photographs,
                georegistration.world_from_model,
                MeasuredPositions(
                    positions, sigma, dict.fromkeys(without_altitude, NO_ALTITUDE_SIGMA_M)
                ),
                refined,
                folder,
            )
        return AdjustedModel(
            model, georegistration, refined, delay, {} if used is fixes else used, out
        )

    best = solve(principal_point=False)
    if _common_direction(raw, photographs) < _MAX_COMMON_DIRECTION:
        refined = solve(principal_point=True)
        limit = (1 - _MIN_GAIN) * best.model.reprojection_error()
        if refined.model.reprojection_error() < limit:
            best = refined
    return (
        _raise_to_altitudes(best, used)
        if georegistration.level == "ground" and find_missing_altitudes(used)
        else best
    )


def find_missing_altitudes(fixes: Mapping[str, Array]) -> set[str]:
    """Return the photographs whose fix has no altitude."""
    return {name for name, fix in fixes.items() if np.isnan(fix[2])}


def _raise_to_altitudes(adjusted: AdjustedModel, fixes: Mapping[str, Array]) -> AdjustedModel:
    """Return the model shifted vertically to the median of the known altitudes."""
    images = adjusted.model.images
    names = [name for name in fixes.keys() - find_missing_altitudes(fixes) if name in images]
    if not names:
        return adjusted
    up = float(np.median([fixes[name][2] - images[name].centre[2] for name in names]))
    shift = np.column_stack([np.eye(3), [0.0, 0.0, up]])
    return replace(adjusted, model=adjusted.model.transform(shift))


def _georegister_with_delay(
    raw: SparseMap,
    order: Sequence[str],
    fixes: Mapping[str, Array],
    times: Mapping[str, float],
) -> tuple[Georegistration, float, Mapping[str, Array]]:
    """Georegister a model by its fixes, and remove their delay if they have one.

    Args:
        raw: The model, in its own frame.
        order: Names of its photographs in the order they were taken.
        fixes: Measured positions (3,) by name, world metres.
        times: Time stamps in seconds, by name.

    Returns:
        The georegistration, the delay in seconds (0 if unknown), and the fixes with the delay
        removed; without a delay these are ``fixes`` itself.
    """
    georegistration, used, delay = georegister(raw, fixes), fixes, 0.0
    for _ in range(_MAX_DELAY_ESTIMATES):
        centres = dict(zip(raw.names, georegistration.apply(raw.centres), strict=True))
        motions = estimate_motions(order, centres, times)
        trusted = {
            n: fixes[n] for n in raw.names if n in fixes and n not in georegistration.blunders
        }
        delay = find_delay(motions, centres, trusted)
        if delay == 0:
            break
        used = undo_delay(fixes, motions, delay)
        georegistration = georegister(raw, used)
    if delay == 0 and used is not fixes:
        georegistration, used = georegister(raw, fixes), fixes
    return georegistration, delay, used


def _relief(model: SparseMap) -> float:
    """Return the range of depths within the median photograph, as a share of its median depth."""
    reliefs = []
    for image in model.images.values():
        xyz = model.xyz[image.point_rows[image.point_rows >= 0]]
        depth = (xyz @ image.cam_from_world[:3, :3].T + image.cam_from_world[:3, 3])[:, 2]
        if len(depth):
            near, middle, far = np.percentile(depth, [5, 50, 95])
            reliefs.append((far - near) / middle)
    return float(np.median(reliefs))


def _common_direction(model: SparseMap, photographs: Sequence[Photograph]) -> float:
    """Return how closely the headings of an uncalibrated lens's cameras agree, 0 to 1.

    It is the length of the mean of the cameras' unit vectors to the right, and the largest over the
    lenses: 1 where all cameras of a lens have one heading. Without an uncalibrated lens it is
    infinite.
    """
    right: dict[str, list[Array]] = {}
    for photograph in photographs:
        if photograph.name in model.images and not photograph.calibrated:
            axis = model.images[photograph.name].cam_from_world[0, :3]
            right.setdefault(photograph.lens, []).append(axis)
    lengths = [float(np.linalg.norm(np.mean(axes, axis=0))) for axes in right.values()]
    return max(lengths, default=np.inf)
