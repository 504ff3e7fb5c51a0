"""Place a model of structure from motion in the world by GPS, and adjust it there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.georegister import Georegistration, georegister
from objconnect.ingestion.gps_delay import find_delay, motions, undo_delay
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

NO_ALTITUDE: Final = 1e4
"""Standard deviation of an altitude that is unknown or ignored (m)."""

# Focal lengths of EXIF are adjusted where depths within a picture differ by more than this share.
# Over flatter ground, EXIF is better than an estimate.
_MIN_RELIEF: Final = 0.25
# Principal points are adjusted where the mean of the unit vectors to the right of a lens's cameras
# is shorter than this. If all cameras face one way, a principal point cannot be distinguished from
# a shift.
_MAX_COMMON_DIRECTION: Final = 0.8
# They are refined only where this reduces the reprojection error by more than this share. Otherwise
# errors of GPS would move them.
_MIN_GAIN: Final = 0.002
# Most iterations of the delay. Each changes the centres, and so the velocities from which the next
# one is computed.
_ROUNDS: Final = 3


@dataclass(frozen=True)
class Adjusted:
    """A model in the world, and how it was placed there.

    Attributes:
        model: The adjusted model, in world metres.
        placed: Where GPS placed the model before the adjustment.
        refined: Parameters of the lenses that were adjusted.
        delay: Seconds that fixes are behind the photographs; 0 where it is not known.
        undone: Fixes (3,) without the delay by name, world metres; empty where there is no delay.
        folder: Folder of the model.
    """

    model: SparseMap
    placed: Georegistration
    refined: RefinedLenses
    delay: float
    undone: Mapping[str, Array]
    folder: Path


def adjust(
    model_path: Path,
    taken: Sequence[Photograph],
    fixes: Mapping[str, Array],
    times: Mapping[str, float],
    work: Path,
) -> Adjusted:
    """Place a model by GPS and adjust it to pixels and GPS.

    Args:
        model_path: Folder of the model.
        taken: The photographs of the model in the order they were taken; there may be others.
        fixes: Measured positions (3,) by name, world metres.
        times: Seconds since any one moment, by name.
        work: Folder for the adjusted model.

    Raises:
        InputError: As ``georegister``.
    """
    raw = read_model(model_path)
    order = [photograph.name for photograph in taken if photograph.name in raw.images]
    placed, delay, used = _place(raw, order, fixes, times)
    positions = {n: used[n] for n in raw.names if n in used and n not in placed.blunders}
    sigma = np.minimum(placed.sigma, NO_ALTITUDE)
    blind = blind_of(positions)
    if placed.level == "ground":
        blind = set(positions)
    for name in positions:
        if name in blind:
            height = placed.apply(raw.images[name].centre[None])[0, 2]
            positions[name] = np.array([*positions[name][:2], height])
    tell = _relief(raw) > _MIN_RELIEF
    focal = {p.lens for p in taken if not p.calibrated and (tell or not p.focal_known)}

    def solve(principal_point: bool) -> Adjusted:
        out = work / ("adjusted-principal" if principal_point else "adjusted")
        refined = RefinedLenses(focal, principal_point)
        with atomic_folder(out) as folder:
            model = adjust_to_positions(
                model_path,
                taken,
                placed.world_from_model,
                MeasuredPositions(positions, sigma, dict.fromkeys(blind, NO_ALTITUDE)),
                refined,
                folder,
            )
        return Adjusted(model, placed, refined, delay, {} if used is fixes else used, out)

    best = solve(principal_point=False)
    if _common_direction(raw, taken) < _MAX_COMMON_DIRECTION:
        off_middle = solve(principal_point=True)
        least = (1 - _MIN_GAIN) * best.model.reprojection_error()
        if off_middle.model.reprojection_error() < least:
            best = off_middle
    return _at_height(best, used) if placed.level == "ground" and blind_of(used) else best


def blind_of(fixes: Mapping[str, Array]) -> set[str]:
    """Return the photographs whose fix has no altitude."""
    return {name for name, fix in fixes.items() if np.isnan(fix[2])}


def _at_height(adjusted: Adjusted, fixes: Mapping[str, Array]) -> Adjusted:
    """Return the model raised to the median of the few altitudes that there are."""
    images = adjusted.model.images
    names = [name for name in fixes.keys() - blind_of(fixes) if name in images]
    if not names:
        return adjusted
    up = float(np.median([fixes[name][2] - images[name].centre[2] for name in names]))
    shift = np.column_stack([np.eye(3), [0.0, 0.0, up]])
    return replace(adjusted, model=adjusted.model.transform(shift))


def _place(
    raw: SparseMap,
    order: Sequence[str],
    fixes: Mapping[str, Array],
    times: Mapping[str, float],
) -> tuple[Georegistration, float, Mapping[str, Array]]:
    """Place a model by its fixes, without their delay if they have one.

    Args:
        raw: The model, in a frame of its own.
        order: Names of its photographs in the order they were taken.
        fixes: Measured positions (3,) by name, world metres.
        times: Seconds since any one moment, by name.

    Returns:
        Where the model is, the delay in seconds (0 if unknown), and the fixes without the delay;
        without a delay these are ``fixes`` itself.
    """
    placed, used, delay = georegister(raw, fixes), fixes, 0.0
    for _ in range(_ROUNDS):
        centres = dict(zip(raw.names, placed.apply(raw.centres), strict=True))
        moving = motions(order, centres, times)
        trusted = {n: fixes[n] for n in raw.names if n in fixes and n not in placed.blunders}
        delay = find_delay(moving, centres, trusted)
        if delay == 0:
            break
        used = undo_delay(fixes, moving, delay)
        placed = georegister(raw, used)
    if delay == 0 and used is not fixes:
        placed, used = georegister(raw, fixes), fixes
    return placed, delay, used


def _relief(model: SparseMap) -> float:
    """Return the range of depths within the median photograph, as a share of its median depth."""
    spread = []
    for image in model.images.values():
        xyz = model.xyz[image.point_rows[image.point_rows >= 0]]
        depth = (xyz @ image.cam_from_world[:3, :3].T + image.cam_from_world[:3, 3])[:, 2]
        if len(depth):
            near, middle, far = np.percentile(depth, [5, 50, 95])
            spread.append((far - near) / middle)
    return float(np.median(spread))


def _common_direction(model: SparseMap, taken: Sequence[Photograph]) -> float:
    """Return how much the cameras of any uncalibrated lens face one way.

    It is the largest length, over the lenses, of the mean of the cameras' unit vectors to the
    right: 1 where all cameras of a lens face one way. Without an uncalibrated lens it is infinite.
    """
    right: dict[str, list[Array]] = {}
    for photograph in taken:
        if photograph.name in model.images and not photograph.calibrated:
            axis = model.images[photograph.name].cam_from_world[0, :3]
            right.setdefault(photograph.lens, []).append(axis)
    lengths = [float(np.linalg.norm(np.mean(axes, axis=0))) for axes in right.values()]
    return max(lengths, default=np.inf)
