"""Starting poses of a query: its prior, completed by the poses of reference images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.views import north_angle, roll_rotation, rotate_north_up
from objconnect.scene.localizer import PoseSource, Prior
from objconnect.scene.maps.sparse_map import SparseMap

# An altitude whose sigma exceeds this share of the height above ground is treated as unknown.
_UNKNOWN_ALTITUDE_SHARE: Final = 0.2
# Heights above ground whose ratio is below this give one starting altitude.
_SAME_HEIGHT_RATIO: Final = 1.15
# Headings that differ by less than this give one start.
_SAME_HEADING_DEG: Final = 45.0


def list_initial_poses(
    prior: Prior | None,
    sparse_map: SparseMap,
    reference_rows: NDArray[np.int64],
    same_place_m: float | None = None,
    headings: int = 0,
) -> list[Pose]:
    """Return initial poses of a query (``cam_from_world``, float64), the likeliest first.

    If the altitude is unknown, each distinct height of the reference images gives a pose, because
    a drone also climbs and descends. If the attitude is unknown, each of their distinct headings
    gives a pose, because a survey flies half of its lines in the opposite direction. If the
    position is unknown, the poses have the positions of the reference images; without a prior, they
    are the poses of the reference images.

    Args:
        prior: prior of the query, finite.
        sparse_map: the map.
        reference_rows: rows of the reference images in ``sparse_map.names``, best first; at least
            one.
        same_place_m: without a prior, reference images farther apart than this (metres) give
            separate poses even if they have the same heading; None: one pose per heading.
        headings: number of evenly spaced headings that are tried where the heading is unknown; 0
            tries the headings of the reference images.
    """
    poses = [sparse_map.images[sparse_map.names[int(row)]].pose for row in reference_rows]
    if prior is None or not (prior.has_position or prior.has_heading):
        return _rotate_to_headings(poses[0], headings) or _distinct_headings(poses, same_place_m)
    rotated = _rotate_to_headings(poses[0], headings) or _distinct_headings(poses)
    rotations = [pose.rotation for pose in rotated]
    if prior.has_heading:
        rotations = [torch.from_numpy(np.array(prior.cam_from_world_rotation, np.float64))]
    if not prior.has_position:
        return [Pose(rotations[0], -rotations[0] @ pose.centre()) for pose in poses]
    position = np.array(prior.position, np.float64)
    reference_centres = [pose.centre().numpy() for pose in poses]
    altitudes = [position[2]]
    largest_sigma = _UNKNOWN_ALTITUDE_SHARE * sparse_map.height_above(reference_centres[0])
    if prior.position_sigma is not None and prior.position_sigma[2] > largest_sigma:
        heights = [sparse_map.height_above(centre) for centre in reference_centres]
        rows = _distinct_heights(heights)
        altitudes = [reference_centres[row][2] for row in rows]
    centres = [
        torch.tensor([*position[:2], altitude], dtype=torch.float64) for altitude in altitudes
    ]
    return [Pose(rotation, -rotation @ centre) for centre in centres for rotation in rotations]


def list_angles(headings: int) -> list[float]:
    """Return ``headings`` evenly spaced angles to north (rad), in -pi to pi."""
    return [math.remainder(math.tau * k / headings, math.tau) for k in range(headings)]


def _rotate_to_headings(pose: Pose, headings: int) -> list[Pose]:
    """Return a pose rotated about its optical axis to each of ``list_angles``."""
    north_up = rotate_north_up(pose.rotation.numpy())
    rotations = [
        torch.from_numpy(roll_rotation(-angle) @ north_up) for angle in list_angles(headings)
    ]
    return [Pose(rotation, -rotation @ pose.centre()) for rotation in rotations]


def source_of_initial_poses(prior: Prior | None) -> PoseSource:
    """Return the source of the positions of ``list_initial_poses``: prior or reference images."""
    return PoseSource.PRIOR if prior is not None and prior.has_position else PoseSource.RETRIEVAL


def _distinct_heights(heights: Sequence[float]) -> list[int]:
    """Return the rows of heights (m), each of which differs from all heights kept before it."""
    kept: list[int] = []
    for row, height in enumerate(heights):
        ratios = (height / max(heights[other], 1e-9) for other in kept)
        if all(not 1 / _SAME_HEIGHT_RATIO < ratio < _SAME_HEIGHT_RATIO for ratio in ratios):
            kept.append(row)
    return kept


def _distinct_headings(poses: Sequence[Pose], same_place_m: float | None = None) -> list[Pose]:
    """Return poses, each of which differs in heading from all poses kept before it.

    With ``same_place_m``, it is compared only with poses nearer than that (metres).
    """
    same_heading = math.radians(_SAME_HEADING_DEG)
    same_place = math.inf if same_place_m is None else same_place_m
    kept: list[Pose] = []
    for pose in poses:
        heading = north_angle(pose.rotation.numpy())
        near = [
            other for other in kept if float((other.centre() - pose.centre()).norm()) < same_place
        ]
        turns = (heading - north_angle(other.rotation.numpy()) for other in near)
        if all(abs(math.remainder(turn, math.tau)) > same_heading for turn in turns):
            kept.append(pose)
    return kept
