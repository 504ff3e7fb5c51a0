"""Depths of pixels of a map's photographs, found by a plane sweep over the photographs beside them.

Each pixel is swept along its ray (Collins, "A space-sweep approach to true multi-image matching",
CVPR 1996): at every depth a window around it is compared with what the neighbours, whose poses are
known, show there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from objconnect.localization.depth.grey_photograph import GreyPhotograph
from objconnect.localization.depth.neighbours import NeighbourOptions, Neighbours
from objconnect.localization.depth.plane_sweep import PlaneSweep
from objconnect.localization.depth.window_sweep import WindowSweep
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.views import warp_image
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import digest_of
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.lru_cache import LruCache

# Photographs of the largest size for which there is room in the cache.
_CACHED: Final = 12
# Pixels placed at a time.
_CHUNK: Final = 1024
# Values of the window to either side of its middle, and pixels between them: 9 pixels show enough
# texture, and of few of them depth does not change much.
_WINDOW_REACH: Final = 3
_WINDOW_STEP_PX: Final = 1.5
BORDER_PX: Final = 8.0
"""Pixels at the edge of a photograph in which nothing is compared: lenses are least known there."""
# Correlation by which any other depth must fall behind the best, and how many steps away a depth is
# another one.
_RIVAL_MARGIN: Final = 0.05
_RIVAL_STEPS: Final = 2
# Photographs are not made smaller than this on their shorter side.
_LEAST_SIDE_PX: Final = 64
# Side of the window in smaller photographs, how far apart depths are that are swept in them, their
# pixels, and how many depths are tried afterwards to either side of the one found.
_SHRUNK_WINDOW: Final = 5
_PLANE_STEP_PX: Final = 1.5
_NEAR_STEPS: Final = 5


class SweepOptions(NeighbourOptions):
    """Options of the plane sweep."""

    max_depths: int = Field(256, ge=8, description="Most depths tried for a pixel.")
    min_correlation: float = Field(
        0.75, description="Correlation that the second-best neighbour must exceed."
    )
    shrink: int = Field(
        4,
        ge=1,
        description="Pixels are swept in photographs made smaller by this factor first, and then "
        "near the depth found there; 1 sweeps all depths in the photographs as they are.",
    )
    shrunk_correlation: float = Field(
        0.4, description="Correlation that the second-best neighbour must exceed there."
    )


SWEEP: Final = SweepOptions()
"""The sweep of a map's corners."""


def window() -> Tensor:
    """Return the offsets of the window's values from its middle, (P, 2) pixels."""
    unit = _WINDOW_STEP_PX * torch.arange(-_WINDOW_REACH, _WINDOW_REACH + 1, dtype=torch.float64)
    return torch.stack(torch.meshgrid(unit, unit, indexing="xy"), -1).flatten(0, 1)


@dataclass(frozen=True)
class Swept:
    """World points of pixels of one photograph.

    Attributes:
        xyz: points (N, 3), world metres.
        sure: (N,) bool, whether two neighbours agree on the depth and on no other depth.
        score: correlation (N,) of the neighbours, 0 where it was not compared.
    """

    xyz: NDArray[np.float64]
    sure: NDArray[np.bool_]
    score: NDArray[np.float64]


class Sweeper:
    """Places pixels of a map's photographs, one photograph after the other.

    Args:
        sparse_map: the map; its points tell which photographs see the same.
        images: folder of the photographs.
        longest: photographs with a longer side (px) are made smaller.
        options: how depths are found.
    """

    def __init__(
        self,
        sparse_map: SparseMap,
        images: Path,
        longest: float = math.inf,
        options: SweepOptions = SWEEP,
    ) -> None:
        self._map = sparse_map
        self._images = images
        self._longest = longest
        self._options = options
        self._window = window()
        cameras = {image.camera for image in sparse_map.images.values()}
        sizes = (c.width * c.height * self._scale(c) ** 2 for c in cameras)
        largest = max(sizes, default=0.0) * np.dtype(np.float32).itemsize
        self.photograph = LruCache(self._read, math.ceil(_CACHED * largest))
        self._neighbours = Neighbours(sparse_map, options)

    @torch.inference_mode()
    def __call__(
        self,
        name: str,
        xy: NDArray[np.float64],
        depths: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    ) -> Swept:
        """Place pixels of one photograph; none is sure where it has too few neighbours.

        Args:
            name: name of the photograph.
            xy: (N, 2) pixels of ``photograph(name)``.
            depths: nearest and farthest depth (N,) of each pixel, metres; None for those of the
                map's points.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        neighbours = self._neighbours(name)
        if len(neighbours) < 2 or not len(xy):
            return Swept(np.zeros((len(xy), 3)), np.zeros(len(xy), bool), np.zeros(len(xy)))
        here = self.photograph(name)
        tried = self._depths(name, here.camera, neighbours, len(xy), depths)
        others = [self.photograph(each) for each in neighbours]
        placed = np.arange(len(xy))
        smallest = min(min(each.grey.shape) for each in (here, *others))
        shrink = min(self._options.shrink, smallest // _LEAST_SIDE_PX)
        if depths is None and shrink > 1:
            tried, clear = self._near(here, xy, others, tried, shrink)
            placed = np.flatnonzero(clear)
        pixels = torch.from_numpy(xy)
        xyz, sure = np.zeros((len(xy), 3)), np.zeros(len(xy), bool)
        score = np.zeros(len(xy))
        for begin in range(0, len(placed), _CHUNK):
            part = placed[begin : begin + _CHUNK]
            found = self._place_pixels(here, pixels[part], others, tried[part].float())
            xyz[part], sure[part], score[part] = found
        return Swept(xyz, sure, score)

    def digest_inputs(self, name: str, digests: Mapping[str, str]) -> str:
        """Return all that decides the places of a photograph's pixels but the options.

        Args:
            name: of the photograph.
            digests: of the bytes of the map's photographs, by name.

        Returns:
            A digest of the photograph, of those that it is compared with, and of its depths.
        """
        parts: list[object] = [*self._neighbours.depths(name)]
        for each in (name, *self._neighbours(name)):
            image = self._map.images[each]
            parts += [digests[each], image.camera, image.cam_from_world]
        return digest_of(*parts)

    def _near(
        self,
        here: GreyPhotograph,
        xy: NDArray[np.float64],
        others: Sequence[GreyPhotograph],
        tried: Tensor,
        shrink: int,
    ) -> tuple[Tensor, NDArray[np.bool_]]:
        """Sweep smaller photographs.

        Args:
            here: the photograph.
            xy: (N, 2) its pixels.
            others: photographs beside it.
            tried: inverse depths (N, D), the same for all pixels.
            shrink: factor by which the photographs are made smaller.

        Returns:
            Those of the inverse depths (N, K) that are near the best there, and whether two
            neighbours agree on it and no depth farther away fits nearly as well (N,).
        """
        small, *beside = (each.shrunk(shrink) for each in (here, *others))
        sweep = PlaneSweep(small, _SHRUNK_WINDOW, BORDER_PX / shrink)
        hop = max(1, round(shrink * _PLANE_STEP_PX))
        planes = tried[0, ::hop]
        first, second = _best_two([sweep(xy / shrink, planes, other) for other in beside])
        score = 0.5 * (first + second)
        best = score.argmax(1)
        apart = np.abs(np.arange(len(planes)) - best[:, None]) > _RIVAL_STEPS
        rival = np.where(apart, score, -1.0).max(1)
        row = np.arange(len(best))
        clear = score[row, best] > rival + _RIVAL_MARGIN
        clear &= second[row, best] > self._options.shrunk_correlation
        count = min(2 * _NEAR_STEPS + 1, tried.shape[1])
        middle = np.round(hop * _peak(score, best)).astype(int)
        begin = np.clip(middle - _NEAR_STEPS, 0, tried.shape[1] - count)
        return tried.gather(1, torch.from_numpy(begin[:, None] + np.arange(count))), clear

    def _scale(self, camera: Camera) -> float:
        """Return the scale at which photographs of a camera are read."""
        return min(1.0, self._longest / max(camera.width, camera.height))

    def _read(self, name: str) -> GreyPhotograph:
        """Read a photograph and make it smaller."""
        image = self._map.images[name]
        rgb = read_rgb(self._images / name, image.camera)
        small = warp_image(rgb, image.camera, 0.0, self._scale(image.camera))
        grey = cv2.cvtColor(np.ascontiguousarray(small.picture), cv2.COLOR_RGB2GRAY)
        values = torch.from_numpy(grey.astype(np.float32))
        return GreyPhotograph(values, small.camera, image.pose, small.in_photograph)

    def _depths(
        self,
        name: str,
        camera: Camera,
        neighbours: Sequence[str],
        count: int,
        bounds: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    ) -> Tensor:
        """Return inverse depths to try, (N, D), a pixel apart in the neighbour farthest away."""
        if bounds is None:
            near, far = self._neighbours.depths(name)
            nearest, farthest = torch.tensor([[near], [far]], dtype=torch.float64).expand(2, count)
        else:
            nearest, farthest = (torch.from_numpy(bound) for bound in bounds)
        low, high = 1 / farthest, 1 / nearest
        centre = self._map.images[name].pose.centre()
        reach = max(float((self._map.images[n].pose.centre() - centre).norm()) for n in neighbours)
        steps = math.ceil(max(camera.focal) * reach * float((high - low).max())) + 1
        share = torch.linspace(
            0, 1, min(max(steps, 8), self._options.max_depths), dtype=torch.float64
        )
        tried: Tensor = low[:, None] + (high - low)[:, None] * share
        return tried

    def _place_pixels(
        self,
        here: GreyPhotograph,
        xy: Tensor,
        others: Sequence[GreyPhotograph],
        depths: Tensor,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float32]]:
        """Place pixels (N, 2) at the best of their inverse depths (N, D).

        Returns:
            World points (N, 3), which of them are sure (N,), and their correlation (N,).
        """
        sweep = WindowSweep(here, xy, self._window, BORDER_PX)
        first, second = _best_two([sweep(depths, other) for other in others])
        # The better half: the others may not see it.
        score = 0.5 * (first + second)
        index = score.argmax(1)
        row = np.arange(len(index))
        apart = np.abs(np.arange(depths.shape[1]) - index[:, None]) > _RIVAL_STEPS
        rival = np.where(apart, score, -1.0).max(1)
        inner = index.clip(1, depths.shape[1] - 2)
        agreed = second[row, inner]
        sure = agreed > self._options.min_correlation
        sure &= score[row, index] > rival + _RIVAL_MARGIN
        sure &= (index == inner) & sweep.usable.numpy()
        step = depths[:, 1] - depths[:, 0]
        inverse = depths[:, 0] + torch.from_numpy(_peak(score, inner)) * step
        in_camera = sweep.rays.double() / inverse[:, None].double()
        return here.pose.inverse().transform(in_camera).numpy(), sure, agreed


def _best_two(found: Sequence[NDArray[np.float32]]) -> tuple[NDArray[np.float32], ...]:
    """Return the largest and the second largest of several arrays (N, D), value by value."""
    first = np.maximum(found[0], found[1])
    second = np.minimum(found[0], found[1])
    for each in found[2:]:
        second = np.maximum(second, np.minimum(first, each))
        first = np.maximum(first, each)
    return first, second


def _peak(score: NDArray[np.float32], index: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return where the parabola through a score (N, D) around an index (N,) has its top, (N,)."""
    row, inner = np.arange(len(index)), index.clip(1, score.shape[1] - 2)
    before, at, after = (score[row, inner + k] for k in (-1, 0, 1))
    curve = np.minimum(before - 2 * at + after, -1e-6)
    offset = (0.5 * (before - after) / curve).clip(-0.5, 0.5)
    return np.asarray(index + np.where(index == inner, offset, 0), np.float32)
