"""Refinement of coarse poses of a query in all six dimensions, by their score on the mosaic.

The mosaic holds the features of every cell of the ground. A search tries few tilts, headings and
altitudes. With the nearest of these, the right pose scores little more than wrong ones. After
refinement it scores clearly more.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Final, NamedTuple

import torch
from torch import Tensor

from objconnect.localization.coarse.correlation import MosaicSampler
from objconnect.localization.featuremetric.maps import FeatureMap
from objconnect.scene.geometry.pose import so3_exp
from objconnect.scene.geometry.views import WarpedImage

MIN_OVERLAP: Final = 0.3
"""A candidate needs at least this share of the query's confidence on known cells of the mosaic."""
# Ground is used up to this horizontal distance, in heights of the camera above ground. Few pixels
# show ground that is farther away.
_MAX_DISTANCE: Final = 2.0
# Initial steps of the tilt and the heading (rad), of the logarithm of the altitude, of the roll
# (rad), and of the position (cells). They are halved in each round.
_TILT_STEP: Final = math.radians(6)
_HEADING_STEP: Final = math.radians(3)
_ALTITUDE_STEP: Final = 0.09
_ROLL_STEP: Final = math.radians(3)
_SHIFT_STEP: Final = 0.8
_ROUNDS: Final = 3


class CoarsePoses(NamedTuple):
    """P poses of a camera above level ground.

    Attributes:
        rotation: (P, 3, 3) ``cam_from_world``.
        altitude: (P,) metres above the ground.
        middle: (P, 2) world metres, east and north: the middle of the ground in view. It does not
            change with attitude and altitude, so that the parameters are nearly independent.
    """

    rotation: Tensor
    altitude: Tensor
    middle: Tensor

    def vary(self, steps: Tensor, cell: float) -> CoarsePoses:
        """Return the poses changed by each of S steps (S, 6), (P * S) pose by pose.

        A step is tilt, roll, heading (rad), logarithm of the altitude, east and north (cells).
        """
        zero = torch.zeros(len(steps), dtype=steps.dtype)
        in_camera = so3_exp(torch.stack([steps[:, 0], steps[:, 1], zero], -1))
        about_vertical = so3_exp(torch.stack([zero, zero, steps[:, 2]], -1))
        rotation = in_camera @ self.rotation[:, None] @ about_vertical
        altitude = self.altitude[:, None] * steps[:, 3].exp()
        middle = self.middle[:, None] + cell * steps[:, 4:]
        return CoarsePoses(rotation.flatten(0, 1), altitude.flatten(), middle.flatten(0, 1))

    def select(self, rows: Tensor) -> CoarsePoses:
        """Return the poses with these rows."""
        return CoarsePoses(*(each[rows] for each in self))


class ViewScorer:
    """Scores poses of a query by comparing its features, projected to the ground, with the mosaic.

    Args:
        sampler: compares features with the mosaic of the map.
        view: the warped query.
        level: its features, reduced to the mosaic's channels.

    Attributes:
        features: (N, K) unit features of the query's cells.
    """

    def __init__(self, sampler: MosaicSampler, view: WarpedImage, level: FeatureMap) -> None:
        self._sampler, self._grid = sampler, sampler.mosaic.grid
        rows, columns = level.features.shape[-2:]
        steps = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
        xy = (torch.stack([steps[1], steps[0]], -1).reshape(-1, 2) + 0.5) * float(level.stride)
        rays, valid = view.camera.unproject(xy.double())
        weight = level.confidence.flatten().cpu() * torch.from_numpy(view.shows(xy.numpy()))
        used = valid & (weight > 0) & (rays[:, 2] > 1e-6)
        rays = rays[used]
        in_view = rays / rays[:, 2:]
        self._rays = in_view.double() @ torch.from_numpy(view.view_from_camera)
        self._weight = weight[used].double()
        unit = torch.nn.functional.normalize(level.features[0].flatten(1).T.float(), dim=1)
        self.features = unit[used.to(unit.device)]
        focal = sum(view.camera.focal) / 2
        self._area = (level.stride / (focal * self._grid.cell)) ** 2

    def refine(self, poses: CoarsePoses) -> tuple[CoarsePoses, Tensor, Tensor]:
        """Return poses (P) refined, their centres east and north (P, 2), and their scores (P,)."""
        cell = self._grid.cell
        signs = torch.tensor(list(product((-1, 0, 1), repeat=3)), dtype=torch.float64)
        zero = torch.zeros(len(signs), dtype=torch.float64)
        a, b, c = signs.unbind(1)
        shifts = torch.stack(
            [zero, a * _ROLL_STEP, zero, zero, b * _SHIFT_STEP, c * _SHIFT_STEP], -1
        )
        attitudes = torch.stack(
            [a * _TILT_STEP, zero, b * _HEADING_STEP, c * _ALTITUDE_STEP, zero, zero], -1
        )
        for k in range(_ROUNDS):
            for steps in (shifts, attitudes, shifts):
                tried = poses.vary(steps / 2**k, cell)
                scores = self.score(tried)[0].reshape(-1, len(steps))
                best = scores.argmax(1) + torch.arange(len(scores)) * len(steps)
                poses = tried.select(best)
        scores, centres = self.score(poses)
        return poses, centres, scores

    def score(self, poses: CoarsePoses) -> tuple[Tensor, Tensor]:
        """Return the scores (P,) of poses, at most 1, and their centres (P, 2), world metres."""
        ground, weight = self.project_to_ground(poses.rotation, poses.altitude)
        centre = poses.middle - middle(ground, weight)
        position = (
            centre[:, None] + ground - torch.from_numpy(self._grid.origin)
        ) / self._grid.cell
        device = self.features.device
        weight, position = weight.float().to(device), (position - 0.5).float().to(device)
        sums, known = self._sampler.compare(self.features, position, weight)
        total = weight.sum(1)
        score = sums / (known * total).clamp_min(1e-6).sqrt()
        return torch.where(known > MIN_OVERLAP * total, score, -1.0).cpu(), centre

    def project_to_ground(self, rotation: Tensor, altitude: Tensor) -> tuple[Tensor, Tensor]:
        """Project the view's cells to level ground, (P, N, 2) metres from the camera, with weights.

        The weight of a cell is multiplied by the number of the mosaic's cells that it covers, at
        most one.
        """
        directions = self._rays @ rotation
        down = -directions[..., 2]
        depth = altitude[:, None] / down.clamp_min(1e-6)
        ground = directions[..., :2] * depth[..., None]
        near = (down > 1e-6) & (ground.norm(dim=-1) <= _MAX_DISTANCE * altitude[:, None])
        cells = self._area * depth**3 / altitude[:, None]
        weight = self._weight * cells.clamp(max=1.0) * near
        return torch.where(near[..., None], ground, 0.0), weight


def middle(ground: Tensor, weight: Tensor) -> Tensor:
    """Return the weighted mean (P, 2) of positions on the ground (P, N, 2)."""
    total = weight.sum(1, keepdim=True).clamp_min(1e-9)
    return (weight[..., None] * ground).sum(1) / total
