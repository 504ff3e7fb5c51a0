"""Starting poses of a query: its prior, completed from photographs of the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.views import looks_down, north_angle, roll_rotation
from scene.config import Config
from scene.geometry.pose import Pose, so3_exp
from scene.localizer import Prior
from scene.maps.sparse_map import SparseMap

_DOWNWARDS: Final = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))


class StartOptions(Config):
    """Which starting poses are tried where the prior leaves altitude or attitude open."""

    unknown_altitude_share: float = Field(
        0.2,
        gt=0,
        description="An altitude whose sigma exceeds this share of the height above ground counts "
        "as unknown.",
    )
    same_height_ratio: float = Field(
        1.15,
        gt=1,
        description="Heights above ground whose ratio is below this share one starting altitude.",
    )
    same_heading_deg: float = Field(
        45.0,
        gt=0,
        description="Photographs turned less than this against each other share one heading.",
    )
    turn_deg: float = Field(
        30.0,
        gt=0,
        le=180,
        description="Turn between the headings that are tried where the heading is unknown.",
    )
    tilted_deg: float = Field(
        10.0,
        gt=0,
        description="Views tilted by more than this are also tried looking straight down, where "
        "the heading is unknown.",
    )


_DEFAULTS: Final = StartOptions()


def known_part(prior: Prior | None) -> Prior | None:
    """Return what a prior knows of the whole pose, for methods that begin at one pose.

    A prior without a horizontal position is none, and an attitude without a heading is none.
    """
    if prior is None or not prior.has_position:
        return None
    if prior.cam_from_world_rotation is None or prior.has_heading:
        return prior
    return Prior(prior.position, prior.position_sigma)


def starts(
    prior: Prior | None,
    sparse_map: SparseMap,
    chosen: NDArray[np.int64],
    options: StartOptions = _DEFAULTS,
) -> list[Pose]:
    """Return poses (``cam_from_world``, float64) at which a query may be, the likeliest first.

    Where the altitude is not known, each altitude of the photographs gives a start: a drone also
    climbs and descends. Where no attitude is known, each distinct heading of the photographs gives
    one: a survey flies half of its lines the other way round. Without a prior these are the
    photographs' own poses.

    Args:
        prior: of the query, finite.
        sparse_map: the map.
        chosen: rows of ``sparse_map.names`` to take it from, best first; one at least.
        options: what counts as unknown, and as the same.
    """
    posed = [sparse_map.images[sparse_map.names[int(row)]].pose for row in chosen]
    if prior is None:
        return _distinct_headings(posed, options)
    position = np.array(prior.position, np.float64)
    beside = [pose.centre().numpy() for pose in posed]
    heights = [sparse_map.height_above(centre) for centre in beside]
    altitudes = [position[2]]
    unknown = options.unknown_altitude_share * heights[0]
    if prior.position_sigma is not None and prior.position_sigma[2] > unknown:
        rows = _distinct_heights(heights, options.same_height_ratio)
        altitudes = [beside[row][2] for row in rows]
    if prior.cam_from_world_rotation is not None:
        rotations = [torch.from_numpy(np.array(prior.cam_from_world_rotation, np.float64))]
    else:
        rotations = [pose.rotation for pose in _distinct_headings(posed, options)]
    centres = [
        torch.tensor([*position[:2], altitude], dtype=torch.float64) for altitude in altitudes
    ]
    return [Pose(rotation, -rotation @ centre) for centre in centres for rotation in rotations]


def with_all_headings(begun: Sequence[Pose], options: StartOptions = _DEFAULTS) -> list[Pose]:
    """Add starts until every heading is close to that of one of them, at each of their places.

    The first start of a place is turned about the vertical; where it looks down at an angle, as
    many starts are added that look straight down. This is for methods that guide a pose no further
    than some degrees, where nobody knows the attitude.
    """
    places: dict[tuple[float, ...], list[Pose]] = {}
    for pose in begun:
        places.setdefault(tuple(pose.centre().round(decimals=6).tolist()), []).append(pose)
    return [pose for at_place in places.values() for pose in _all_headings(at_place, options)]


def _all_headings(begun: Sequence[Pose], options: StartOptions) -> list[Pose]:
    """Add the missing headings to the starts of one place."""
    first = begun[0]
    centre = first.centre()
    headings = [north_angle(pose.rotation.numpy()) for pose in begun]
    poses = list(begun)
    step = math.radians(options.turn_deg)
    for turn in torch.arange(step, math.tau - 1e-9, step, dtype=torch.float64):
        rotation = first.rotation @ so3_exp(turn * torch.tensor([0, 0, 1], dtype=torch.float64))
        heading = north_angle(rotation.numpy())
        if all(abs(math.remainder(heading - other, math.tau)) > step / 4 for other in headings):
            headings.append(heading)
            poses.append(Pose(rotation, -rotation @ centre))
    down = first.rotation.numpy()
    if looks_down(down) and -down[2, 2] < math.cos(math.radians(options.tilted_deg)):
        straight = [torch.from_numpy(roll_rotation(-heading)) @ _DOWNWARDS for heading in headings]
        poses += [Pose(rotation, -rotation @ centre) for rotation in straight]
    return poses


def _distinct_heights(heights: Sequence[float], same_ratio: float) -> list[int]:
    """Return the rows from whose height the ground looks larger or smaller than from all before."""
    kept: list[int] = []
    for row, height in enumerate(heights):
        ratios = (height / max(heights[other], 1e-9) for other in kept)
        if all(not 1 / same_ratio < ratio < same_ratio for ratio in ratios):
            kept.append(row)
    return kept


def _distinct_headings(posed: Sequence[Pose], options: StartOptions) -> list[Pose]:
    """Return the poses whose heading differs from that of all before them."""
    same_heading = math.radians(options.same_heading_deg)
    kept: list[Pose] = []
    headings: list[float] = []
    for pose in posed:
        heading = north_angle(pose.rotation.numpy())
        turns = (heading - other for other in headings)
        if all(abs(math.remainder(turn, math.tau)) > same_heading for turn in turns):
            kept.append(pose)
            headings.append(heading)
    return kept
