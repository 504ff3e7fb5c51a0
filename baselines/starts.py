"""Where to start looking: at the prior, and for what it does not say, at photographs of the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.views import looks_down, north, turned_by
from scene.geometry.pose import Pose, so3_exp
from scene.localizer import Prior
from scene.maps.sparse_map import SparseMap

# An altitude that is known worse than this share of the height above ground is none.
_NO_ALTITUDE: Final = 0.2
# Ratio of heights from which the same is seen at nearly the same scale.
_SAME_SCALE: Final = 1.15
_SAME_HEADING: Final = math.radians(45)
_TURN: Final = math.radians(30)
# A photograph that looks clearly aslant.
_ASLANT: Final = math.radians(10)
_DOWNWARDS: Final = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))


def starts(prior: Prior | None, sparse_map: SparseMap, chosen: NDArray[np.int64]) -> list[Pose]:
    """Poses (``cam_from_world``, float64) at which a query may be, the likeliest first.

    Where the altitude is not known there is a start at every one that the photographs have: a drone
    also climbs and descends. Where no attitude is known there is one for every way that they are
    turned: a survey flies half of its lines the other way round. Without a prior these are the
    photographs' own poses.

    Args:
        prior: of the query, finite.
        sparse_map: the map.
        chosen: rows of ``sparse_map.names`` to take it from, best first; one at least.
    """
    posed = [sparse_map.images[sparse_map.names[int(row)]].pose for row in chosen]
    if prior is None:
        return _distinct(posed)
    position = np.array(prior.position, np.float64)
    beside = [pose.centre().numpy() for pose in posed]
    heights = [sparse_map.height_above(centre) for centre in beside]
    altitudes = [position[2]]
    if prior.position_sigma is not None and prior.position_sigma[2] > _NO_ALTITUDE * heights[0]:
        altitudes = [beside[k][2] for k in _different(heights)]
    if prior.cam_from_world_rotation is not None:
        rotations = [torch.from_numpy(np.array(prior.cam_from_world_rotation, np.float64))]
    else:
        rotations = [pose.rotation for pose in _distinct(posed)]
    centres = [
        torch.tensor([*position[:2], altitude], dtype=torch.float64) for altitude in altitudes
    ]
    return [Pose(rotation, -rotation @ centre) for centre in centres for rotation in rotations]


def every_way(begun: Sequence[Pose]) -> list[Pose]:
    """These, and at each of their places the first turned about the vertical until every heading
    is near one's; where it looks down aslant, as many again that look straight down.

    For what guides no further than some degrees, where nobody knows the attitude.
    """
    places: dict[tuple[float, ...], list[Pose]] = {}
    for pose in begun:
        places.setdefault(tuple(pose.centre().round(decimals=6).tolist()), []).append(pose)
    return [pose for there in places.values() for pose in _every_way(there)]


def _every_way(begun: Sequence[Pose]) -> list[Pose]:
    """Of poses at one place."""
    first = begun[0]
    centre = first.centre()
    headings = [north(pose.rotation.numpy()) for pose in begun]
    poses = list(begun)
    for turn in torch.arange(_TURN, math.tau - 1e-9, _TURN, dtype=torch.float64):
        rotation = first.rotation @ so3_exp(turn * torch.tensor([0, 0, 1], dtype=torch.float64))
        heading = north(rotation.numpy())
        if all(abs(math.remainder(heading - other, math.tau)) > _TURN / 4 for other in headings):
            headings.append(heading)
            poses.append(Pose(rotation, -rotation @ centre))
    down = first.rotation.numpy()
    if looks_down(down) and -down[2, 2] < math.cos(_ASLANT):
        straight = [torch.from_numpy(turned_by(-heading)) @ _DOWNWARDS for heading in headings]
        poses += [Pose(rotation, -rotation @ centre) for rotation in straight]
    return poses


def _different(heights: Sequence[float]) -> list[int]:
    """Rows of those from which the ground looks larger or smaller than from all before them."""
    kept: list[int] = []
    for row, height in enumerate(heights):
        ratios = (height / max(heights[other], 1e-9) for other in kept)
        if all(not 1 / _SAME_SCALE < ratio < _SAME_SCALE for ratio in ratios):
            kept.append(row)
    return kept


def _distinct(posed: Sequence[Pose]) -> list[Pose]:
    """Those that are turned about their axis by more than 45 degrees against all before them."""
    kept: list[Pose] = []
    headings: list[float] = []
    for pose in posed:
        heading = north(pose.rotation.numpy())
        turns = (heading - other for other in headings)
        if all(abs(math.remainder(turn, math.tau)) > _SAME_HEADING for turn in turns):
            kept.append(pose)
            headings.append(heading)
    return kept
