"""Depths of pixels of a map's photographs by a plane sweep over their neighbours.

At every depth along a pixel's ray, a window around the pixel is compared with the neighbouring
photographs, whose poses are known (Collins, "A space-sweep approach to true multi-image matching",
CVPR 1996).
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

# Number of photographs in the cache in memory.
_CACHED_PHOTOGRAPHS: Final = 12
# Number of pixels that are triangulated at once.
_CHUNK: Final = 1024
# Samples of the window to either side of its centre, and pixels between samples. The window of 9
# pixels has enough texture and little change of depth.
_WINDOW_REACH: Final = 3
_WINDOW_STEP_PX: Final = 1.5
BORDER_PX: Final = 8.0
"""Width of the edge of a photograph that is not compared, because lens models are least exact
there."""
# Minimum difference between the best correlation and the correlation at any other depth. Depths at
# most this many steps from the best do not count as other depths.
_RIVAL_MARGIN: Final = 0.05
_RIVAL_STEPS: Final = 2
# Minimum length of the shorter side of a downscaled photograph, pixels.
_MIN_SIDE_PX: Final = 64
# Side of the window in downscaled photographs, pixels.
_SHRUNK_WINDOW_PX: Final = 5
# Spacing of the depths in downscaled photographs, pixels of shift.
_PLANE_STEP_PX: Final = 1.5
# Number of depths on either side of the best depth of downscaled photographs that are tried at full
# size.
_NEAR_STEPS: Final = 5


class SweepOptions(NeighbourOptions):
    """Options of the plane sweep."""

    max_depths: int = Field(256, ge=8, description="Maximum number of depths of a pixel.")
    min_correlation: float = Field(
        0.75, description="Least correlation with the second-best neighbour."
    )
    shrink: int = Field(
        4,
        ge=1,
        description="Factor by which photographs are downscaled for a first sweep; at full size "
        "only depths near those of the first sweep are tried. 1 tries all depths at full size.",
    )
    shrunk_correlation: float = Field(
        0.4, description="Least correlation with the second-best neighbour in the first sweep."
    )


SWEEP: Final = SweepOptions()
"""The default options of the plane sweep."""


def window_offsets() -> Tensor:
    """Return the offsets of the window's samples from its centre, (P, 2) pixels."""
    unit = _WINDOW_STEP_PX * torch.arange(-_WINDOW_REACH, _WINDOW_REACH + 1, dtype=torch.float64)
    return torch.stack(torch.meshgrid(unit, unit, indexing="xy"), -1).flatten(0, 1)


@dataclass(frozen=True)
class SweptPoints:
    """World points of N pixels of one photograph.

    Attributes:
        xyz: points (N, 3), world metres.
        sure: (N,) bool, whether two neighbours agree on a single depth.
        score: correlation (N,) with the second-best neighbour, 0 where it was not compared.
    """

    xyz: NDArray[np.float64]
    sure: NDArray[np.bool_]
    score: NDArray[np.float64]


class Sweeper:
    """Triangulates pixels of a map's photographs.

    Args:
        sparse_map: the map; its points tell which photographs overlap.
        images: folder of the photographs.
        longest: larger photographs are resized to this longer side (px).
        options: options of the sweep.
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
        self._window = window_offsets()
        cameras = {image.camera for image in sparse_map.images.values()}
        sizes = (c.width * c.height * self._scale(c) ** 2 for c in cameras)
        largest = max(sizes, default=0.0) * np.dtype(np.float32).itemsize
        self.photograph = LruCache(self._read, math.ceil(_CACHED_PHOTOGRAPHS * largest))
        self._neighbours = Neighbours(sparse_map, options)

    @torch.inference_mode()
    def __call__(
        self,
        name: str,
        xy: NDArray[np.float64],
        depths: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    ) -> SweptPoints:
        """Triangulate pixels of one photograph; none is sure if there are too few neighbours.

        Args:
            name: name of the photograph.
            xy: (N, 2) pixels of ``photograph(name)``.
            depths: nearest and farthest depth (N,) of each pixel, metres; None for the range of the
                map's points.

        Raises:
            InputError: a photograph is missing or damaged.
        """
        neighbours = self._neighbours(name)
        if len(neighbours) < 2 or not len(xy):
            return SweptPoints(np.zeros((len(xy), 3)), np.zeros(len(xy), bool), np.zeros(len(xy)))
        photograph = self.photograph(name)
        inverse_depths = self._inverse_depths(name, photograph.camera, neighbours, len(xy), depths)
        others = [self.photograph(each) for each in neighbours]
        rows = np.arange(len(xy))
        smallest = min(min(each.grey.shape) for each in (photograph, *others))
        shrink = min(self._options.shrink, smallest // _MIN_SIDE_PX)
        if depths is None and shrink > 1:
            inverse_depths, clear = self._sweep_downscaled(
                photograph, xy, others, inverse_depths, shrink
            )
            rows = np.flatnonzero(clear)
        pixels = torch.from_numpy(xy)
        xyz, sure = np.zeros((len(xy), 3)), np.zeros(len(xy), bool)
        score = np.zeros(len(xy))
        for begin in range(0, len(rows), _CHUNK):
            part = rows[begin : begin + _CHUNK]
            found = self._triangulate(
                photograph, pixels[part], others, inverse_depths[part].float()
            )
            xyz[part], sure[part], score[part] = found
        return SweptPoints(xyz, sure, score)

    def digest_inputs(self, name: str, digests: Mapping[str, str]) -> str:
        """Return a digest of all inputs of a photograph's sweep except the options.

        They are the photograph, its neighbours and its depth range.

        Args:
            name: name of the photograph.
            digests: digests of the photographs' files by name.
        """
        parts: list[object] = [*self._neighbours.depths(name)]
        for each in (name, *self._neighbours(name)):
            image = self._map.images[each]
            parts += [digests[each], image.camera, image.cam_from_world]
        return digest_of(*parts)

    def _sweep_downscaled(
        self,
        photograph: GreyPhotograph,
        xy: NDArray[np.float64],
        others: Sequence[GreyPhotograph],
        inverse_depths: Tensor,
        shrink: int,
    ) -> tuple[Tensor, NDArray[np.bool_]]:
        """Sweep downscaled photographs.

        Args:
            photograph: the photograph.
            xy: (N, 2) pixels of the photograph.
            others: the neighbours.
            inverse_depths: inverse depths (N, D), the same for all pixels.
            shrink: factor by which the photographs are downscaled.

        Returns:
            The inverse depths (N, K) near the best of each pixel, and whether two neighbours agree
            on a single best depth (N,).
        """
        small, *small_others = (each.downscale(shrink) for each in (photograph, *others))
        sweep = PlaneSweep(small, _SHRUNK_WINDOW_PX, BORDER_PX / shrink)
        stride = max(1, round(shrink * _PLANE_STEP_PX))
        planes = inverse_depths[0, ::stride]
        first, second = _best_two([sweep(xy / shrink, planes, other) for other in small_others])
        score = 0.5 * (first + second)
        best = score.argmax(1)
        is_rival = np.abs(np.arange(len(planes)) - best[:, None]) > _RIVAL_STEPS
        rival = np.where(is_rival, score, -1.0).max(1)
        row = np.arange(len(best))
        clear = score[row, best] > rival + _RIVAL_MARGIN
        clear &= second[row, best] > self._options.shrunk_correlation
        count = min(2 * _NEAR_STEPS + 1, inverse_depths.shape[1])
        middle = np.round(stride * _peak(score, best)).astype(int)
        begin = np.clip(middle - _NEAR_STEPS, 0, inverse_depths.shape[1] - count)
        return inverse_depths.gather(1, torch.from_numpy(begin[:, None] + np.arange(count))), clear

    def _scale(self, camera: Camera) -> float:
        """Return the scale to which photographs of a camera are resized."""
        return min(1.0, self._longest / max(camera.width, camera.height))

    def _read(self, name: str) -> GreyPhotograph:
        """Read a photograph and downscale it."""
        image = self._map.images[name]
        rgb = read_rgb(self._images / name, image.camera)
        small = warp_image(rgb, image.camera, 0.0, self._scale(image.camera))
        grey = cv2.cvtColor(np.ascontiguousarray(small.picture), cv2.COLOR_RGB2GRAY)
        values = torch.from_numpy(grey.astype(np.float32))
        return GreyPhotograph(values, small.camera, image.pose, small.in_photograph)

    def _inverse_depths(
        self,
        name: str,
        camera: Camera,
        neighbours: Sequence[str],
        count: int,
        bounds: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    ) -> Tensor:
        """Return the inverse depths (N, D) to try, in ascending order, 1/metres.

        Successive depths shift a pixel by about one pixel in the farthest neighbour.

        Args:
            name: name of the photograph.
            camera: camera of the resized photograph.
            neighbours: names of the neighbours.
            count: number N of pixels.
            bounds: nearest and farthest depth (N,) of each pixel, metres; None for the depth range
                of the photograph.
        """
        if bounds is None:
            near, far = self._neighbours.depths(name)
            nearest, farthest = torch.tensor([[near], [far]], dtype=torch.float64).expand(2, count)
        else:
            nearest, farthest = (torch.from_numpy(bound) for bound in bounds)
        low, high = 1 / farthest, 1 / nearest
        centre = self._map.images[name].pose.centre()
        baseline = max(
            float((self._map.images[each].pose.centre() - centre).norm()) for each in neighbours
        )
        steps = math.ceil(max(camera.focal) * baseline * float((high - low).max())) + 1
        share = torch.linspace(
            0, 1, min(max(steps, 8), self._options.max_depths), dtype=torch.float64
        )
        inverse_depths: Tensor = low[:, None] + (high - low)[:, None] * share
        return inverse_depths

    def _triangulate(
        self,
        photograph: GreyPhotograph,
        xy: Tensor,
        others: Sequence[GreyPhotograph],
        inverse_depths: Tensor,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float32]]:
        """Place pixels (N, 2) of a photograph at the best of their inverse depths (N, D).

        Returns:
            World points (N, 3), whether they are sure (N,), and the correlation (N,) with the
            second-best neighbour.
        """
        sweep = WindowSweep(photograph, xy, self._window, BORDER_PX)
        first, second = _best_two([sweep(inverse_depths, other) for other in others])
        # Only the two best neighbours are used, because the point may be occluded in the others.
        score = 0.5 * (first + second)
        index = score.argmax(1)
        row = np.arange(len(index))
        is_rival = np.abs(np.arange(inverse_depths.shape[1]) - index[:, None]) > _RIVAL_STEPS
        rival = np.where(is_rival, score, -1.0).max(1)
        inner = index.clip(1, inverse_depths.shape[1] - 2)
        correlation = second[row, inner]
        sure = correlation > self._options.min_correlation
        sure &= score[row, index] > rival + _RIVAL_MARGIN
        sure &= (index == inner) & sweep.usable.numpy()
        step = inverse_depths[:, 1] - inverse_depths[:, 0]
        inverse = inverse_depths[:, 0] + torch.from_numpy(_peak(score, inner)) * step
        in_camera = sweep.rays.double() / inverse[:, None].double()
        return photograph.pose.inverse().transform(in_camera).numpy(), sure, correlation


def _best_two(found: Sequence[NDArray[np.float32]]) -> tuple[NDArray[np.float32], ...]:
    """Return the largest and the second largest of several arrays (N, D), value by value."""
    first = np.maximum(found[0], found[1])
    second = np.minimum(found[0], found[1])
    for each in found[2:]:
        second = np.maximum(second, np.minimum(first, each))
        first = np.maximum(first, each)
    return first, second


def _peak(score: NDArray[np.float32], index: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the peaks (N,), in indices, of parabolas through scores (N, D) around indices (N,)."""
    row, inner = np.arange(len(index)), index.clip(1, score.shape[1] - 2)
    before, at, after = (score[row, inner + k] for k in (-1, 0, 1))
    curve = np.minimum(before - 2 * at + after, -1e-6)
    offset = (0.5 * (before - after) / curve).clip(-0.5, 0.5)
    return np.asarray(index + np.where(index == inner, offset, 0), np.float32)
