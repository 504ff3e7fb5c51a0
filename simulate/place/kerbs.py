"""Lay kerbs with raised pavements, and raise the objects on them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from simulate.place.builder import PAVEMENT_M
from simulate.place.grid import CircleGrid
from simulate.place.world import (
    Ground,
    Kerb,
    Road,
    WorldObject,
    arc_lengths,
    polyline_length,
    polyline_points,
)

Array = NDArray[np.float64]

KERB_HEIGHT_M = 0.13
_RAMP_M = 0.7  # length of the ramp at a dropped kerb
_STEP_M = 0.5  # distance between the points at which the ground is sampled
_MIN_KERB_M = 2.0  # shorter kerbs are left out
_SAMPLED_M = (0.4, 0.8, 1.2)  # distances from the kerb at which the ground is sampled
_NOT_RAISED = ("pole", "wire")  # both stay, so that wires meet their poles


def lay_kerbs(roads: Iterable[Road], ground: Ground) -> tuple[Kerb, ...]:
    """Return kerbs along both sides of every road where its verge is pavement.

    Kerbs are dropped where another carriageway, a drive or the entrance of a car park crosses.
    """
    half = 0.5 * len(ground.labels) * ground.texel_m
    kerbs = []
    for road in roads:
        for side in (1.0, -1.0):
            kerbs += [
                _kerb(road, side, start, end)
                for start, end in _runs(_is_pavement(road, side, ground, half))
                if end - start > _MIN_KERB_M
            ]
    return tuple(kerbs)


def raise_objects(objects: Sequence[WorldObject], kerbs: Sequence[Kerb]) -> tuple[WorldObject, ...]:
    """Return the objects, raised by the height of the pavement on which they stand."""
    heights = PavementHeights(kerbs)

    def lift(item: WorldObject) -> WorldObject:
        rise = 0.0 if item.class_name in _NOT_RAISED else heights.height_at(item.centre[:2])
        return replace(item, centre=item.centre + np.array([0, 0, rise])) if rise else item

    return tuple(lift(item) for item in objects)


class PavementHeights:
    """Heights of raised pavements above the ground."""

    def __init__(self, kerbs: Sequence[Kerb]) -> None:
        """Divide every pavement into quadrilaterals between its pairs of points."""
        joined = [np.stack([k.front[:-1], k.front[1:], k.back[:-1], k.back[1:]], 1) for k in kerbs]
        corners = np.concatenate([np.empty((0, 4, 2)), *joined])
        ends = [np.stack([k.rise[:-1], k.rise[1:]], 1) for k in kerbs]
        self._rise = np.concatenate([np.empty((0, 2)), *ends])
        self._origin = corners[:, 0]
        along, across = corners[:, 1] - self._origin, corners[:, 2] - self._origin
        self._local_from_world = np.linalg.inv(np.stack([along, across], 2))
        self._circles = CircleGrid()
        middles = corners.mean(1)
        reach = np.linalg.norm(corners - middles[:, None], axis=2).max(1, initial=0.0)
        for middle, radius in zip(middles, reach.tolist(), strict=True):
            self._circles.add(middle, radius)

    def height_at(self, point: Array) -> float:
        """Return the height at a point (2,), metres; 0 where no pavement is raised."""
        rise = 0.0
        for k in self._circles.find_overlapping(point, 0.1):
            t, s = self._local_from_world[k] @ (point - self._origin[k])
            if 0 <= t <= 1 and 0 <= s <= 1:
                first, last = self._rise[k]
                rise = max(rise, float(first + t * (last - first)))
        return rise


def _is_pavement(road: Road, side: float, ground: Ground, half_m: float) -> NDArray[np.bool_]:
    """Return whether the verge of a road is pavement, at every ``_STEP_M`` along it."""
    arc_m = np.arange(0.0, polyline_length(road.line), _STEP_M)
    pavement = np.ones(len(arc_m), bool)
    for away_m in _SAMPLED_M:
        points = _offset_points(road, side * (0.5 * road.width_m + away_m), arc_m)
        pavement &= ground.label(*points.T) == CLASSES["pavement"]
        pavement &= (np.abs(points) < half_m).all(1)
    return pavement


def _runs(mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the arc lengths in metres at which runs of True begin and end."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return list(zip((_STEP_M * starts).tolist(), (_STEP_M * ends).tolist(), strict=True))


def _kerb(road: Road, side: float, start: float, end: float) -> Kerb:
    """Return the kerb on one side of a road between two arc lengths, metres.

    Both ends are ramps.
    """
    corners = arc_lengths(road.line)
    between = corners[(corners > start + _RAMP_M + 0.1) & (corners < end - _RAMP_M - 0.1)]
    arc_m = np.concatenate([[start, start + _RAMP_M], between, [end - _RAMP_M, end]])
    rise = np.full(len(arc_m), KERB_HEIGHT_M)
    rise[[0, -1]] = 0.0
    edge = 0.5 * road.width_m
    return Kerb(
        _offset_points(road, side * edge, arc_m),
        _offset_points(road, side * (edge + PAVEMENT_M), arc_m),
        rise,
    )


def _offset_points(road: Road, left_m: float, arc_m: Array) -> Array:
    """Return points (N, 2) ``left_m`` to the left of a road's centre line at arc lengths (N,).

    Normals are interpolated between corners, so that kerbs meet the edges of ``ribbon``.
    """
    tangent = np.gradient(road.line, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], -1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points, _ = polyline_points(road.line, arc_m)
    normals = np.stack([np.interp(arc_m, arc_lengths(road.line), normal[:, k]) for k in (0, 1)], -1)
    return np.asarray(points + left_m * normals)
