"""PatchMatch stereo of one view: propagate planes between pixels and refine them at random.

Red and black pixels of a checkerboard alternate, so that all pixels of one colour are processed at
once (Galliani et al., Gipuma, ICCV 2015). A pixel tries the best of several neighbours in each of
four regions (after Xu and Tao, ACMH, CVPR 2019). The search runs from coarse to fine. The first
planes come from the points of the sparse map and from random numbers, in a small picture. The
points are tried again at every larger size, because small pictures lose objects a few pixels wide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate, pad

from objconnect.mapping.dense.photometry import Photometry, PlaneCosts
from objconnect.mapping.dense.planes import move, planes_at_nearest, planes_through, resize
from objconnect.mapping.dense.warp import StereoView
from objconnect.scene.runtime.device import supports_loops
from objconnect.scene.runtime.threads import torch_threads

# Number of pixels processed at once, whose windows fit into the processor's cache.
_CHUNK = 16384
# The search begins in a picture whose long side (px) is at most this: random planes find the
# surface there within the first rounds. Later pictures begin near it and need one round.
_COARSEST_PX: Final = 160
_FIRST_ROUNDS: Final = 4
_ROUNDS: Final = 1
# Largest slope of a random first guess, pixels of disparity per pixel. Random steps find steeper
# planes.
_STEEPEST: Final = 0.5
# Sizes of random steps: disparity in pixels, and its slope in pixels per pixel; halved each round,
# and multiplied by the argument ``step``.
_STEP_PX: Final = 1.0
_STEP_SLOPE: Final = 0.2
# The range of random inverse depths exceeds the map points' range by this share, because the map
# may lack points at the highest and the lowest position.
_MARGIN: Final = 0.2


def _regions() -> tuple[tuple[tuple[int, int], ...], ...]:
    """Return offsets (dx, dy) of neighbours of the other colour in four directions."""
    side = [(0, -1), (-1, -2), (1, -2), (-2, -3), (2, -3), (0, -3), (0, -5), (0, -7)]
    regions = []
    for _ in range(4):
        regions.append(tuple(side))
        side = [(-y, x) for x, y in side]
    return tuple(regions)


_REGIONS = _regions()
_REACH = max(max(abs(x), abs(y)) for region in _REGIONS for x, y in region)


class Estimate(NamedTuple):
    """Planes (3, H, W) of every pixel and their cost (H, W)."""

    planes: Tensor
    cost: Tensor


def first_estimate(
    reference: StereoView,
    sources: Sequence[StereoView],
    seeds: NDArray[np.float64],
    generator: torch.Generator,
) -> Estimate:
    """Estimate planes from photographs and map points, without depth maps of the sources.

    Args:
        reference: the view whose planes are sought.
        sources: other views of the same surface.
        seeds: (M, 3) x, y (pixels) and inverse depth (1/m) of map points in the reference.
        generator: generator of every random choice.
    """
    factors = [1]
    while max(reference.grey.shape) / factors[-1] > _COARSEST_PX:
        factors.append(2 * factors[-1])
    planes = None
    for factor in reversed(factors):
        view, others = _shrink(reference, factor), [_shrink(source, factor) for source in sources]
        height, width = view.grey.shape
        scale = np.array([width, height]) / reference.grey.shape[::-1]
        scaled_seeds = seeds * [*scale, 1.0]
        nearest = planes_at_nearest(scaled_seeds, height, width).to(view.grey.device)
        if planes is None:
            fitted = planes_through(scaled_seeds, height, width).to(view.grey.device)
            search = _Search(view, others, fitted[0], None, generator)
            estimate = search.begin(fitted, nearest)
            rounds, step = _FIRST_ROUNDS, 4.0
        else:
            planes = resize(planes, height, width)
            search = _Search(view, others, planes[0], None, generator)
            estimate = search.best_of([planes, nearest])
            rounds, step = _ROUNDS, 1.0
        estimate = search.run(estimate, rounds, step)
        planes = estimate.planes
    return estimate


def consistent_estimate(
    reference: StereoView,
    sources: Sequence[StereoView],
    planes: Tensor,
    inverse_depths: Sequence[Tensor],
    generator: torch.Generator,
) -> Estimate:
    """Refine planes for consistency with the first estimates of the sources.

    Args:
        reference: the view whose planes are sought.
        sources: other views of the same surface.
        planes: (3, H, W) first estimate of the reference.
        inverse_depths: (H, W) first estimates of the sources.
        generator: generator of every random choice.
    """
    search = _Search(reference, sources, planes[0], inverse_depths, generator)
    return search.run(search.best_of([planes]), _ROUNDS, 0.5)


def _shrink(view: StereoView, factor: int) -> StereoView:
    if factor == 1:
        return view
    height, width = (max(1, side // factor) for side in view.grey.shape)
    grey = interpolate(view.grey[None, None], (height, width), mode="area")[0, 0]
    return StereoView(grey, view.camera.resize(width, height), view.cam_from_world)


class _Search:
    """The search for planes in one picture at one resolution; arguments as ``Photometry``."""

    def __init__(
        self,
        reference: StereoView,
        sources: Sequence[StereoView],
        expected: Tensor,
        inverse_depths: Sequence[Tensor] | None,
        generator: torch.Generator,
    ) -> None:
        kind = _photometry(reference.grey.device)
        self._photometry = kind(reference, sources, expected, inverse_depths)
        self._generator = generator
        self._device = reference.grey.device
        self._shape = reference.grey.shape
        centres = [np.linalg.inv(v.cam_from_world)[:3, 3] for v in (reference, *sources)]
        baseline = float(np.median([np.linalg.norm(c - centres[0]) for c in centres[1:]]))
        # The change of inverse depth for one pixel of disparity.
        self._inverse_per_px = 1 / (reference.camera.focal[0] * baseline)
        height, width = self._shape
        rows, columns = torch.meshgrid(
            torch.arange(height, device=self._device),
            torch.arange(width, device=self._device),
            indexing="ij",
        )
        self._colours = [
            torch.stack([rows[chosen], columns[chosen]])
            for chosen in ((rows + columns) % 2 == 0, (rows + columns) % 2 == 1)
        ]

    def begin(self, fitted: Tensor, nearest: Tensor) -> Estimate:
        """Return the cheapest of four planes per pixel: two from seeds (3, H, W), two random."""
        inverse = nearest[0]
        low, high = float(inverse.min()) * (1 - _MARGIN), float(inverse.max()) * (1 + _MARGIN)
        guesses = [fitted, nearest]
        for _ in range(2):
            w = low + (high - low) * self._uniform(1)
            slope = (2 * self._uniform(2) - 1) * (_STEEPEST * self._inverse_per_px)
            guesses.append(torch.cat([w, slope]))
        fitted[0].clamp_(low, high)
        return self.best_of(guesses)

    def best_of(self, guesses: Sequence[Tensor]) -> Estimate:
        """Return the cheapest of several planes at each pixel, (3, H, W)."""
        planes = guesses[0].clone()
        cost = torch.empty(self._shape, device=self._device)
        with torch_threads(self._photometry.torch_threads):
            for rows, columns in chain.from_iterable(map(_chunks, self._colours)):
                window = self._photometry.window(rows, columns)
                first = planes[:, rows, columns]
                best = _Best(self._photometry, window, first, self._photometry.cost(window, first))
                for guess in guesses[1:]:
                    best.offer(guess[:, rows, columns])
                planes[:, rows, columns], cost[rows, columns] = best.planes, best.cost
        return Estimate(planes, cost)

    def run(self, estimate: Estimate, rounds: int, step: float) -> Estimate:
        """Propagate and refine planes, ``rounds`` times over both colours.

        Random steps are multiplied by ``step`` in the first round; it is halved in each further
        round.
        """
        with torch_threads(self._photometry.torch_threads):
            for k in range(rounds):
                for colour in self._colours:
                    self._improve(estimate, colour, step * 0.5**k)
        return estimate

    def _improve(self, estimate: Estimate, colour: Tensor, step: float) -> None:
        """Propagate and refine the planes of one colour, in place."""
        noise = [self._normal() for _ in range(2)]
        # Neighbours are of the other colour, so the order of the chunks does not matter.
        cost = pad(estimate.cost, (_REACH,) * 4, value=torch.inf)
        for rows, columns in _chunks(colour):
            window = self._photometry.window(rows, columns)
            planes, costs = estimate.planes[:, rows, columns], estimate.cost[rows, columns]
            best = _Best(self._photometry, window, planes, costs)
            for region in _REGIONS:
                best.offer(_take_from_neighbour(estimate.planes, cost, region, rows, columns))
            for drawn in noise:
                random = drawn[:, rows, columns] * (step * self._inverse_per_px)
                w, gx, gy = best.planes
                best.offer(torch.stack([w + _STEP_PX * random[0], gx, gy]))
                w, gx, gy = best.planes
                sx, sy = _STEP_SLOPE * random[1:]
                best.offer(torch.stack([w, gx + sx, gy + sy]))
            estimate.planes[:, rows, columns] = best.planes
            estimate.cost[rows, columns] = best.cost

    def _uniform(self, channels: int) -> Tensor:
        return torch.rand(channels, *self._shape, generator=self._generator).to(self._device)

    def _normal(self) -> Tensor:
        return torch.randn(3, *self._shape, generator=self._generator).to(self._device)


def _photometry(device: torch.device) -> Callable[..., PlaneCosts]:
    """Return the fastest installed implementation of the cost for a device."""
    if supports_loops(device):
        from objconnect.mapping.dense.compiled_cost import CompiledPhotometry

        return CompiledPhotometry
    return Photometry


class _Best:
    """The cheapest plane so far at each of n pixels."""

    def __init__(self, photometry: PlaneCosts, window: Any, planes: Tensor, cost: Tensor) -> None:
        self._photometry = photometry
        self._window = window
        self.planes = planes
        self.cost = cost

    def offer(self, planes: Tensor) -> None:
        cost = self._photometry.cost(self._window, planes, self.cost)
        better = (cost < self.cost) & (planes[0] > 0)
        self.planes = torch.where(better, planes, self.planes)
        self.cost = torch.where(better, cost, self.cost)


def _take_from_neighbour(
    planes: Tensor,
    cost: Tensor,
    region: Sequence[tuple[int, int]],
    rows: Tensor,
    columns: Tensor,
) -> Tensor:
    """Return the plane of the cheapest neighbour in a region, moved to each pixel (n,)."""
    dx, dy = torch.tensor(region, device=rows.device).T[..., None]
    costs = cost[rows + dy + _REACH, columns + dx + _REACH]
    least, which = costs.min(0)
    # Where all neighbours are outside the picture, the offset is 0: the pixel keeps its plane.
    inside = torch.isfinite(least)
    dx, dy = (torch.where(inside, d[which, 0], 0) for d in (dx, dy))
    return move(planes[:, rows + dy, columns + dx], -dx, -dy)


def _chunks(colour: Tensor) -> Sequence[tuple[Tensor, Tensor]]:
    rows, columns = colour
    starts = range(0, len(rows), _CHUNK)
    return [(rows[k : k + _CHUNK], columns[k : k + _CHUNK]) for k in starts]
