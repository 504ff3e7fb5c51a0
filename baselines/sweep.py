"""Pixels of a map's photographs, placed where the photographs beside them show the same.

Each pixel is swept along its ray (Collins, "A space-sweep approach to true multi-image matching",
CVPR 1996): at every depth a window around it is held against what the neighbours, whose poses are
known, show there.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from baselines.views import view
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.maps.sparse_map import SparseMap
from scene.storage.images import read_rgb

_BORDER: Final = 8.0
_LEAST_SHARED: Final = 20
# Rays should cross at about this angle: flatter ones say little of depth, steeper ones look unlike.
_BEST_ANGLE: Final = math.radians(15)
# Beyond the depths of the map's own points by this share, steps of a pixel, at most so many.
_BEYOND: Final = 0.1
_MOST_DEPTHS: Final = 256
# Agreement (normalised cross-correlation) that two photographs must reach, and by how much any
# other depth must fall behind.
_AGREE: Final = 0.75
_BETTER: Final = 0.05
_APART_STEPS: Final = 2
_HELD: Final = 12
# Small enough that windows stay in the processor's cache.
_AT_ONCE: Final = 128


@dataclass(frozen=True)
class Window:
    """What is compared: ``samples`` by ``samples`` values, ``step`` pixels apart."""

    samples: int = 7
    step: float = 1.5

    def offsets(self) -> Tensor:
        """Of the values from the middle, (P, 2) pixels."""
        unit = (torch.arange(self.samples, dtype=torch.float64) - self.samples // 2) * self.step
        return torch.stack(torch.meshgrid(unit, unit, indexing="xy"), -1).flatten(0, 1)


@dataclass(frozen=True)
class Swept:
    """Where pixels of one photograph stand.

    Attributes:
        xyz: (N, 3) world metres.
        sure: (N,) whether two neighbours agree on it, and on no other depth.
        score: (N,) their correlation.
    """

    xyz: NDArray[np.float64]
    sure: NDArray[np.bool_]
    score: NDArray[np.float64]


class Look(NamedTuple):
    """Grey values (H, W) of a photograph made smaller, its camera, its pose, and the way back to
    the pixels of the photograph."""

    grey: Tensor
    camera: Camera
    pose: Pose
    in_photograph: Callable[[NDArray[np.float64]], NDArray[np.float64]]


class Sweeper:
    """Places pixels of a map's photographs, one photograph after the other.

    Args:
        sparse_map: whose photographs, and points that say who sees the same.
        images: folder of the photographs.
        longest: photographs with a longer side (px) are made smaller.
        window: what is compared.
        neighbours: that a photograph is held against, at most.
    """

    def __init__(
        self,
        sparse_map: SparseMap,
        images: Path,
        longest: float = math.inf,
        window: Window = Window(),
        neighbours: int = 4,
    ) -> None:
        self._map = sparse_map
        self._images = images
        self._longest = longest
        self._window = window.offsets()
        self._neighbours = neighbours
        self._looks: OrderedDict[str, Look] = OrderedDict()
        self._rows = {
            name: np.unique(image.point_rows[image.point_rows >= 0])
            for name, image in sparse_map.images.items()
        }

    @torch.inference_mode()
    def __call__(
        self,
        name: str,
        xy: NDArray[np.float64],
        depths: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    ) -> Swept:
        """Of pixels of one photograph; none is sure where it has too few neighbours.

        Args:
            name: of the photograph.
            xy: (N, 2) pixels of ``look``.
            depths: nearest and farthest (N,) that each may have; None: as the map's points have.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        neighbours = self._beside(name)
        if len(neighbours) < 2 or not len(xy):
            return Swept(np.zeros((len(xy), 3)), np.zeros(len(xy), bool), np.zeros(len(xy)))
        look = self.look(name)
        tried = self._depths(name, look.camera, neighbours, len(xy), depths)
        others = [self.look(each) for each in neighbours]
        pixels = torch.from_numpy(xy)
        parts = [
            _swept(look, pixels[part], others, tried[part].float(), self._window)
            for part in torch.split(torch.arange(len(xy)), _AT_ONCE)
        ]
        xyz, sure, score = (torch.cat(each).numpy() for each in zip(*parts, strict=True))
        return Swept(xyz, sure, score.astype(np.float64))

    def look(self, name: str) -> Look:
        """At a photograph; the last few are kept."""
        if name not in self._looks:
            image = self._map.images[name]
            rgb = read_rgb(self._images / name, image.camera)
            scale = min(1.0, self._longest / max(image.camera.width, image.camera.height))
            small = view(rgb, image.camera, 0.0, scale)
            grey = cv2.cvtColor(np.ascontiguousarray(small.picture), cv2.COLOR_RGB2GRAY)
            values = torch.from_numpy(grey.astype(np.float32))
            self._looks[name] = Look(values, small.camera, image.pose, small.in_photograph)
            while len(self._looks) > _HELD:
                self._looks.popitem(last=False)
        self._looks.move_to_end(name)
        return self._looks[name]

    def _beside(self, name: str) -> list[str]:
        """Photographs of the same, whose rays cross this one's well and from different sides."""
        own, here = self._map.images[name], self._rows[name]
        centre = own.pose.centre().numpy()
        middle = np.median(self._map.xyz[here], axis=0) if len(here) else centre
        distance = max(float(np.linalg.norm(middle - centre)), 1e-9)
        scores, sides = {}, {}
        for other, rows in self._rows.items():
            shared = len(np.intersect1d(here, rows, assume_unique=True)) if other != name else 0
            if shared < _LEAST_SHARED:
                continue
            baseline = self._map.images[other].pose.centre().numpy() - centre
            angle = math.atan2(float(np.linalg.norm(baseline)), distance)
            scores[other] = shared * math.exp(-((math.log(max(angle, 1e-6) / _BEST_ANGLE)) ** 2))
            sides[other] = baseline / max(float(np.linalg.norm(baseline)), 1e-9)
        chosen: list[str] = []
        while scores and len(chosen) < self._neighbours:
            best = max(
                scores, key=lambda n: scores[n] * _novel(sides[n], [sides[c] for c in chosen])
            )
            chosen.append(best)
            del scores[best]
        return chosen

    def _depths(
        self,
        name: str,
        camera: Camera,
        neighbours: Sequence[str],
        count: int,
        bounds: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    ) -> Tensor:
        """Inverse depths to try, (N, D): a pixel apart in the neighbour that is farthest away."""
        pose = self._map.images[name].pose
        if bounds is None:
            points = torch.from_numpy(self._map.xyz[self._rows[name]])
            z = pose.transform(points)[:, 2]
            near, far = z[z > 0].quantile(z.new_tensor([0.005, 0.995]))
            nearest = (near * (1 - _BEYOND)).expand(count)
            farthest = (far * (1 + _BEYOND)).expand(count)
        else:
            nearest, farthest = (torch.from_numpy(bound) for bound in bounds)
        low, high = 1 / farthest, 1 / nearest
        centre = pose.centre()
        reach = max(float((self._map.images[n].pose.centre() - centre).norm()) for n in neighbours)
        steps = math.ceil(max(camera.focal) * reach * float((high - low).max())) + 1
        share = torch.linspace(0, 1, min(max(steps, 8), _MOST_DEPTHS), dtype=torch.float64)
        tried: Tensor = low[:, None] + (high - low)[:, None] * share
        return tried


def _novel(side: NDArray[np.float64], chosen: Sequence[NDArray[np.float64]]) -> float:
    """1 for a direction across those chosen, less for one along them."""
    return 1.1 - max((abs(float(side @ other)) for other in chosen), default=0.0)


def _swept(
    look: Look, xy: Tensor, others: Sequence[Look], depths: Tensor, window: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Where pixels (N, 2) stand in the world, (N, 3), and which are sure, (N,), and how well, (N,);
    of inverse depths (N, D)."""
    # Rays through the corner and one pixel beside and below it: windows move with these.
    three = xy[:, None] + xy.new_tensor([[0, 0], [1, 0], [0, 1]])
    rays, usable = look.camera.unproject(three.flatten(0, 1))
    rays = rays.view(*three.shape[:2], 3).float()
    own = _normalised(_looked_up(look.grey, xy[:, None] + window))
    agreement = torch.stack(
        [_agreement(look, rays, own, window.float(), depths, other) for other in others],
        -1,
    )
    # The better half: the others may not see it.
    best_two = agreement.topk(2, -1).values
    score = best_two.mean(-1)
    top, index = score.max(1)
    apart = (torch.arange(depths.shape[1]) - index[:, None]).abs() > _APART_STEPS
    rival = torch.where(apart, score, -1).amax(1)
    inner = index.clamp(1, depths.shape[1] - 2)
    before, at, after = (score.gather(1, (inner + k)[:, None])[:, 0] for k in (-1, 0, 1))
    curve = (before - 2 * at + after).clamp(max=-1e-6)
    offset = (0.5 * (before - after) / curve).clamp(-0.5, 0.5)
    second = best_two.gather(1, index[:, None, None].expand(-1, 1, 2))[:, 0, 1]
    sure = (second > _AGREE) & (top > rival + _BETTER) & (index == inner)
    sure &= usable.view(three.shape[:2]).all(1)
    step = depths[:, 1] - depths[:, 0]
    inverse = depths.gather(1, inner[:, None])[:, 0] + offset * step
    in_camera = rays[:, 0].double() / inverse[:, None].double()
    return look.pose.inverse().transform(in_camera), sure, second


def _agreement(
    look: Look, rays: Tensor, own: Tensor, window: Tensor, depths: Tensor, other: Look
) -> Tensor:
    """Correlation of windows (N, P) with what another photograph shows there, (N, D)."""
    relative = (other.pose @ look.pose.inverse()).to(dtype=rays.dtype)
    in_camera = rays[:, None] / depths[..., None, None] @ relative.rotation.T + relative.translation
    shape = in_camera.shape[:3]
    projected = other.camera.project(in_camera.flatten(0, 2))
    inside = projected.valid & other.camera.contains(projected.xy, _BORDER)
    corner, right, below = projected.xy.view(*shape, 2).unbind(2)
    across = torch.stack([right - corner, below - corner], -2)
    theirs = _normalised(_looked_up(other.grey, corner[:, :, None] + window @ across))
    found = torch.einsum("np,ndp->nd", own, theirs)
    return torch.where(inside.view(shape).all(-1), found, -1)


def _looked_up(grey: Tensor, xy: Tensor) -> Tensor:
    """Values of a picture (H, W) at pixels (..., 2)."""
    size = xy.new_tensor([grey.shape[1], grey.shape[0]])
    grid = (2 * xy / size - 1).float().view(1, -1, xy.shape[-2], 2)
    return grid_sample(grey[None, None], grid, align_corners=False).view(xy.shape[:-1])


def _normalised(windows: Tensor) -> Tensor:
    """Windows (..., P) of mean zero and length one; plain ones are zero."""
    centred = windows - windows.mean(-1, keepdim=True)
    length = centred.norm(dim=-1, keepdim=True)
    return torch.where(length > windows.shape[-1] ** 0.5, centred / length.clamp_min(1e-6), 0)
