"""Starting poses of a query: its prior, completed by those of reference images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import north_angle
from objconnect.scene.localizer import By, Prior
from objconnect.scene.maps.sparse_map import SparseMap

# An altitude whose sigma exceeds this share of the height above ground counts as unknown.
_UNKNOWN_ALTITUDE_SHARE: Final = 0.2
# Ratio of heights above ground below which they give one starting altitude.
_SAME_HEIGHT_RATIO: Final = 1.15
# Angle between headings below which they give one start.
_SAME_HEADING_DEG: Final = 45.0


def starts(
    prior: Prior | None,
    sparse_map: SparseMap,
    chosen: NDArray[np.int64],
    same_place_m: float | None = None,
) -> list[Pose]:
    """Return starts of a query (``cam_from_world``, float64), the likeliest first.

    If the altitude is unknown, each distinct height of the reference images gives a start: a drone
    also climbs and descends. If the attitude is unknown, each of their distinct headings gives one:
    a survey flies half of its lines in the opposite direction. Without a position the reference
    images give it, and without a prior their whole poses.

    Args:
        prior: prior of the query, finite.
        sparse_map: the map.
        chosen: rows of the reference images in ``sparse_map.names``, best first; at least one.
        same_place_m: without a prior, reference images farther apart than this (metres) are
            separate starts though they share a heading; None for never.
    """
    posed = [sparse_map.images[sparse_map.names[int(row)]].pose for row in chosen]
    if prior is None or not (prior.has_position or prior.has_heading):
        return _distinct_headings(posed, same_place_m)
    rotations = [pose.rotation for pose in _distinct_headings(posed)]
    if prior.has_heading:
        rotations = [torch.from_numpy(np.array(prior.cam_from_world_rotation, np.float64))]
    if not prior.has_position:
        return [Pose(rotations[0], -rotations[0] @ pose.centre()) for pose in posed]
    position = np.array(prior.position, np.float64)
    beside = [pose.centre().numpy() for pose in posed]
    altitudes = [position[2]]
    unknown = _UNKNOWN_ALTITUDE_SHARE * sparse_map.height_above(beside[0])
    if prior.position_sigma is not None and prior.position_sigma[2] > unknown:
        heights = [sparse_map.height_above(centre) for centre in beside]
        rows = _distinct_heights(heights)
        altitudes = [beside[row][2] for row in rows]
    centres = [
        torch.tensor([*position[:2], altitude], dtype=torch.float64) for altitude in altitudes
    ]
    return [Pose(rotation, -rotation @ centre) for centre in centres for rotation in rotations]


def start_of(prior: Prior | None) -> By:
    """Return the source of the position in ``starts``: the prior or reference images."""
    return By.PRIOR if prior is not None and prior.has_position else By.RETRIEVAL


def _distinct_heights(heights: Sequence[float]) -> list[int]:
    """Return the rows of heights that differ from all kept before."""
    kept: list[int] = []
    for row, height in enumerate(heights):
        ratios = (height / max(heights[other], 1e-9) for other in kept)
        if all(not 1 / _SAME_HEIGHT_RATIO < ratio < _SAME_HEIGHT_RATIO for ratio in ratios):
            kept.append(row)
    return kept


def _distinct_headings(posed: Sequence[Pose], same_place_m: float | None = None) -> list[Pose]:
    """Return the poses whose heading differs from that of all kept before within a distance."""
    same_heading = math.radians(_SAME_HEADING_DEG)
    same_place = math.inf if same_place_m is None else same_place_m
    kept: list[Pose] = []
    for pose in posed:
        heading = north_angle(pose.rotation.numpy())
        beside = [
            other for other in kept if float((other.centre() - pose.centre()).norm()) < same_place
        ]
        turns = (heading - north_angle(other.rotation.numpy()) for other in beside)
        if all(abs(math.remainder(turn, math.tau)) > same_heading for turn in turns):
            kept.append(pose)
    return kept
